"""``farfield radar``: look at 4D radar frames: power, Doppler and detected echoes beside the camera."""

from functools import partial
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, Reading
from farfield.cli._output import bar, check_outputs
from farfield.vocabulary.counts import count_of


def run(
    path: Positional[Path],
    /,
    *,
    frames: tuple[int, ...] = (0,),
    cfar: Literal["cell-averaging", "ordered-statistic"] = "cell-averaging",
    false_alarm: float = 1e-6,
    doppler: Literal["mean", "peak"] = "mean",
    speed: float | None = None,
    turn: float = 0.0,
    camera: str = "cam-front",
    reading: Reading = AS_THEY_ARE,
    out: Path | None = None,
) -> int:
    """Look at 4D radar frames: power from above, front and side, Doppler, detected echoes, beside the camera.

    examples:
      farfield radar K-Radar --frames 0 300 600
      farfield radar K-Radar --frames 12 --cfar ordered-statistic --false-alarm 1e-8
      farfield radar K-Radar --frames 12 --doppler peak --speed 22.5
      farfield simulate kradar-sim-mini data/mini --sensors os2-64,cam-front,polar3d,cube && farfield radar data/mini

    Writes radar.html, one self-contained page, and a PNG for each frame. A tesseract or a polar map is needed for
    Doppler and echoes; a cube, or the cells of the radar store, show power alone.

    Args:
        path: Folder of a K-Radar, real or simulated.
        frames: Numbers of the frames, counted from 0.
        cfar: What a cell is compared with: the mean of the cells around, or one of a rank, which a second target among
            them does not deafen.
        false_alarm: Probability that a cell of noise alone is detected.
        doppler: Velocity of a cell: the mean of its bins by power, or that of the strongest bin (takes the tesseract).
        speed: How fast the car drives, m/s, to unwrap velocities (default: from the poses of the frames beside).
        turn: How fast it turns to the left, degrees a second; with --speed.
        camera: Name of the image to show.
        reading: How the files are read.
        out: Folder to write into (default: runs/radar-NAME).
    """
    from farfield.errors import ConfigError
    from farfield.files.atomic import readable
    from farfield.inspection.radar_frame import look_at
    from farfield.pages.radar_page import write_radar

    if not 0 < false_alarm < 1:
        raise ConfigError(f"--false-alarm: expected a probability between 0 and 1, got {false_alarm:g}")
    if not frames:
        raise ConfigError("--frames: expected one number or more, got none")
    name = readable(path.resolve().name)
    folder = out or Path("runs") / f"radar-{name}"
    check_outputs((path, *reading.paths), folders={"--out": folder})
    data = reading.open(path, format="kradar", reference="radar")
    reduce = partial(look_at, data, kind=cfar, false_alarm=false_alarm, doppler=doppler, camera=camera)
    looks = [reduce(index, speed_m_s=speed, turn_deg_s=turn) for index in bar(frames, "frames")]
    page, pictures = write_radar(folder, looks, title=f"Radar frames of {name}")
    for look, picture in zip(looks, pictures, strict=True):
        echoes = look.views.echoes
        detected = (
            "no polar map: no echoes" if echoes is None else f"{count_of(len(echoes), 'echo', 'echoes', spec=',')}"
        )
        print(f"{look.key[0]} {look.key[1]}: {detected}; {picture}")
    print(f"report: {page.resolve()}")
    return 0
