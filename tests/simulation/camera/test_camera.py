"""Cameras: what is where in a picture by projection, what fog takes by Koschmieder's law, what night and sun do."""

import dataclasses

import numpy as np
import pytest
from _validation_scenes import on_asphalt, painted

from farfield.errors import ConfigError
from farfield.geometry.cameras import Camera
from farfield.geometry.poses import invert, pose_from_yaw, transform_points
from farfield.simulation.bodies.actors import Actor
from farfield.simulation.bodies.materials import Material
from farfield.simulation.bodies.mesh import box
from farfield.simulation.camera.cast import cast_image, place_bodies, ray_grid
from farfield.simulation.camera.lens import auto_gain, srgb_curve, window_cover
from farfield.simulation.camera.mounts import CIRRUS_FRONT, KRADAR_MOUNTS, STEREO_BASELINE_M, ZED_2I, Mount, rig_cameras
from farfield.simulation.camera.render import radiance, render
from farfield.simulation.camera.sky import make_sky, visible_extinction
from farfield.simulation.weather.conditions import Weather, draw_weather
from farfield.simulation.world.scene import SceneWindow
from farfield.vocabulary.conditions import WEATHERS

HEIGHT_M = 1.45
SMALL = Mount(
    dataclasses.replace(ZED_2I, matrix=(142.0, 144.0, 157.0, 92.0), width_px=320, height_px=180), (0.0, 0.0, HEIGHT_M)
)
OVERCAST = Weather("overcast", cloud_cover=1.0)


def at(x_m: float, y_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    return pose_from_yaw(yaw_rad, np.array([x_m, y_m, 0.0]))


def pixels_of(window: SceneWindow, camera: Camera, body: int) -> np.ndarray:
    """Pixels (u, v) that see a body."""
    placed = place_bodies(window)
    picture = cast_image(placed, ray_grid(camera), invert(camera.camera_T_lidar))
    first = placed[body].first_face
    seen = (picture.face >= first) & (picture.face < first + len(placed[body].tracer.mesh.faces))
    v, u = np.divmod(np.flatnonzero(seen), camera.width_px)
    return np.stack([u, v], axis=1)


@pytest.mark.parametrize("place_m", [(12.0, 0.0), (12.0, 7.0), (6.0, -4.5), (40.0, 10.0)])
def test_a_box_is_seen_where_the_camera_projects_it(place_m: tuple[float, float]) -> None:
    camera = SMALL.camera(np.eye(4))
    mesh = painted(box([0.5, 1.2, 1.0], [0.0, 0.0, 0.9], int(Material.CAR_PAINT)))
    window = on_asphalt((mesh, at(*place_m)))
    seen = pixels_of(window, camera, 1)
    projected, _, _ = camera.project(transform_points(at(*place_m), mesh.vertices_m))
    np.testing.assert_allclose(seen.min(axis=0), projected.min(axis=0), atol=1.0)
    np.testing.assert_allclose(seen.max(axis=0), projected.max(axis=0), atol=1.0)


def test_stereo_disparity_is_focal_length_times_baseline_over_depth() -> None:
    plain = dataclasses.replace(ZED_2I, distortion=(0.0,) * 5)
    depth_m = 9.0
    middles = []
    for side in ("front_left", "front_right"):
        mount = dataclasses.replace(KRADAR_MOUNTS[side], lens=plain)
        mesh = painted(box([0.01, 0.6, 0.6], [0.0, 0.0, 1.4], int(Material.TRIM)))
        window = on_asphalt((mesh, at(mount.place_m[0] + depth_m + 0.005, 0.0)))
        middles.append(pixels_of(window, mount.camera(np.eye(4)), 1)[:, 0].mean())
    assert middles[0] - middles[1] == pytest.approx(567.72 * STEREO_BASELINE_M / depth_m, abs=0.5)


def test_a_straight_pole_bends_as_the_distortion_says() -> None:
    strong = dataclasses.replace(SMALL.lens, distortion=(-0.2, 0.03, 0.0, 0.0, 0.0))
    camera = dataclasses.replace(SMALL, lens=strong).camera(np.eye(4))
    pole = painted(box([0.12, 0.12, 8.0], [0.0, 0.0, 2.0], int(Material.METAL)))
    seen = pixels_of(on_asphalt((pole, at(5.0, 4.5)), fixed=painted(box([1, 1, 1], [-9, 0, 0], 0))), camera, 1)
    heights = np.linspace(-0.9, 3.9, 9)
    expected, _, inside = camera.project(np.stack([np.full(9, 5.0), np.full(9, 4.5), heights], axis=1))
    assert inside.all()
    assert np.ptp(expected[:, 0]) > 2.0
    for u, v in expected:
        row = seen[seen[:, 1] == round(v), 0]
        assert row.mean() == pytest.approx(u, abs=1.0)


def test_pixels_beyond_the_fold_of_the_distortion_stay_black() -> None:
    folding = dataclasses.replace(SMALL.lens, distortion=(-0.25, 0.0, 0.0, 0.0, 0.0))
    image, range_m = radiance(
        on_asphalt(), dataclasses.replace(SMALL, lens=folding).camera(np.eye(4)), np.eye(4), OVERCAST
    )
    assert image[0, 0].max() == image[-1, -1].max() == 0.0
    assert np.isinf(range_m[-1, -1])
    assert image[90, 60:250].min() > 0.0


def test_contrast_of_a_black_target_is_5_percent_at_the_optical_range() -> None:
    """Koschmieder, and the definition of the meteorological optical range (validation test 3)."""
    camera = SMALL.camera(np.eye(4))
    for mor_m in (60.0, 150.0):
        weather = dataclasses.replace(OVERCAST, condition="fog", mor_m=mor_m)
        contrasts = []
        for share in (0.5, 1.0):
            black = box([1.0, 60.0, 60.0], [0.5, 0.0, 0.0], int(Material.TYRE))
            window = on_asphalt((painted(black), at(share * mor_m, 0.0)))
            image, range_m = radiance(window, camera, np.eye(4), weather)
            body = radiance(window, camera, np.eye(4), dataclasses.replace(weather, mor_m=1e9))[0]
            level = image[92, 157]
            assert range_m[92, 157] == pytest.approx(share * mor_m, rel=1e-3)
            horizon = make_sky(weather).horizon_rgb
            assert body[92, 157].max() < 0.05 * horizon.min()
            contrasts.append(((horizon - level) / horizon / (1 - body[92, 157] / horizon)).mean())
        assert contrasts[0] == pytest.approx(0.05**0.5, rel=0.01)
        assert contrasts[1] == pytest.approx(0.05, rel=0.01)


def test_extinction_follows_the_published_formulas() -> None:
    clear = Weather(mor_m=1e12)
    assert visible_extinction(Weather("fog", mor_m=100.0)) == pytest.approx(2.996 / 100, rel=1e-3)
    assert visible_extinction(dataclasses.replace(clear, rain_mm_h=10.0)) == pytest.approx(1.56e-3, rel=0.01)
    dry = [visible_extinction(dataclasses.replace(clear, snow_mm_h=rate)) for rate in (1.0, 2.0, 3.0)]
    np.testing.assert_allclose(dry, [1.3e-3, 3.3e-3, 5.9e-3], rtol=0.03)
    wet = [visible_extinction(dataclasses.replace(clear, snow_mm_h=rate, wet_snow=True)) for rate in (1.0, 2.0, 3.0)]
    np.testing.assert_allclose(wet, [0.9e-3, 1.5e-3, 2.0e-3], rtol=0.05)


def test_fog_pulls_equal_cars_towards_the_airlight_the_farther_the_more() -> None:
    camera = SMALL.camera(np.eye(4))
    weather = dataclasses.replace(OVERCAST, condition="fog", mor_m=120.0)
    airlight = make_sky(weather).horizon_rgb.mean()
    missing = []
    for x in (10.0, 25.0, 50.0, 90.0):
        dark = painted(box([0.5, 3.0, 3.0], [0.25, 0.0, 1.5], int(Material.TYRE)))
        image, _ = radiance(on_asphalt((dark, at(x, 0.0))), camera, np.eye(4), weather)
        missing.append(airlight - image[90, 157].mean())
    assert (np.diff(missing) < 0).all()
    assert missing[-1] > 0


def test_the_shadow_of_a_box_lies_where_the_sun_throws_it() -> None:
    camera = SMALL.camera(np.eye(4))
    weather = Weather(sun_elevation_deg=45.0, sun_azimuth_deg=90.0, cloud_cover=0.0)  # the sun stands to the left
    block = painted(box([3.0, 1.0, 2.0], [0.0, 0.0, 1.0], int(Material.TRIM)))
    image, _ = radiance(on_asphalt((block, at(12.0, 0.0))), camera, np.eye(4), weather)
    spots = np.array(
        [[12.0, -1.5, 0.0], [12.0, -3.2, 0.0], [12.0, 2.0, 0.0]]
    )  # within the shadow, beyond it, sunny side
    pixels = np.round(camera.project(spots)[0]).astype(int)
    shade, beyond, sunny = (image[v, u].mean() for u, v in pixels)
    assert shade < 0.55 * beyond
    assert sunny == pytest.approx(beyond, rel=0.25)


def test_a_wet_road_mirrors_a_wall_where_a_plane_mirror_would() -> None:
    """The image of a point stands as far below the road as the point stands above it."""
    camera = SMALL.camera(np.eye(4))
    wall = painted(box([0.2, 8.0, 1.2], [0.0, 0.0, 1.4], int(Material.TYRE)))  # black, from 0.8 m to 2.0 m
    window = on_asphalt((wall, at(14.0, 0.0)))
    wet = dataclasses.replace(OVERCAST, water_mm=1.0)
    with_wall, _ = radiance(window, camera, np.eye(4), wet)
    without, _ = radiance(on_asphalt(), camera, np.eye(4), wet)
    images = np.array([[14.0, 0.0, -1.2], [14.0, 0.0, -0.4], [14.0, 7.0, -1.4]])  # in the image, above it, beside it
    inside, above, beside = (
        (with_wall[v - 1 : v + 2, u - 6 : u + 7].mean() / without[v - 1 : v + 2, u - 6 : u + 7].mean())
        for u, v in np.round(camera.project(images)[0]).astype(int)
    )
    assert inside < 0.8
    assert above > 0.93
    assert beside > 0.97
    dry, _ = radiance(window, camera, np.eye(4), OVERCAST)
    u, v = np.round(camera.project(images[:1])[0][0]).astype(int)
    assert dry[v, u].mean() == pytest.approx(
        radiance(on_asphalt(), camera, np.eye(4), OVERCAST)[0][v, u].mean(), rel=0.02
    )


def test_there_is_no_sun_shadow_under_cloud_but_it_is_darker_under_a_car() -> None:
    camera = SMALL.camera(np.eye(4))
    raised = painted(box([4.0, 1.8, 1.0], [0.0, 0.0, 0.9], int(Material.TRIM)))
    image, _ = radiance(on_asphalt((raised, at(9.0, 0.0))), camera, np.eye(4), OVERCAST)
    spots = np.array([[7.3, 0.0, 0.0], [9.0, -3.0, 0.0]])
    under, beside = (image[v, u].mean() for u, v in np.round(camera.project(spots)[0]).astype(int))
    assert under < 0.5 * beside


def test_night_is_darker_than_day_and_the_head_lamps_light_what_is_near() -> None:
    camera = SMALL.camera(np.eye(4))
    night = Weather(time="night", sun_elevation_deg=-20.0)
    pictures = [
        render(on_asphalt(), camera, np.eye(4), weather, np.random.default_rng(1)) for weather in (Weather(), night)
    ]
    assert pictures[1].mean() < 0.5 * pictures[0].mean()
    image, _ = radiance(on_asphalt(), camera, np.eye(4), night)
    spots = np.array([[12.0, 0.0, 0.0], [60.0, 0.0, 0.0], [12.0, 20.0, 0.0]])
    near, far, aside = (image[v, u].mean() for u, v in np.round(camera.project(spots)[0]).astype(int))
    assert near > 3 * far
    assert near > 3 * aside


def test_lamps_shine_white_in_front_and_red_behind_at_night_when_moving() -> None:
    camera = SMALL.camera(np.eye(4))
    night = Weather(time="night", sun_elevation_deg=-20.0)
    car = Actor(0, "sedan", (4.6, 1.85, 1.5), np.random.SeedSequence(4)).build()
    looks = {}
    for name, yaw in (("rear", 0.0), ("front", np.pi)):
        image, _ = radiance(on_asphalt((car, at(10.0, 0.0, yaw))), camera, np.eye(4), night)
        looks[name] = image.reshape(-1, 3)[image.sum(axis=2).argmax()]
    assert looks["front"][2] > 0.5 * looks["front"][0]
    assert looks["front"].sum() > 20
    lit = radiance(on_asphalt((car, at(10.0, 0.0))), camera, np.eye(4), night)[0]
    parked = on_asphalt((car, at(10.0, 0.0)))
    dark = radiance(dataclasses.replace(parked, velocity_m_s=np.zeros((1, 3))), camera, np.eye(4), night)[0]
    extra = (lit - dark).reshape(-1, 3)
    strongest = extra[extra[:, 0].argmax()]
    assert strongest[0] > 1.0
    assert strongest[0] > 10 * strongest[2]


@pytest.mark.parametrize("condition", WEATHERS)
def test_every_weather_gives_the_same_bytes_for_the_same_seed(condition: str) -> None:
    camera = SMALL.camera(np.eye(4))
    car = Actor(0, "suv", (4.6, 1.85, 1.7), np.random.SeedSequence(4)).build()
    window = on_asphalt((car, at(10.0, 1.0)))
    weather = draw_weather(condition, "day", np.random.default_rng(3))
    first, again, other = (render(window, camera, np.eye(4), weather, np.random.default_rng(s)) for s in (1, 1, 2))
    assert first.shape == (180, 320, 3)
    assert first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert 30 < first.mean() < 230


def test_supersampling_keeps_the_picture_and_its_size() -> None:
    camera = SMALL.camera(np.eye(4))
    car = Actor(0, "suv", (4.6, 1.85, 1.7), np.random.SeedSequence(4)).build()
    window = on_asphalt((car, at(10.0, 1.0)))
    once, once_m = radiance(window, camera, np.eye(4), OVERCAST)
    twice, twice_m = radiance(window, camera, np.eye(4), OVERCAST, supersample=2)
    assert twice.shape == once.shape
    assert np.median(np.abs(twice - once) / (once + 0.01)) < 0.05
    assert np.nanmedian(np.abs(twice_m[np.isfinite(once_m)] / once_m[np.isfinite(once_m)] - 1)) < 0.02


def test_cameras_of_the_rigs_sit_where_their_mounts_say() -> None:
    ego_T_lidar = pose_from_yaw(0.0, np.array([0.0, 0.0, 1.6]))
    cameras = rig_cameras("kradar", ego_T_lidar)
    assert len(cameras) == 8
    left, right = (invert(cameras[name].camera_T_lidar)[:3, 3] for name in ("front_left", "front_right"))
    np.testing.assert_allclose(left - right, [0, STEREO_BASELINE_M, 0], atol=1e-12)
    rear = cameras["rear_left"]
    _, depth, seen = rear.project(np.array([[-20.0, 0.0, 0.0], [20.0, 0.0, 0.0]]))
    assert seen.tolist() == [True, False]
    assert depth[0] == pytest.approx(20 - 1.1, abs=1e-9)
    front = rig_cameras("cirrus", ego_T_lidar)["front"]
    assert (front.width_px, front.height_px) == (CIRRUS_FRONT.width_px, CIRRUS_FRONT.height_px) == (1920, 650)
    with pytest.raises(ConfigError, match="camera rig"):
        rig_cameras("drone", ego_T_lidar)


def test_ice_covers_the_asked_share_and_grows_without_uncovering() -> None:
    seed = np.random.SeedSequence(8)
    little, much = (window_cover(720, 1280, share, seed) for share in (0.2, 0.6))
    assert little.mean() == pytest.approx(0.2 * 0.93, abs=0.05)
    assert much.mean() == pytest.approx(0.6 * 0.93, abs=0.05)
    assert (much >= little).all()
    assert window_cover(720, 1280, 0.0, seed).max() == 0.0


def test_exposure_brings_bright_and_dim_scenes_to_one_level_within_limits() -> None:
    scene = np.random.default_rng(0).uniform(0.1, 0.6, (64, 64, 3)).astype(np.float32)
    assert auto_gain(scene) == pytest.approx(2 * auto_gain(2 * scene), rel=0.02)
    assert auto_gain(scene * np.float32(1e-4)) == pytest.approx(4.0)
    curve = srgb_curve()
    assert (np.diff(curve.astype(int)) >= 0).all()
    assert (curve[0], curve[-1]) == (0, 255)
    assert curve[round(0.2140 * 4095)] == pytest.approx(127.5, abs=1.0)  # sRGB's middle stays the middle
