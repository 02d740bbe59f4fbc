"""``farfield report``: an evaluation or a training as one self-contained HTML page, or a drive as a film."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, JobFlags, Jobs, Reading
from farfield.cli._output import check_outputs
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.scores import SHOWN_SCORE

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def run(
    evaluation: Positional[Path],
    *,
    out: Path | None = None,
    title: str = "",
    shown_score: float = SHOWN_SCORE,
    film: Path | None = None,
    predictions: Path | None = None,
    format: Literal["boxes-csv", "kitti", "kitti-tracking", "nuscenes"] = "boxes-csv",
    drive: str = "",
    frames: int = 0,
    reach_m: float = 100.0,
    rate_hz: float = 0.0,
    reading: Reading = AS_THEY_ARE,
    jobs: Jobs = ALL_CORES,
) -> int:
    """Turn an evaluation or a training into one self-contained HTML page, or a drive of a data set into a film.

    examples:
      farfield report runs/pillars/evaluation
      farfield report runs/pillars/evaluation/evaluation.json --out pillars.html
      farfield report runs/pillars
      farfield report scores.json --out scores.html --title "My detector on my data"
      farfield report data/kradar --film drive.mp4 --drive 1
      farfield report Cirrus_dataset1 --film tracks.mp4 --predictions tracks.csv --reach-m 150
      farfield report velodyne/ --film short.gif --frames 50 --rate-hz 5

    A film shows every sensor of the drive, boxes, and tracks with their trails; annotated boxes are solid, predicted
    ones dashed. An interrupted film resumes.

    Args:
        evaluation: Folder or evaluation.json of `farfield evaluate`, the JSON of `farfield score --json`, or the folder
            of a training, finished or not: curves of its log, what they warn of; with --film a data set.
        out: The page to write; by default beside the evaluation, with the suffix .html; of a training its course.html.
        title: Title of the page; by default the evaluation's own.
        shown_score: Predictions below this score are left out of the pictures.
        film: Film to write instead: .mp4, .mov, .m4v or .mkv (extra `video`), .gif or .webp.
        predictions: Detections or tracks that the film shows; sequence and frame pair them with the data.
        format: Format of the predictions.
        drive: Drive that the film shows (default: the first one).
        frames: Only so many frames from its beginning; 0: all.
        reach_m: How far ahead the film's views from above show.
        rate_hz: Frames a second; 0 takes the drive's own.
        reading: How the files of the data set are read that a film shows.
        jobs: Who does the work.
    """
    if film is not None:
        check_outputs((evaluation, predictions, *reading.paths), files={"--film": film})
        boxes = None if predictions is None else (predictions, format)
        return _film(reading.open(evaluation), film, boxes, drive, frames, (reach_m, rate_hz, shown_score), jobs)
    reading.check_unused("--film, which shows a data set")
    from farfield.errors import ConfigError
    from farfield.evaluation.record import EVALUATION, Evaluation
    from farfield.experiments.course import PAGE_NAME, course_of, is_run
    from farfield.files.sizes import sized
    from farfield.jobs.folders import held
    from farfield.pages.evaluation_page import write_report

    if not evaluation.exists():
        raise ConfigError(f"evaluation: expected a folder or a JSON file, found nothing at {evaluation}")
    record = evaluation / EVALUATION if evaluation.is_dir() else evaluation
    own = evaluation.iterdir() if evaluation.is_dir() else ()  # a run's log and weights among them
    read = [path for path in own if path.is_file() and path.suffix != ".html"]  # earlier pages are written anew
    check_outputs((record, evaluation / "frames", *read), files={"--out": out})
    if is_run(evaluation) and not (evaluation / EVALUATION).is_file():
        with held(evaluation / PAGE_NAME if out is None else out, file=True):
            print(f"report: {course_of(evaluation, out, title=title).resolve()}")
        return 0
    content = Evaluation.load(evaluation)
    if out is None:
        out = evaluation / "report.html" if evaluation.is_dir() else evaluation.with_suffix(".html")
    with held(out, file=True):
        path = write_report(out, replace(content, title=title or content.title), shown_score=shown_score)
    print(f"report: {path.resolve()} ({sized(path.stat().st_size)})")
    return 0


def _film(
    opened: "Dataset",
    film: Path,
    predictions: tuple[Path, str] | None,
    drive: str,
    frames: int,
    shown: tuple[float, float, float],
    jobs: JobFlags,
) -> int:
    from farfield.evaluation import in_coordinates
    from farfield.files.sizes import sized
    from farfield.metrics.box_files import read_predictions
    from farfield.pages.film import FilmSettings, drive_named, make_film

    predicted = None if predictions is None else read_predictions(predictions[0], format=predictions[1])
    data = in_coordinates(opened, "" if predicted is None else predicted.reference)
    drive_shown = drive_named(data, drive)
    if frames:
        data = data.select([int(index) for index in drive_shown.indices[:frames]])
    reach_m, rate_hz, score = shown
    count = make_film(
        film,
        data,
        drive=drive_shown.name,
        predictions=None if predicted is None else predicted.boxes,
        settings=FilmSettings(reach_m=reach_m, rate_hz=rate_hz, score=score),
        bulk=jobs.options("drawing"),
    )
    print(f"film: {film.resolve()} ({count_of(count, 'frame')}, {sized(film.stat().st_size)})")
    return 0
