"""``farfield calibrate``: where a sensor stands against the LiDAR, and a camera's intrinsics, with residuals."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, Reading


def run(
    kind: Positional[Literal["radar-lidar", "lidar-camera", "lidar-lidar", "board"]],
    path: Positional[Path],
    /,
    *,
    sequence: str | None = None,
    frames: int = 40,
    camera: str | None = None,
    lidars: tuple[str, str] = ("os2-64", "os1-128"),
    pairs: Path | None = None,
    focal: bool = False,
    guess_focal: float | None = None,
    intrinsics: Path | None = None,
    position: tuple[float, float, float] | None = None,
    facing: float = 0.0,
    car: Path | None = None,
    x: float | None = None,
    y: float | None = None,
    yaw: float | None = None,
    frame_offset: int = 0,
    corners: tuple[int, int] = (9, 6),
    square: float = 0.03,
    charuco: bool = False,
    draw: Path | None = None,
    reading: Reading = AS_THEY_ARE,
    save: Path | None = None,
    out: Path | None = None,
    page: bool = False,
    port: int | None = None,
    browser: bool = True,
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

    Writes calibration.json and a picture before and after. Nothing of the data set is changed unless --save says so;
    what was there is copied beside it first.

    Args:
        kind: What against what.
        path: Folder of a data set, or of pictures of a board.
        sequence: Which one; the first unless given.
        frames: How many frames to use, spread over the sequence; for the radar in runs of ten.
        camera: Name of the image; the first with a calibration unless given.
        lidars: The clouds to register, the reference first.
        pairs: CSV of picked pairs (x_m,y_m,z_m,u_px,v_px): the camera begins from them.
        focal: With --pairs, solve for the focal length too (twelve pairs).
        guess_focal: Focal length in pixels to begin with, for a camera without calibration; solved for.
        intrinsics: What board wrote: its focal length and distortion are kept.
        position: Where the lens stands in the LiDAR's coordinates: x forward, y left, z up, metres.
        facing: Where it looks, degrees counter-clockwise from ahead.
        car: CSV of points clicked in a scanned model of the car (name,x,y,z), instead of --position and --facing.
        x: Start of the radar's x, as K-Radar's file has it; the data set's own unless given.
        y: Start of its y.
        yaw: Start of its yaw in degrees; the data set's own unless given.
        frame_offset: Start of the radar frames to add to those that are paired.
        corners: Inner corners of the board in a row and in a column.
        square: Side of its squares in metres.
        charuco: It is a ChArUco board: markers in its white squares.
        draw: Write the board as a picture to print, and stop.
        reading: How the files are read.
        save: File to write the result into: calib_radar_lidar.txt, cam_N.yml, KITTI's calibration, or JSON; or the data
            set's own folder: then the files from which its reader reads.
        out: Folder to write into; runs/calibrate-NAME unless given.
        page: Calibrate radar-lidar or lidar-camera by hand and by the solvers on a page in the browser.
        port: Port of the page; the first free one from 8877 on unless given.
        browser: Open the browser; never over SSH.
    """
    from farfield.calibration.initial_guess import InitialGuess
    from farfield.calibration.jobs import choose_frames
    from farfield.errors import ConfigError

    if frames < 1:
        raise ConfigError(f"--frames: expected one or more, got {frames}")
    board = (corners, square, charuco)
    if draw is not None:
        return _draw(board, draw)
    folder = out or Path("runs") / f"calibrate-{path.resolve().name}"
    result: dict[str, Any]
    if page and (save is not None or kind in ("lidar-lidar", "board")):
        raise ConfigError("--page: expected radar-lidar or lidar-camera, without --save: the page saves")
    if kind == "board":
        result = _board(path, board, camera, save)
        return _write(folder, result)
    beginning = InitialGuess(
        focal_px=guess_focal, intrinsics=intrinsics, position_m=position, facing_deg=facing, car=car
    )
    if page:
        from farfield.studio.options import CalibrationSettings

        assert kind in ("radar-lidar", "lidar-camera")
        settings = CalibrationSettings(
            kind=kind,
            sequence=sequence,
            frames=frames,
            camera=camera,
            radar=(x, y, None if yaw is None else math.radians(yaw), frame_offset),
            beginning=beginning,
            pairs=pairs,
            folder=folder,
        )
        return _page(path, reading.options, settings, port=port, browser=browser)
    data = reading.open(path)
    indices = choose_frames(data, sequence, frames, runs=kind == "radar-lidar")
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "radar-lidar":
        result = _radar(data, indices, (x, y, yaw, frame_offset), save, folder)
    elif kind == "lidar-camera":
        result = _camera(data, indices, camera, (pairs, focal), beginning, save, folder)
    else:
        result = _lidars(data, indices, lidars, save)
    return _write(folder, result)


def _page(path: Path, reading: dict[str, Any], calibration: Any, *, port: int | None, browser: bool) -> int:
    from farfield.studio.options import DatasetOpener, StudioSettings
    from farfield.studio.serving.run import serve

    opening = DatasetOpener(path, **reading)
    settings = StudioSettings(mode="calibrate", title=opening.title, calibration=calibration)
    return serve(opening, settings, port=port, browser=browser)


def _write(folder: Path, result: dict[str, Any]) -> int:
    from farfield.files.atomic import write_text

    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "calibration.json", json.dumps(result, indent=1) + "\n")
    shown = ("matrix", "distortion", "covered", "parameters", "change", "notes")
    print(json.dumps({name: result[name] for name in shown if name in result}, indent=1))
    print(f"result: {(folder / 'calibration.json').resolve()}")
    return 0


def _radar(data: Any, indices: list[int], start: tuple[Any, ...], save: Path | None, folder: Path) -> dict[str, Any]:
    from farfield.calibration.jobs import radar_job, radar_start
    from farfield.calibration.saving import save_radar, save_radar_where_read
    from farfield.figures.rig import radar_calibration_picture
    from farfield.files.images import write_image

    x, y, yaw, offset = start
    turn = None if yaw is None else math.radians(yaw)
    guess = replace(radar_start(data, indices[0], x_m=x, y_m=y, yaw_rad=turn), frames=offset)
    job = radar_job(data, indices, guess)
    write_image(
        folder / "before-after.png", radar_calibration_picture(*map(job.from_above, (job.before, job.calibration.pose)))
    )
    if save is not None:
        if save.is_dir():
            _wrote(save_radar_where_read(data, indices[0], job.calibration))
        else:
            difference = data.frame_difference(data.sequences[indices[0]])
            _wrote(save_radar(save, job.calibration, difference=difference))
    return job.to_json()


def _camera(
    data: Any,
    indices: list[int],
    name: str | None,
    picks: tuple[Path | None, bool],
    beginning: Any,
    save: Path | None,
    folder: Path,
) -> dict[str, Any]:
    from farfield.calibration.camera_pairs import calibrate_pairs, read_pairs
    from farfield.calibration.jobs import camera_job, pairs_job
    from farfield.errors import ConfigError
    from farfield.figures.camera import boxes_picture
    from farfield.figures.rig import camera_calibration_picture
    from farfield.files.images import write_image

    index, chosen = _pictured(data, indices, name, uncalibrated=not beginning.empty)
    first = data[index]
    known = first.cameras.get(chosen)
    start = known if beginning.empty else beginning.camera(chosen, first.images[chosen].shape, known)
    if known is None and picks[0] is None and not (beginning.intrinsics and (beginning.car or beginning.position_m)):
        raise ConfigError(f"{chosen} has no calibration: give --pairs, or --intrinsics with --car or --position")
    if picks[0] is not None and beginning.focal_px is not None:  # nothing but pairs
        alone = pairs_job(data, index, chosen, read_pairs(picks[0]), start, focal=True)
        found = alone.calibration.camera
        write_image(folder / "boxes.png", boxes_picture(alone.picture, found, alone.boxes, alone.points_m))
        _save_camera(data, index, chosen, known, found, save)
        return alone.to_json()
    if picks[0] is not None:
        start = calibrate_pairs(*read_pairs(picks[0]), start, focal=picks[1]).camera
    job = camera_job(data, indices, camera=chosen, start=start if start is not known else None)
    edges_m = job.views.points_m[job.views.frame == 0]
    write_image(folder / "before-after.png", camera_calibration_picture(job.picture, edges_m, job.before, job.after))
    _save_camera(data, index, chosen, known, job.after, save)
    return job.to_json()


def _pictured(data: Any, indices: list[int], name: str | None, *, uncalibrated: bool) -> tuple[int, str]:
    """The first frame with the picture, and the picture's name."""
    from farfield.errors import ConfigError

    known: list[str] = []
    for index in indices:
        frame = data[index]
        known += [each for each in frame.images if uncalibrated or each in frame.cameras]
        if known and name in (None, *known):
            return index, name or known[0]
    raise ConfigError(f"--camera: expected one of {', '.join(dict.fromkeys(known)) or 'no camera at all'}; got {name}")


def _save_camera(data: Any, index: int, name: str, before: Any, after: Any, save: Path | None) -> None:
    from farfield.calibration.saving import save_camera, save_camera_where_read

    if save is not None and save.is_dir():
        _wrote(save_camera_where_read(data, index, name, before, after))
    elif save is not None:
        _wrote(save_camera(save, name, before or after, after))


def _wrote(paths: list[Path]) -> None:
    print("\n".join(f"wrote {each}" for each in paths[:20]))
    if len(paths) > 20:
        print(f"... and {len(paths) - 20} more")


def _lidars(data: Any, indices: list[int], names: tuple[str, str], save: Path | None) -> dict[str, Any]:
    from farfield.calibration.jobs import lidars_job
    from farfield.calibration.saving import save_lidars_where_read
    from farfield.files.atomic import write_text

    found = lidars_job(data, indices, *names)
    result = {"kind": "lidar-lidar", "target_T_source": found.target_T_source.tolist(), "rms_cm": 100 * found.rms_m}
    result |= {"pairs": found.pairs, "notes": list(found.solution.unobserved), **found.solution.to_json()}
    if save is not None and save.is_dir():
        _wrote(save_lidars_where_read(data, indices[0], found.target_T_source))
    elif save is not None:
        write_text(save, json.dumps(result, indent=1) + "\n")
        _wrote([save])
    return result


def _board(
    path: Path, described: tuple[tuple[int, int], float, bool], name: str | None, save: Path | None
) -> dict[str, Any]:
    from farfield.calibration.boards import Board
    from farfield.calibration.jobs import board_job
    from farfield.calibration.saving import save_camera

    (columns, rows), square, charuco = described
    found = board_job(path, Board(columns=columns, rows=rows, square_m=square, markers=charuco))
    if save is not None:
        _wrote(save_camera(save, name or "camera", found.camera, found.camera))
    return found.to_json()


def _draw(described: tuple[tuple[int, int], float, bool], path: Path) -> int:
    import numpy as np

    from farfield.calibration.board_pictures import board_picture
    from farfield.calibration.boards import Board
    from farfield.files.images import write_image

    (columns, rows), square, charuco = described
    grey = board_picture(Board(columns=columns, rows=rows, square_m=square, markers=charuco))
    write_image(path, np.repeat(grey[:, :, None], 3, axis=2))
    print(f"wrote {path}: print it so that a square is {1000 * square:g} mm wide, and glue it to something flat")
    return 0
