"""The Cirrus car's measurements as a Frame."""

from functools import cache, partial
from typing import Any

from farfield.frame import Frame, Lazy
from farfield.simulation.rigs.drive import Drive


def cirrus_frame(drive: Drive, index: int, sensors: tuple[str, ...], time_ns: int) -> Frame:
    """A frame without its pose; nothing is simulated before it is read."""

    @cache
    def moment() -> Any:
        from farfield.simulation.rigs.cirrus import CirrusMoment

        return CirrusMoment(drive, index)

    offset_ns = round(drive.mounted.uniform_offset_s * 1e9)
    clouds = [name for name in ("gaussian", "uniform") if name in sensors]
    with_camera = "camera" in sensors
    times = {"gaussian": time_ns, "uniform": time_ns + offset_ns, "camera": time_ns}
    metadata: dict[str, Any] = {
        "full_boxes": lambda: moment().annotation.full,
        "point_count_gaussian": lambda: moment().annotation.gaussian_points,
        "point_count_uniform": lambda: moment().annotation.uniform_points,
        "box_protocol": lambda: "visible",
        "preset": lambda: drive.preset.name,
        "seed": lambda: drive.seed,
        "simulated": lambda: True,
        "weather": lambda: drive.weather,
        "shots": lambda: dict.fromkeys(clouds, drive.preset.lines * drive.preset.columns),
    }
    return Frame(
        sequence=drive.segment.name,
        frame_id=str(time_ns),
        time_ns=time_ns,
        times_ns={name: times[name] for name in sensors},
        clouds=Lazy({name: partial(lambda each: moment().cloud(each), name) for name in clouds}),
        images=Lazy({"camera": lambda: moment().image} if with_camera else {}),
        cameras=Lazy({"camera": lambda: moment().camera} if with_camera else {}),
        annotation=lambda: moment().annotation.visible,
        conditions={"road": drive.segment.road, "weather": drive.segment.condition, "time": drive.segment.time},
        metadata=Lazy(metadata),
    )
