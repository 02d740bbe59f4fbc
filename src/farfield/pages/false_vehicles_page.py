"""What a detector takes for vehicles on real sweeps: how many over the recall of pasted cars, and a gallery by kind."""

import json
from collections.abc import Sequence
from pathlib import Path

from farfield.datasets.base import Dataset
from farfield.evaluation.donor_trial import KINDS, LEAST_POINTS, RECALL, RECALLS, DonorTrial, interval_over_sweeps
from farfield.evaluation.pasted_cars import FARTHEST_M, MATCH_M, in_sensor_axes
from farfield.figures.false_vehicles import false_vehicle_curves, false_vehicle_gallery
from farfield.figures.style import figure_uri
from farfield.files.atomic import write_text
from farfield.jobs.folders import held
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.scores import SHOWN_SCORE

PAGE, RECORD = "false_vehicles.html", "false_vehicles.json"
_EACH_KIND = 12


def write_false_vehicles(
    folder: Path | str, trial: DonorTrial, data: Dataset, *, detector: str, cloud: str | None = None
) -> Path:
    """Write ``false_vehicles.html`` and ``false_vehicles.json`` into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        trial: What was detected.
        data: The sweeps of the trial.
        detector: The detector's name.
        cloud: Name of the cloud that was read (default: the first).

    Returns:
        The page.
    """
    folder = Path(folder)
    with held(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / RECORD, json.dumps(trial.to_json(), indent=1, allow_nan=False) + "\n")
        write_text(folder / PAGE, render_false_vehicles(trial, data, detector=detector, cloud=cloud))
    return folder / PAGE


def render_false_vehicles(
    trial: DonorTrial, data: Dataset, *, detector: str, cloud: str | None = None, name: str = ""
) -> str:
    """Return the page as HTML; ``name`` is what the title calls the sweeps (default: their folder's name, if any)."""
    name = name or data.root.name
    threshold = trial.threshold_at()
    score = SHOWN_SCORE if threshold is None else threshold
    curve = PageImage(
        figure_uri(false_vehicle_curves({name: {detector: trial}})),
        "False vehicles a sweep over the recall of pasted cars",
        f"The line marks a recall of {RECALL:.0%}. " + curve_words(trial),
        "False vehicles over found cars",
    )
    return render_template(
        "false_vehicles.html",
        title=f"False vehicles of {detector}" + (f" on {name}" if name else ""),
        headline=headline(trial),
        scope=f"{count_of(trial.sweeps, 'sweep')} of {count_of(len(set(trial.scenes)), 'sequence')}; "
        f"{len(trial.cars)} simulated cars; figures by range and points at a score of {score:.2f}",
        pictures=[curve, *_galleries(trial, data, score, cloud)],
        rows=_rows(trial, score),
        reach_m=f"{FARTHEST_M:g}",
        match_m=f"{MATCH_M:g}",
        least=LEAST_POINTS,
    )


def headline(trial: DonorTrial) -> str:
    """How many false vehicles a sweep come with a recall of four fifths, in a sentence."""
    false, threshold = trial.at_recall(), trial.threshold_at()
    if false is None or threshold is None:
        recall = float(trial.curve()[1].max(initial=0.0))
        return (
            f"a recall of {RECALL:.0%} of the pasted cars is not reached: {recall:.0%} are found at the lowest score."
        )
    interval = interval_over_sweeps(trial, lambda own, sweeps: own.at_recall(RECALL, sweeps))
    spans = "" if interval is None else f" (95 %: {interval[0]:.1f} to {interval[1]:.1f})"
    finds = f"the score of {threshold:.2f} that finds {RECALL:.0%} of the pasted cars"
    return f"{false:.1f} false vehicles a sweep{spans} at {finds}."


def curve_words(trial: DonorTrial) -> str:
    """The curve at a few recalls, in words."""
    values = [(recall, trial.at_recall(recall)) for recall in RECALLS]
    return "; ".join(f"{recall:.0%}: {'not reached' if v is None else format(v, '.2f')}" for recall, v in values) + "."


def _rows(trial: DonorTrial, score: float) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for recalls, false in (
        (trial.recall_by_range(score), trial.false_by_range(score)),
        (trial.recall_by_points(score), trial.false_by_points(score)),
    ):
        for name in false:
            recall, cars = recalls.get(name, (None, 0))
            share = "–" if recall is None else f"{recall:.0%}"
            what = name if name.endswith(" m") else f"{name} points"
            rows.append((what, f"{cars}", share, f"{false[name]:.2f}"))
    return rows


def _galleries(trial: DonorTrial, data: Dataset, score: float, cloud: str | None) -> Sequence[PageImage]:
    """The false vehicles of the highest scores by kind."""
    pictures = []
    for kind in KINDS:
        of_kind = sorted((one for one in trial.false if one.kind == kind), key=lambda one: -one.score)
        shown = of_kind[:_EACH_KIND]
        if not shown:
            continue
        rows = sorted({one.sweep for one in shown})
        frames = {row: in_sensor_axes(data[row], cloud) for row in rows}
        above = sum(one.score >= score for one in of_kind)
        caption = (
            f"{count_of(len(of_kind), 'false vehicle')}, {above} at or above the score of {score:.2f}; those of the "
            "highest scores, from above (ahead is to the right) and from the side."
        )
        heading = f"Taken for vehicles: {kind}"
        uri = figure_uri(false_vehicle_gallery(frames, shown), "png", dpi=80)
        pictures.append(PageImage(uri, f"{heading}; points near each box", caption, heading))
    return pictures
