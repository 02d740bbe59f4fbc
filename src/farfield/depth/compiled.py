"""Drawing depth maps, compiled by numba; :mod:`farfield.depth.rings` says the same in numpy.

``no_type_check`` keeps runtime type checkers, which tests switch on, out of compiled functions.
"""

from typing import no_type_check

import numpy as np

from farfield.errors import MissingExtraError

try:
    from numba import njit
except ImportError as error:
    raise MissingExtraError("numba", "simulate", "Drawing depth maps with compiled code") from error


@njit(
    "void(float64[:, :, ::1], float64[:, ::1], float64[:, :, ::1], int64[::1], float64[::1], float64, float64[::1], "
    "float64[:, ::1], float64[:, ::1])",
    cache=True,
)
@no_type_check
def draw(points, spread, slopes, rows, distortion, fold, focal, depth, doubt):
    """Keep the nearest of the points between rings in each pixel, and its doubt."""
    height, width = depth.shape
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    for lower in range(points.shape[0]):
        upper = lower + 1 if rows[lower] > 1 else lower
        for row in range(rows[lower]):
            share = row / rows[lower]
            near = 2 * min(share, 1 - share)
            for column in range(points.shape[1]):
                first, second = points[lower, column], points[upper, column]
                along = spread[lower, column]
                x, y, z, q = first[0], first[1], first[2], first[3]
                if row > 0:
                    x += (second[0] - x) * share
                    y += (second[1] - y) * share
                    z += (second[2] - z) * share
                    q += (second[3] - q) * share
                if not z > 0:  # NaN too
                    continue
                x /= z
                y /= z
                r2 = x * x + y * y
                if not r2 < fold:
                    continue
                radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
                u = (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) * focal[0] + focal[2]
                v = (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) * focal[1] + focal[3]
                to_u, to_v = np.rint(u), np.rint(v)
                if not (to_u >= 0 and to_u < width and to_v >= 0 and to_v < height):
                    continue
                slope = slopes[lower, column]
                inverse = q / z + slope[0] * (to_u - u) + slope[1] * (to_v - v)
                i, j, z = int(to_v), int(to_u), 1 / min(max(inverse, slope[2]), slope[3])
                if z <= depth[i, j]:
                    depth[i, j] = z
                    if row > 0:
                        apart = abs(1 / first[3] - 1 / second[3])
                        doubt[i, j] = along * (1 - share) + spread[upper, column] * share + near * apart
                    else:
                        doubt[i, j] = along


@njit(
    "void(float64[::1], float64[:, ::1], int64[::1], float64[::1], float64, float64[:, :, ::1], float64[:, ::1])",
    cache=True,
)
@no_type_check
def sample(azimuth, points, starts, grid, max_gap, sampled, spread):
    """Interpolate each ring at the grid's azimuths; see ``rings._sample_ring``."""
    for ring in range(len(starts) - 1):
        after, last = starts[ring] + 1, starts[ring + 1] - 1
        for column in range(len(grid)):
            while after < last and azimuth[after] < grid[column]:
                after += 1
            gap = azimuth[after] - azimuth[after - 1]
            share = (grid[column] - azimuth[after - 1]) / max(gap, 1e-9)
            first, second = points[after - 1], points[after]
            for k in range(4):
                sampled[ring, column, k] = first[k] + (second[k] - first[k]) * share
            if gap > max_gap or share < 0 or share > 1:
                sampled[ring, column] = np.nan
            spread[ring, column] = 2 * min(share, 1 - share) * abs(1 / first[3] - 1 / second[3])


@njit("void(float64[:, :, ::1], float64[:, :, ::1], float64[:, :, ::1])", cache=True)
@no_type_check
def slopes_of(points, pixels, slopes):
    """How 1 / z changes per pixel on each patch, and its least and most; see ``rings._slopes``."""
    for i in range(points.shape[0] - 1):
        for j in range(points.shape[1] - 1):
            here, right = points[i, j, 3] / points[i, j, 2], points[i, j + 1, 3] / points[i, j + 1, 2]
            above = points[i + 1, j, 3] / points[i + 1, j, 2]
            au, av = pixels[i, j + 1, 0] - pixels[i, j, 0], pixels[i, j + 1, 1] - pixels[i, j, 1]
            bu, bv = pixels[i + 1, j, 0] - pixels[i, j, 0], pixels[i + 1, j, 1] - pixels[i, j, 1]
            area = au * bv - av * bu
            if area == 0:
                continue
            to_right = ((right - here) * bv - (above - here) * av) / area
            down = ((above - here) * au - (right - here) * bu) / area
            if np.isfinite(to_right) and np.isfinite(down):  # all three corners are there
                slopes[i, j, 0], slopes[i, j, 1] = to_right, down
                slopes[i, j, 2], slopes[i, j, 3] = min(here, right, above), max(here, right, above)


@njit("void(float64[:, ::1], float64[:, ::1], float64, float64, float32[:, :, ::1])", cache=True)
@no_type_check
def channels_of(depth, doubt, slope, step, out):
    """Weight, 1 / z, its square and the doubt of the depths that nothing in the 3 x 3 pixels round them hides."""
    height, width = depth.shape
    for i in range(height):
        for j in range(width):
            z = depth[i, j]
            if not z < np.inf:
                continue
            least = z
            for k in range(max(i - 1, 0), min(i + 2, height)):
                for m in range(max(j - 1, 0), min(j + 2, width)):
                    least = min(least, depth[k, m])
            if z <= (1 + slope) * least + step:
                inverse = np.float32(1 / z)
                out[0, i, j], out[1, i, j] = np.float32(1), inverse
                out[2, i, j], out[3, i, j] = inverse * inverse, np.float32(doubt[i, j])


@njit("void(float32[:, :, ::1], float32[::1], float32[::1], float32[:, ::1], float32[:, ::1])", cache=True)
@no_type_check
def blend(channels, half, numbers, depth, doubt):
    """Convolve the four channels with a symmetric kernel of 9, given from its middle outwards, and divide."""
    count, height, width = channels.shape
    least, sigma, hole = numbers[0], numbers[1], numbers[2]
    one, nothing, two = np.float32(1), np.float32(0), np.float32(-2)
    line = np.zeros((count, width + 8), dtype=np.float32)
    rows = np.zeros((9, width), dtype=np.float32)
    any_there = np.zeros(height + 8, dtype=np.bool_)
    for i in range(height):
        any_there[i + 4] = channels[0, i].any()
    a, b, c, d, e = half[0], half[1], half[2], half[3], half[4]
    for i in range(height):
        if not any_there[i : i + 9].any():
            continue
        for n in range(count):
            for k in range(9):
                if 0 <= i + k - 4 < height:
                    rows[k] = channels[n, i + k - 4]
                else:
                    rows[k] = 0
            for j in range(width):
                near = a * rows[4, j] + b * (rows[3, j] + rows[5, j]) + c * (rows[2, j] + rows[6, j])
                line[n, j + 4] = near + d * (rows[1, j] + rows[7, j]) + e * (rows[0, j] + rows[8, j])
            row = rows[0]
            for j in range(width):
                near = a * line[n, j + 4] + b * (line[n, j + 3] + line[n, j + 5])
                near += c * (line[n, j + 2] + line[n, j + 6])
                row[j] = near + d * (line[n, j + 1] + line[n, j + 7]) + e * (line[n, j] + line[n, j + 8])
            line[n, 4 : width + 4] = row
        for j in range(width):
            weight = line[0, j + 4]
            if weight > least:
                mean = line[1, j + 4] / weight
                spread = np.sqrt(max(line[2, j + 4] / weight - mean * mean, nothing)) / (mean * mean)
                away = nothing
                if weight < one:
                    away = sigma * np.sqrt(two * np.log(weight))
                depth[i, j], doubt[i, j] = one / mean, line[3, j + 4] / weight + spread + hole * away


@njit("void(int64[:, :, ::1], float64[:, ::1], float64, float64[:, ::1], float64[:, ::1])", cache=True)
@no_type_check
def fill(corners, sparse, longest, depth, doubt):
    """Fill the triangles whose edges' squares are at most ``longest``; see ``completion._fill``."""
    for n in range(len(corners)):
        (x0, y0), (x1, y1), (x2, y2) = corners[n, 0], corners[n, 1], corners[n, 2]
        long = max((x1 - x0) ** 2 + (y1 - y0) ** 2, (x2 - x1) ** 2 + (y2 - y1) ** 2, (x0 - x2) ** 2 + (y0 - y2) ** 2)
        if long > longest:
            continue
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        if y1 > y2:
            x1, y1, x2, y2 = x2, y2, x1, y1
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        area = float((x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0))
        if area == 0:
            continue
        z0, z1, z2 = sparse[y0, x0], sparse[y1, x1], sparse[y2, x2]
        spread = max(z0, z1, z2) - min(z0, z1, z2)
        two_u, two_v, three_u, three_v = (y2 - y0) / area, (x0 - x2) / area, (y0 - y1) / area, (x1 - x0) / area
        for y in range(y0, y2 + 1):
            one = x0 + (x2 - x0) * (y - y0) / (y2 - y0)
            other = x0 + (x1 - x0) * (y - y0) / (y1 - y0) if y < y1 else x1 + (x2 - x1) * (y - y1) / max(y2 - y1, 1)
            for x in range(int(np.ceil(min(one, other) - 1e-6)), int(np.floor(max(one, other) + 1e-6)) + 1):
                two = two_u * (x - x0) + two_v * (y - y0)
                three = three_u * (x - x0) + three_v * (y - y0)
                inverse = 1 / z0 + two * (1 / z1 - 1 / z0) + three * (1 / z2 - 1 / z0)
                depth[y, x] = 1 / max(inverse, 1e-6)
                doubt[y, x] = 1.5 * (1 - min(max(two, three, 1 - two - three), 1)) * spread
