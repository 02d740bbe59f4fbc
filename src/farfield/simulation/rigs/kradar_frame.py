"""The K-Radar car's measurements as a Frame."""

from functools import cache, partial
from typing import Any

from farfield.frame import Frame, Lazy
from farfield.simulation.rigs.drive import Drive

_LIDARS = ("os2-64", "os1-128")
_CAMERAS = ("cam-front", "cam-left", "cam-right", "cam-rear")
_PRODUCTS = ("cells", "sparse", "polar3d", "cube", "tesseract")
_CAMERA_HZ = 30
_RADAR_LEAD = 5  # the radar's recording began half a second before the LiDARs'


def kradar_frame(drive: Drive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""

    @cache
    def moment() -> Any:
        from farfield.simulation.rigs.kradar import KRadarMoment

        return KRadarMoment(drive, index)

    eyes = [name + side for name in _CAMERAS if name in sensors for side in ("", "-right")]
    products = tuple(name for name in _PRODUCTS if name in sensors)
    return Frame(
        sequence=drive.segment.name,
        frame_id="_".join(f"{number:05d}" for number in _indices(drive, index)[:2]),
        time_ns=time_ns,
        times_ns=dict.fromkeys(sensors, time_ns),
        clouds=Lazy({n: partial(lambda each: moment().cloud(each), n) for n in _LIDARS if n in sensors}),
        images=Lazy({name: partial(lambda each: moment().image(each), name) for name in eyes}),
        cameras=Lazy({name: partial(lambda each: moment().cameras[each], name) for name in eyes}),
        radar=Lazy({name: partial(lambda each: moment().product(each), name) for name in products}),
        annotation=lambda: moment().annotation.boxes,
        conditions={"road": drive.segment.road, "weather": drive.segment.condition, "time": drive.segment.time},
        reference="os2-64",
        metadata=Lazy(_metadata(drive, index, moment)),
    )


def _indices(drive: Drive, index: int) -> tuple[int, int, int, int]:
    """Numbers of the radar's, the os2-64's, the front camera's and the os1-128's frames; LiDARs count from 1."""
    lidar = round(index * drive.preset.stride_s * 10) + 1
    return lidar + _RADAR_LEAD, lidar, (lidar - 1) * _CAMERA_HZ // 10 + 2, lidar


def _metadata(drive: Drive, index: int, moment: Any) -> dict[str, Any]:
    from farfield.simulation.rigs.kradar import LIDAR_T_RADAR, OS2_T_OS1

    radar, lidar, camera, high = _indices(drive, index)
    numbers = {"radar": radar, "os2-64": lidar, "cam-front": camera, "os1-128": high, "cam-lrr": camera}
    return {
        "indices": lambda: numbers,
        "availability": lambda: moment().annotation.availability,
        "snr_db": lambda: moment().annotation.snr_db,
        "os2_T_os1": lambda: OS2_T_OS1,
        "lidar_T_radar": lambda: LIDAR_T_RADAR,
        "box_protocol": lambda: "full",
        "preset": lambda: drive.preset.name,
        "seed": lambda: drive.seed,
        "simulated": lambda: True,
        "weather": lambda: drive.weather,
        "shots": lambda: {"os2-64": 64 * drive.preset.columns, "os1-128": 128 * drive.preset.columns},
    }
