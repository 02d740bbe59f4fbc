"""``farfield calibrate``: where a sensor stands against the LiDAR, and a camera's intrinsics, with residuals."""

import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from farfield.calibration.boards import Board
from farfield.calibration.jobs import CameraJob, PairsJob, RadarJob, choose_frames
from farfield.calibration.lidar_lidar import Registration
from farfield.calibration.saving import (
    save_camera,
    save_camera_where_read,
    save_lidars_where_read,
    save_radar,
    save_radar_where_read,
)
from farfield.calibration.solving import CalibrationKind, CalibrationOptions, pictured_camera, solve
from farfield.cli._flags import AS_THEY_ARE, Reading, ReadingFlags
from farfield.cli._output import OUTPUT, check_outputs, write_json
from farfield.errors import ConfigError
from farfield.figures.calibration_table import calibration_text
from farfield.figures.camera import boxes_picture
from farfield.figures.rig import camera_calibration_picture, radar_calibration_picture
from farfield.files.images import write_image
from farfield.jobs.folders import held
from farfield.studio.options import CalibrationSettings, DatasetOpener, StudioSettings

DEFAULTS = CalibrationOptions()


def run(
    kind: Positional[CalibrationKind],
    path: Positional[Path],
    /,
    *,
    options: Annotated[CalibrationOptions, tyro.conf.arg(name="")] = DEFAULTS,
    draw: Path | None = None,
    reading: Reading = AS_THEY_ARE,
    save: Path | None = None,
    out: Path | None = None,
    page: bool = False,
    port: int | None = None,
    browser: bool = True,
    json: Path | None = None,
) -> int:
    """Solve where a sensor stands against the LiDAR, with residuals and what the data cannot tell.

    examples:
      farfield calibrate radar-lidar K-Radar --sequence 3
      farfield calibrate radar-lidar K-Radar --x -2 --y 0 --save K-Radar/1/info_calib/calib_radar_lidar.txt
      farfield calibrate lidar-camera kitti --frames 20
      farfield calibrate lidar-camera K-Radar --camera cam-front --pairs picks.csv --save calibration.json
      farfield calibrate lidar-lidar K-Radar --lidars os2-64 os1-128 --frames 3 --save K-Radar
      farfield calibrate board PICTURES --corners 9 6 --draw board.png
      farfield calibrate board PICTURES --charuco --save intrinsics.json
      farfield calibrate lidar-camera Cirrus_dataset1 --guess-focal 1000 --pairs picks.csv --save Cirrus_dataset1
      farfield calibrate lidar-camera kitti --intrinsics intrinsics.json --car clicked.csv
      farfield calibrate radar-lidar K-Radar --page --no-browser

    Prints a table of each value with its change and sigma, the residual, and whether to keep or to replace the old
    value; writes calibration.json and a picture before and after. The data set is changed only by --save, which keeps a
    copy of the old files.

    Args:
        kind: What against what.
        path: Folder of a data set, or of pictures of a board.
        options: How it is calibrated.
        draw: Write the board as a picture to print, and stop.
        reading: How the files are read.
        save: File to write the result into: calib_radar_lidar.txt, cam_N.yml, KITTI's calibration, or JSON; or the data
            set's own folder: then the files from which its reader reads.
        out: Folder to write into (default: runs/calibrate-NAME).
        page: Calibrate radar-lidar or lidar-camera by hand and by the solvers on a page in the browser.
        port: Port of the page (default: the first free one from 8877 on).
        browser: Open the browser; never over SSH.
        json: Also write the result as JSON into this file; - prints it instead of the table.
    """
    if draw is not None:
        check_outputs((path,), files={"--draw": draw})
        return _draw(options.board, draw)
    folder = out or Path("runs") / f"calibrate-{path.resolve().name}"
    sources = (path, options.pairs, options.car, options.intrinsics, *reading.paths)
    check_outputs(sources, files={"--json": json}, folders={"--out": folder})
    if save is not None and not save.is_dir():  # into the data by design, after a copy
        check_outputs(sources[1:], files={"--save": save})
    if page and (save is not None or kind in ("lidar-lidar", "board")):
        raise ConfigError("--page: expected radar-lidar or lidar-camera, without --save: the page saves")
    if page:
        return _page(kind, DatasetOpener(path, reading.open), options, folder, port=port, browser=browser)
    with held(folder):
        with redirect_stdout(sys.stderr) if json == OUTPUT else nullcontext():  # so that the output is JSON alone
            result = _solved(kind, path, options, reading, folder, save)
        return _write(folder, result, json)


def _solved(
    kind: CalibrationKind,
    path: Path,
    options: CalibrationOptions,
    reading: ReadingFlags,
    folder: Path,
    save: Path | None,
) -> dict[str, Any]:
    """Solve, draw and save; the result's JSON."""
    if kind == "board":
        solution: Any = solve(kind, path, options)
        if save is not None:
            name = options.camera or "camera"
            _print_written(save_camera(save, name, solution.camera, solution.camera))
        return dict(solution.to_json())
    data = reading.open(path)
    solution = solve(kind, data, options)
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "radar-lidar":
        _draw_radar(folder, solution)
    elif kind == "lidar-camera":
        _draw_camera(folder, solution)
    if save is not None:
        indices = choose_frames(data, options.sequence, options.frames, runs=kind == "radar-lidar")
        _SAVERS[kind](save, data, indices, options, solution)
    return dict(solution.to_json())


def _page(
    kind: str, opening: DatasetOpener, options: CalibrationOptions, folder: Path, *, port: int | None, browser: bool
) -> int:
    from farfield.studio.serving.run import serve

    calibration = CalibrationSettings(
        kind="radar-lidar" if kind == "radar-lidar" else "lidar-camera",
        sequence=options.sequence,
        frames=options.frames,
        camera=options.camera,
        radar=(options.x, options.y, options.yaw_rad, options.frame_offset),
        beginning=options.initial_guess,
        pairs=options.pairs,
        folder=folder,
    )
    settings = StudioSettings(mode="calibrate", title=opening.title, calibration=calibration)
    return serve(opening, settings, port=port, browser=browser)


def _write(folder: Path, result: dict[str, Any], json: Path | None) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "calibration.json", result)
    if json is not None:
        write_json(json, result)
    if json != OUTPUT:
        print(calibration_text(result))
        print(f"result: {(folder / 'calibration.json').resolve()}")
    return 0


def _draw_radar(folder: Path, job: RadarJob) -> None:
    before_after = map(job.from_above, (job.before, job.calibration.pose))
    write_image(folder / "before-after.png", radar_calibration_picture(*before_after))


def _draw_camera(folder: Path, job: CameraJob | PairsJob) -> None:
    if isinstance(job, PairsJob):
        picture = boxes_picture(job.picture, job.calibration.camera, job.boxes, job.points_m)
        write_image(folder / "boxes.png", picture)
        return
    edges_m = job.views.points_m[job.views.frame == 0]
    write_image(folder / "before-after.png", camera_calibration_picture(job.picture, edges_m, job.before, job.after))


def _save_radar(save: Path, data: Any, indices: list[int], options: CalibrationOptions, job: RadarJob) -> None:
    del options
    if save.is_dir():
        _print_written(save_radar_where_read(data, indices[0], job.calibration))
    else:
        difference = data.frame_difference(data.sequences[indices[0]])
        _print_written(save_radar(save, job.calibration, difference=difference))


def _save_camera(
    save: Path, data: Any, indices: list[int], options: CalibrationOptions, job: CameraJob | PairsJob
) -> None:
    camera = pictured_camera(data, indices, options)
    after = job.calibration.camera if isinstance(job, PairsJob) else job.after
    if save.is_dir():
        _print_written(save_camera_where_read(data, camera.index, camera.name, camera.stored, after))
    else:
        _print_written(save_camera(save, camera.name, camera.stored or after, after))


def _save_lidars(
    save: Path, data: Any, indices: list[int], options: CalibrationOptions, registration: Registration
) -> None:
    del options
    if save.is_dir():
        _print_written(save_lidars_where_read(data, indices[0], registration.target_T_source))
    else:
        write_json(save, registration.to_json())
        _print_written([save])


_SAVERS: dict[str, Callable[..., None]] = {
    "radar-lidar": _save_radar,
    "lidar-camera": _save_camera,
    "lidar-lidar": _save_lidars,
}


def _print_written(paths: Sequence[Path]) -> None:
    print("\n".join(f"wrote {path}" for path in paths[:20]))
    if len(paths) > 20:
        print(f"... and {len(paths) - 20} more")


def _draw(board: Board, path: Path) -> int:
    import numpy as np

    from farfield.calibration.boards import board_picture

    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path, np.repeat(board_picture(board)[:, :, None], 3, axis=2))
    print(
        f"wrote {path}: print it so that a square is {1000 * board.square_m:g} mm wide, and glue it to something flat"
    )
    return 0
