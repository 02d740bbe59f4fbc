"""``farfield track``: give detections identities over time."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from farfield.cli._flags import AS_THEY_ARE, Reading
from farfield.cli._output import check_outputs, would_write
from farfield.vocabulary.counts import count_of


def run(
    detections: tyro.conf.Positional[Path],
    *,
    out: Path,
    data: Path | None = None,
    poses: Path | None = None,
    reading: Reading = AS_THEY_ARE,
    format: Literal["boxes-csv", "kitti-tracking", "nuscenes"] = "boxes-csv",
    to: Literal["same", "boxes-csv", "kitti-tracking", "nuscenes"] = "same",
    preset: Annotated[
        str, tyro.conf.arg(metavar="{default,offline,unposed,annotated,ab3dmot,ab3dmot-paper,centerpoint,simpletrack}")
    ] = "default",
    step_s: float | None = None,
    least_score: float | None = None,
    least_track_score: float | None = None,
    doppler_span_m_s: float | None = None,
    option: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    smooth: bool = False,
    join_s: float | None = None,
    picture: Path | None = None,
    dry_run: bool = False,
) -> int:
    """Give detections identities and velocities, frame by frame.

    examples:
      farfield track predictions.csv --out tracks.csv
      farfield track detections/ --format kitti-tracking --preset ab3dmot --out tracks/
      farfield track predictions.csv --data drives/ --out tracks.csv --picture trails.png
      farfield track predictions.csv --step-s 0.25 --smooth --out tracks.csv
      farfield track predictions.csv -o max_age_s=1.5 -o min_hits=2 --join-s 5 --out tracks.csv

    With --data, stamps and poses come from the data set's drives, and tracks are kept in world coordinates. Without it
    the time step is constant and tracks are kept in the sensor's own coordinates. `farfield score tracks/ label/
    --protocol tracking --format kitti-tracking --label Car` scores them.

    Args:
        detections: File, or folder of files, of scored boxes; a folder's files are sequences.
        out: The file, for kitti-tracking the folder, to write.
        data: Data set that the detections were made on; frames are matched by sequence and frame.
        poses: Poses beside the data, as `farfield odometry` writes them (default: those of the data).
        reading: How the data set's files are read.
        format: Format of the detections; nuscenes is its result JSON, in the order of its samples' names.
        to: Format of the tracks; nuscenes is its tracking JSON (default: that of the detections).
        preset: ab3dmot (as its code of 2022), ab3dmot-paper, centerpoint, simpletrack, or our own: default,
            offline, which --smooth takes instead of it, unposed, for a moving car whose poses are not known, and
            annotated, for boxes that people drew.
        step_s: Seconds between frames where there are no stamps (default: 0.1).
        least_score: Detections of a lower score are left out.
        least_track_score: Tracks of a lower mean score are left out.
        doppler_span_m_s: Span modulo which radial velocities (doppler_m_s of the CSV) are known (default: taken as
            unambiguous).
        option: Change one option of the tracker (docs/tracking.md), as name=value; may be given several times.
        smooth: Look ahead too: smooth each track as a whole (Rauch-Tung-Striebel) and fill its gaps.
        join_s: Look ahead too: join tracks of one size and class, at most so long apart, that go on as they moved;
            with --preset annotated by a size that is exactly the same, 30 suits.
        picture: SVG, PNG or JPEG of the tracks' trails from above to write.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.errors import ConfigError
    from farfield.evaluation import in_coordinates
    from farfield.figures.style import check_picture
    from farfield.figures.trails import write_trails
    from farfield.jobs.folders import held
    from farfield.metrics.box_files import read_predictions
    from farfield.tracking import join_settings, join_tracks, track, with_options
    from farfield.tracking import preset as preset_of
    from farfield.tracking.offline import smooth_tracks, track_scores, with_track_score
    from farfield.tracking.reasons import reasons_for_few
    from farfield.tracking.timeline import with_drives
    from farfield.tracking.writing import write_kitti_tracks, write_nuscenes_tracks, write_tracks_csv

    changes: dict[str, Any] = {"step_s": step_s, "least_score": least_score, "doppler_span_m_s": doppler_span_m_s}
    changes = {name: value for name, value in changes.items() if value is not None}
    changes |= {"output": "detection", "report_coasted": False} if smooth else {}
    kind = format if to == "same" else to
    as_folder = kind == "kitti-tracking"
    check_outputs(
        (detections, data, poses, *reading.paths),
        files={"--out": None if as_folder else out, "--picture": picture},
        folders={"--out": out if as_folder else None},
    )
    if poses is not None and data is None:
        raise ConfigError("--poses: expected --data too, whose frames they place")
    if data is None:
        reading.check_unused("--data, the data set that the detections were made on")
    if picture is not None:
        check_picture(picture)
    preset = "offline" if smooth and preset == "default" else preset
    predictions = read_predictions(detections, format=format)
    settings = with_options(preset_of(preset).changed(**changes), option)
    if data is not None:
        predictions = with_drives(
            predictions, in_coordinates(reading.open(data, poses=poses), predictions.reference).posed_drives()
        )
    if dry_run:
        would_write(
            f"the tracks of {count_of(sum(map(len, predictions.boxes.values())), 'box', 'boxes')} "
            f"in {count_of(len(predictions.boxes), 'frame')}",
            out,
        )
        return 0
    tracks = track(predictions, settings)
    if join_s is not None:
        tracks = join_tracks(tracks, replace(join_settings(preset), longest_s=join_s), step_s=settings.step_s)
    if smooth:
        tracks = smooth_tracks(tracks, step_s=settings.step_s)
    if least_track_score is not None:
        all_scores = track_scores(tracks).values()
        tracks = with_track_score(tracks, least_track_score)
        if all_scores and max(all_scores) < least_track_score:
            print(
                f"warning: no track has a mean score of --least-track-score {least_track_score:g}; the highest is "
                f"{max(all_scores):g}",
                file=sys.stderr,
            )
    with held(out, file=kind != "kitti-tracking"):
        if kind == "kitti-tracking":
            write_kitti_tracks(out, tracks)
        elif kind == "nuscenes":
            write_nuscenes_tracks(out, tracks)
        else:
            write_tracks_csv(out, tracks)
    if picture is not None:
        write_trails(picture, tracks)
    print("".join(f"note: {note}\n" for note in tracks.notes), end="")
    for reason in reasons_for_few(predictions, tracks, settings):
        print(f"few tracks: {reason}", file=sys.stderr)
    boxes = sum(map(len, tracks.boxes.values()))
    names = {
        (key[0], name) for key, part in tracks.boxes.items() if part.track_id is not None for name in part.track_id
    }
    looked = [word for word, done in (("joined", join_s is not None), ("smoothed", smooth)) if done]
    mode = f"offline ({', '.join(looked)})" if looked else "online"
    print(
        f"{preset}, {mode}: {count_of(len(names), 'track')}, {count_of(boxes, 'box', 'boxes')} "
        f"in {count_of(len(tracks.boxes), 'frame')}\nwritten: {out}"
    )
    return 0
