"""Shading, shadows between and under things, pixel by pixel, compiled by numba. Import it only where a picture is made.

``no_type_check`` keeps runtime type checkers, which tests switch on, out of compiled functions.
"""

from typing import no_type_check

import numpy as np

from farfield.errors import MissingExtraError
from farfield.simulation.bodies.materials import Material

try:
    from numba import njit
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "Rendering camera pictures") from error

_ASPHALT, _CONCRETE, _LANE_PAINT = int(Material.ASPHALT), int(Material.CONCRETE), int(Material.LANE_PAINT)
_GRASS, _SOIL, _CAR_PAINT, _GLASS = (
    int(Material.GRASS),
    int(Material.SOIL),
    int(Material.CAR_PAINT),
    int(Material.GLASS),
)
_LAMP, _PLATE, _METAL, _BRICK = int(Material.LAMP), int(Material.PLATE), int(Material.METAL), int(Material.BRICK)
_FOLIAGE, _SIGN, _CARGO = int(Material.FOLIAGE), int(Material.SIGN), int(Material.CARGO)


@njit("float32(int64, int64, int64)", cache=True)
@no_type_check
def hash01(ix, iy, seed):
    """A number in [0, 1) for a cell of a lattice."""
    h = (ix * 374761393 + iy * 668265263 + seed * 974634749) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return np.float32((h ^ (h >> 16)) & 0xFFFFFF) * np.float32(1.0 / 16777216.0)


@njit("float32(float64, float64, int64)", cache=True)
@no_type_check
def noise2(x, y, seed):
    """Value noise (Perlin's lattice with smooth steps): mean 0.5, cells of size 1."""
    fx, fy = np.floor(x), np.floor(y)
    ix, iy = int(fx), int(fy)
    u, v = np.float32(x - fx), np.float32(y - fy)
    u = u * u * (np.float32(3) - np.float32(2) * u)
    v = v * v * (np.float32(3) - np.float32(2) * v)
    a = hash01(ix, iy, seed)
    b = hash01(ix + 1, iy, seed)
    c = hash01(ix, iy + 1, seed)
    d = hash01(ix + 1, iy + 1, seed)
    top = a + (b - a) * u
    return top + (c + (d - c) * u - top) * v


@njit(cache=True)
@no_type_check
def sky_into(out, dx, dy, dz, sky, drawn):
    """Write the sky's radiance along a direction, before haze, to ``out``; ``drawn`` adds clouds and the sun's disc."""
    up = max(np.float32(0), dz)
    rise = np.float32(1) - np.exp(-np.float32(3.2) * up)
    near = dx * sky.sun[0] + dy * sky.sun[1] + dz * sky.sun[2]
    glow, disc = np.float32(0), np.float32(0)
    if sky.sun_rgb[0] > 0 and near > 0:
        glow = np.float32(0.10) * near**8 + np.float32(0.35) * near**96
        if drawn and near > 0.99995:
            disc = np.float32(40)
    cloud = np.float32(0)
    if drawn and sky.clouds > 0.02 and dz > 0.02:
        px, py = dx / (dz + 0.08), dy / (dz + 0.08)
        n = 0.55 * noise2(px * 1.1, py * 1.1, 11) + 0.28 * noise2(px * 2.7, py * 2.7, 12)
        n += 0.17 * noise2(px * 6.5, py * 6.5, 13)
        cloud = np.float32(min(1.0, max(0.0, (n - (0.78 - 0.55 * sky.clouds)) * 4.0)) * min(1.0, dz * 8.0))
    grey = np.float32(0.85) * (sky.zenith_rgb[2] * np.float32(0.4) + sky.horizon_rgb[1])
    for c in range(3):
        base = sky.horizon_rgb[c] + (sky.zenith_rgb[c] - sky.horizon_rgb[c]) * rise
        base += sky.sun_rgb[c] * (glow + disc)
        out[c] = base + (grey - base) * cloud * np.float32(0.8)


@njit(cache=True)
@no_type_check
def _ground_tone(material, x, y, footprint):
    """Factor of a ground's albedo: grain, patches and large variation, each fading where pixels are wider than it."""
    fine = np.float32(min(1.0, 0.05 / max(footprint, 1e-6)))
    mid = np.float32(min(1.0, 0.5 / max(footprint, 1e-6)))
    if material == _ASPHALT:
        tone = np.float32(1) + np.float32(0.30) * fine * (noise2(x * 24, y * 24, 1) - np.float32(0.5))
        tone += np.float32(0.22) * mid * (noise2(x * 1.3, y * 1.3, 2) - np.float32(0.5))
        return tone + np.float32(0.24) * (noise2(x * 0.11, y * 0.11, 3) - np.float32(0.5))
    if material in (_GRASS, _SOIL):
        tone = np.float32(1) + np.float32(0.6) * fine * (noise2(x * 14, y * 14, 4) - np.float32(0.5))
        tone += np.float32(0.6) * mid * (noise2(x * 1.7, y * 1.7, 5) - np.float32(0.5))
        return tone + np.float32(0.5) * (noise2(x * 0.13, y * 0.13, 6) - np.float32(0.5))
    tone = np.float32(1) + np.float32(0.16) * fine * (noise2(x * 20, y * 20, 7) - np.float32(0.5))
    return tone + np.float32(0.16) * mid * (noise2(x * 0.9, y * 0.9, 8) - np.float32(0.5))


@njit(cache=True)
@no_type_check
def _wall_tone(material, along, z, footprint):
    """Factor of a standing surface's albedo: brick courses, seams and stains."""
    if material == _BRICK:
        course = z / 0.075
        shift = 0.5 * (int(np.floor(course)) & 1)
        stone = along / 0.22 + shift
        seam = (course - np.floor(course) < 0.14) or (stone - np.floor(stone) < 0.06)
        fade = np.float32(min(1.0, 0.04 / max(footprint, 1e-6)))
        tone = hash01(int(np.floor(stone)), int(np.floor(course)), 21) * np.float32(0.3) - np.float32(0.15)
        if seam:
            tone = np.float32(0.35)
        stain = np.float32(0.2) * (noise2(along * 0.3, z * 0.3, 22) - np.float32(0.5))
        return np.float32(1) + fade * tone + stain
    stain = np.float32(0.26) * (noise2(along * 0.7, z * 1.4, 23) - np.float32(0.5))
    seam = along / 4.0 - np.floor(along / 4.0) < 0.012 and footprint < 0.08
    return np.float32(1) + stain - np.float32(0.3 if seam else 0.0)


@njit(cache=True)
@no_type_check
def _sign_mark(along, z, footprint):
    """Whether a sign's lettering covers a place: rows of blocks, seen only from near."""
    row, cell = np.floor(z / 0.42), np.floor(along / 0.16)
    within = z / 0.42 - row
    if footprint > 0.12 or within < 0.30 or within > 0.72 or along / 0.16 - cell > 0.68:
        return False
    return hash01(int(cell), int(row), 31) < 0.62


@njit(cache=True)
@no_type_check
def _lamp_light(out, lamps, headlamps, px, py, pz, nx, ny, nz):
    """Add what all lamps throw on a place; returns the part of the ego vehicle's own, which come first."""
    own = np.float32(0)
    for i in range(lamps.shape[0]):
        lx, ly, lz = lamps[i, 0] - px, lamps[i, 1] - py, lamps[i, 2] - pz
        square = lx * lx + ly * ly + lz * lz
        if square > lamps[i, 10] or (i >= headlamps and nx * lx + ny * ly + nz * lz <= 0):
            continue
        far = np.float32(np.sqrt(square)) + np.float32(1e-3)
        lx, ly, lz = lx / far, ly / far, lz / far
        facing = nx * lx + ny * ly + nz * lz
        towards = -(lx * lamps[i, 3] + ly * lamps[i, 4] + lz * lamps[i, 5])
        if lamps[i, 11] > 0:  # a head lamp's cone is meant sideways
            towards = -(lx * lamps[i, 3] + ly * lamps[i, 4]) / np.sqrt(lx * lx + ly * ly + np.float32(1e-6))
        cone = min(np.float32(1), max(np.float32(0), (towards - lamps[i, 6]) * np.float32(12))) ** 2
        if lamps[i, 11] > 0:
            cone = max(cone, np.float32(0.12) * towards * towards if towards > 0 else np.float32(0))  # stray light
        if cone <= 0:
            continue
        if lamps[i, 11] > 0:  # it is dimmed above its cut-off, near the horizon
            if lz > np.float32(0.06):  # and near the car, so that the road is lit evenly
                cone *= (np.float32(0.06) / lz) ** 2
            else:
                cone *= np.float32(0.12) + np.float32(0.88) * min(
                    np.float32(1), max(np.float32(0), (lz + np.float32(0.008)) * np.float32(25))
                )
        power = cone / (square + np.float32(1))
        if i < headlamps:
            own += power
        if facing > 0:
            for c in range(3):
                out[c] += lamps[i, 7 + c] * power * facing
    return own


@njit(cache=True)
@no_type_check
def shade(directions, range_m, face, lit, dimmed, mirrored, width, origin, pixel_rad,
          normal, albedo, glow, material, moving_from, lamps, headlamps, floor_m, sky, out):  # fmt: skip
    """Write the radiance that reaches the camera along each ray into ``out``, shape (n, 3).

    Koschmieder's law joins what is seen and the airlight: I = J exp(-a d) + A (1 - exp(-a d)).
    """
    one, half = np.float32(1), np.float32(0.5)
    colour, light, mirror = np.zeros(3, np.float32), np.zeros(3, np.float32), np.zeros(3, np.float32)
    for i in range(directions.shape[0]):
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        if dx == 0 and dy == 0 and dz == 0:  # beyond the fold of the distortion: no light comes this way
            out[i, 0] = out[i, 1] = out[i, 2] = np.float32(0)
            continue
        far = range_m[i]
        f = face[i]
        if f < 0:
            far = _distant(colour, dx, dy, dz, floor_m, sky)
        else:
            px, py, pz = dx * far, dy * far, dz * far
            nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
            cosine = -(nx * dx + ny * dy + nz * dz)
            if cosine < 0:
                nx, ny, nz, cosine = -nx, -ny, -nz, -cosine
            kind = material[f]
            x, y, z = origin[0] + px, origin[1] + py, origin[2] + pz
            fixed = f < moving_from
            footprint = far * pixel_rad / max(cosine, np.float32(0.02))
            r, g, b = albedo[f, 0], albedo[f, 1], albedo[f, 2]
            wet, snow, retro = np.float32(0), np.float32(0), np.float32(0)
            if fixed:
                if nz > 0.7 or nz < -0.9:
                    if kind == _LANE_PAINT:
                        wear = noise2(x * 5, y * 5, 9) * np.float32(min(1.0, 0.25 / max(footprint, 1e-6)))
                        tone = one - np.float32(0.35) * wear * wear
                    else:
                        tone = _ground_tone(kind, x, y, footprint)
                    wet = sky.water * nz * (np.float32(0.35) if kind in (_GRASS, _SOIL) else one)
                elif kind == _FOLIAGE:
                    tone = np.float32(0.6) + np.float32(0.8) * hash01(f, 3, 5)
                else:
                    along = x * ny - y * nx
                    tone = _wall_tone(kind, along, z, footprint)
                    if kind == _SIGN and _sign_mark(along, z, footprint):
                        r, g, b = (np.float32(0.75), np.float32(0.75), np.float32(0.74)) if g + b < 0.9 else (
                            np.float32(0.03), np.float32(0.03), np.float32(0.03))  # fmt: skip
                r, g, b = r * tone, g * tone, b * tone
                if (kind in (_GRASS, _FOLIAGE)) and sky.winter > 0:
                    w = np.float32(sky.winter) * (np.float32(0.5) + half * noise2(x * 0.4, y * 0.4, 14))
                    level = r + g + b
                    r, g, b = r + w * (level * np.float32(0.46) - r), g + w * (level * np.float32(0.37) - g), b + w * (
                        level * np.float32(0.20) - b)  # fmt: skip
                if sky.snow > 0 and nz > 0.35:
                    snow = _snow_cover(kind, x, y, nz, footprint, sky)
                    r, g, b = r + snow * (np.float32(0.80) - r), g + snow * (np.float32(0.82) - g), b + snow * (
                        np.float32(0.86) - b)  # fmt: skip
            if wet > 0:
                wet *= one - snow
                dark = one - np.float32(0.45) * wet
                r, g, b = r * dark, g * dark, b * dark
            if kind in (_SIGN, _PLATE):
                retro = np.float32(25)
            elif kind == _LANE_PAINT:
                retro = np.float32(1.5)
            # light that falls on the place
            upward = half + half * nz
            sunward = nx * sky.sun[0] + ny * sky.sun[1] + nz * sky.sun[2]
            if kind == _FOLIAGE:
                sunward = np.float32(0.35) + np.float32(0.4) * abs(sunward)
            sunward = max(np.float32(0), sunward) * lit[i]
            for c in range(3):
                ambient = sky.bounce_rgb[c] + (sky.ambient_rgb[c] - sky.bounce_rgb[c]) * upward
                light[c] = ambient * dimmed[i] + sky.sun_rgb[c] * sunward
            own = np.float32(0)
            if lamps.shape[0] > 0:
                own = _lamp_light(light, lamps, headlamps, px, py, pz, nx, ny, nz)
            colour[0], colour[1], colour[2] = r * light[0], g * light[1], b * light[2]
            # what it mirrors of the sky and the sun
            gloss = np.float32(0)
            if kind == _GLASS:
                gloss = np.float32(0.05)
            elif kind == _CAR_PAINT:
                gloss = np.float32(0.045)
            elif kind in (_METAL, _LAMP):
                gloss = np.float32(0.10)
            elif wet > 0.05:
                gloss = np.float32(0.03) * wet * (np.float32(0) if kind in (_GRASS, _SOIL) else one)
            if gloss > 0:
                graze = one - cosine
                share = gloss + (one - gloss) * graze * graze * graze * graze * graze
                if wet > 0.05:
                    share = min(share * wet, np.float32(0.35))
                twice = np.float32(2) * cosine
                rx, ry, rz = dx + twice * nx, dy + twice * ny, dz + twice * nz
                sky_into(mirror, rx, ry, max(rz, np.float32(0)), sky, False)
                if wet > 0.05 and mirrored.shape[0] > 0:
                    _wet_mirror(mirror, mirrored, i, width, albedo, glow, sky)
                low = min(one, max(np.float32(0), half + rz * np.float32(6)))
                shine = max(np.float32(0), rx * sky.sun[0] + ry * sky.sun[1] + rz * sky.sun[2]) ** 60 * lit[i]
                for c in range(3):
                    reflected = mirror[c] * low * dimmed[i] + sky.bounce_rgb[c] * (one - low)
                    colour[c] += share * (reflected - colour[c] * half) + gloss * np.float32(8) * shine * sky.sun_rgb[c]
            if sky.night > 0:
                straight = one if not fixed or kind != _LAMP else np.float32(0.6)
                for c in range(3):
                    colour[c] += glow[f, c] * straight * (np.float32(0.25) + np.float32(0.75) * cosine)
                if retro > 0:
                    colour[0] += r * retro * own
                    colour[1] += g * retro * own
                    colour[2] += b * retro * own
        through = np.exp(-np.float32(sky.extinction_per_m) * far)
        for c in range(3):
            out[i, c] = colour[c] * through + sky.horizon_rgb[c] * (one - through)


@njit(cache=True)
@no_type_check
def _wet_mirror(mirror, mirrored, i, width, albedo, glow, sky):
    """Turn the sky that a wet road mirrors into what stands there, cast at one pixel in four of each row."""
    u = i % width
    left = i - (u - first_known(i // width)) % 4
    row = i - u
    part = np.float32(0.25) * np.float32(i - left)
    r, g, b = mirror[0], mirror[1], mirror[2]
    mirror[0] = mirror[1] = mirror[2] = np.float32(0)
    for side in range(2):
        j = min(max(left + 4 * side, row), row + width - 1)
        share = part if side == 1 else np.float32(1) - part
        f = mirrored[j]
        if f < 0:
            mirror[0] += share * r
            mirror[1] += share * g
            mirror[2] += share * b
        else:
            for c in range(3):
                light = np.float32(0.6) * sky.ambient_rgb[c] + np.float32(0.2) * sky.bounce_rgb[c]
                mirror[c] += share * (albedo[f, c] * light + sky.night * glow[f, c])


@njit(cache=True)
@no_type_check
def first_known(row):
    """First of the columns, four apart, at which a row's shadows and mirror images are cast."""
    step = row & 3
    return 2 * (step & 1) + (step >> 1)


@njit(cache=True)
@no_type_check
def _snow_cover(kind, x, y, nz, footprint, sky):
    """Share of a place under snow: drifts by noise of four sizes; traffic keeps the road darker."""
    need = np.float32(0.34) * noise2(x * 0.16, y * 0.16, 15) + np.float32(0.30) * noise2(x * 0.8, y * 0.8, 16)
    need += np.float32(0.5) * np.float32(0.36)
    if footprint < 0.5:
        fine = np.float32(0.22) * noise2(x * 3.7, y * 3.7, 17) + np.float32(0.14) * noise2(x * 15, y * 15, 18)
        need += (fine - np.float32(0.18)) * (np.float32(1) - np.float32(2) * np.float32(footprint))
    have = np.float32(sky.snow)
    if kind in (_ASPHALT, _LANE_PAINT):
        have *= np.float32(0.78)
    cover = min(np.float32(1), max(np.float32(0), (have - need) / np.float32(0.3) + np.float32(0.5)))
    return cover * min(np.float32(1), (nz - np.float32(0.35)) * np.float32(4))


@njit(cache=True)
@no_type_check
def _distant(colour, dx, dy, dz, floor_m, sky):
    """What a ray meets that hits nothing: far land, a far line of hills, or sky; returns how far through the air."""
    if dz < -0.0005:
        tone = np.float32(0.5) * (sky.ambient_rgb[1] + sky.sun_rgb[1] * max(np.float32(0), sky.sun[2]))
        far = np.float32(floor_m) / -dz
        snow = np.float32(sky.snow)
        for c in range(3):
            land = np.float32(0.22) if c == 0 else (np.float32(0.24) if c == 1 else np.float32(0.13))
            colour[c] = tone * (land + (np.float32(1.5) - land) * snow)
        return far
    if dz < 0.06:
        turn = np.arctan2(dy, dx)
        ridge = np.float32(0.045) * noise2(turn * 3.0, 0.5, 41) + np.float32(0.012) * noise2(turn * 21.0, 0.5, 42)
        ridge += np.float32(0.004) * noise2(turn * 160.0, 0.5, 43) - np.float32(0.012)
        if dz < ridge:
            tone = np.float32(0.09) * (sky.ambient_rgb[1] + sky.sun_rgb[1] * half_of(sky.sun[2]))
            colour[0], colour[1], colour[2] = tone, tone * np.float32(1.1), tone * np.float32(0.8)
            return np.float32(2500)
    sky_into(colour, dx, dy, dz, sky, True)
    return min(np.float32(60000), np.float32(sky.layer_m) / max(dz, np.float32(1e-4)))


@njit(cache=True)
@no_type_check
def half_of(value):
    """Half of a value, never below 0."""
    return max(np.float32(0), value) * np.float32(0.5)


# Shadows


@njit(cache=True)
@no_type_check
def fill_light(lit, is_sampled, range_m, face, height, width, out):
    """Spread shadows that were cast at one pixel in four to all.

    Each pixel takes the mean of the sampled pixels about it that lie at much the same distance, near ones first: those
    of its own row and the rows above and below, where one pixel in four of every row and every column is sampled.
    """
    for v in range(height):
        for u in range(width):
            i = v * width + u
            if face[i] < 0:
                out[i] = np.float32(1)
                continue
            weight = np.float32(1.5) if is_sampled[i] else np.float32(0)
            total = weight * lit[i]
            for r in range(max(0, v - 1), min(height, v + 2)):
                for q in range(max(0, u - 3), min(width, u + 4)):
                    j = r * width + q
                    if j != i and is_sampled[j] and abs(range_m[j] - range_m[i]) < np.float32(0.05) * range_m[i]:
                        w = np.float32(1) / np.float32((q - u) ** 2 + 6 * (r - v) ** 2)
                        if face[j] != face[i]:
                            w *= np.float32(0.25)
                        total += w * lit[j]
                        weight += w
            out[i] = total / weight if weight > 0 else np.float32(1)


@njit(cache=True)
@no_type_check
def contact(dimmed, range_m, directions, face, moving_from, rows, columns, width, body_T_world, shift, half_m):
    """Dim the sky's light on the ground under and beside a road user, by the distance from its outline."""
    for v in range(rows[0], rows[1]):
        for u in range(columns[0], columns[1]):
            i = v * width + u
            if face[i] < 0 or face[i] >= moving_from:
                continue
            far = range_m[i]
            px, py, pz = (
                directions[i, 0] * far + shift[0],
                directions[i, 1] * far + shift[1],
                directions[i, 2] * far + shift[2],
            )
            bx = abs(body_T_world[0, 0] * px + body_T_world[0, 1] * py + body_T_world[0, 2] * pz) - half_m[0]
            by = abs(body_T_world[1, 0] * px + body_T_world[1, 1] * py + body_T_world[1, 2] * pz) - half_m[1]
            bz = abs(body_T_world[2, 0] * px + body_T_world[2, 1] * py + body_T_world[2, 2] * pz)
            if bz > 0.5 or bx > 1.5 or by > 1.5:
                continue
            outside = np.sqrt(max(bx, 0.0) ** 2 + max(by, 0.0) ** 2) + min(max(bx, by), 0.0)
            fade_m = np.float32(0.28)
            dimmed[i] *= np.float32(1) - np.float32(0.85) / (
                np.float32(1) + np.exp(np.float32(outside) / fade_m * np.float32(2))
            )
