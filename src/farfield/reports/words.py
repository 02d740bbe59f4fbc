"""The sentences of a report: what was reached, what is simulated, what the words mean."""

from collections.abc import Mapping
from typing import Any

from farfield.reports.results import ap_names, counts, figure, part_names
from farfield.reports.tables import Results, range_name, score_names, score_title
from farfield.vocabulary.patterns import PATTERN_NOTES

GLOSSARY = (
    (
        "LiDAR",
        "A sensor that sends out laser pulses and times their echoes. Each echo is one point in three dimensions.",
    ),
    (
        "Box",
        "Where an object is, how large it is and which way it faces. Annotated boxes are the truth to be found; "
        "predicted boxes are what the detector says, each with a score of how sure it is.",
    ),
    ("Recall", "Of all annotated objects, the share that was found."),
    (
        "Precision",
        "Of all predictions, the share that is right. Asking for more recall means accepting less sure predictions, so "
        "precision falls along the curve.",
    ),
    (
        "AP",
        "Average precision: the area under the precision-recall curve, for predictions whose centre lies within 0.5, "
        "1, 2 or 4 m of the annotated one. mAP is the mean of these four.",
    ),
    (
        "aIoU",
        "Aligned overlap: how well size and heading of the found boxes fit, once their centres are put on each other.",
    ),
    ("DDS", "Mean of mAP and aIoU, from 0 (nothing) to 1 (perfect)."),
    (
        "wDDS",
        "DDS that allows more metres of error the farther an object is: thresholds grow as exp(epsilon x range). At "
        "epsilon 0.006 and 250 m they are 4.5 times as wide.",
    ),
    (
        "Interval",
        "How far the score might move had other drives been recorded: the middle 95 % of scores over resampled drives.",
    ),
)


def headline(results: Results) -> str:
    """What was reached, in one or two sentences; plain text."""
    if not results:
        return "Pictures only: nothing was scored."
    score = next(iter([*score_names(results), *ap_names(results)]), "")
    scored = {name: figure(result, score) for name, result in results.items()}
    known = {name: value for name, value in scored.items() if value is not None}
    if not known:
        return "Nothing is annotated in the region that counts, so there is no score."
    label = next((str(r["label"]).replace("_", " ") for r in results.values() if r.get("label")), "object")
    reached = _joined([f"{value:.2f} on {_short(name)}" for name, value in known.items()])
    first = f"Overall {label} detection score ({score_title(score)}, 1 is perfect): {reached}."
    best = max(known, key=lambda name: known[name])
    by_range = [(range_name(part), figure(results[best], score, part=part)) for part in part_names(results[best])]
    falls = [f"{value:.2f} from {name}" for name, value in by_range if value is not None]
    only = "" if len(known) == 1 else f"On {_short(best)} it"
    return first + (f" {only or 'It'} is {_joined(falls)}." if len(falls) > 1 else "")


def scope(results: Results) -> str:
    """How much was scored, in one sentence; plain text."""
    groups: dict[str, list[str]] = {}
    for name, result in results.items():
        number = counts(result)
        if number:
            frames = number.get("frames_given", number.get("frames", 0))
            text = f"{frames:,} frames with {number.get('annotated', 0):,} annotated objects"
            groups.setdefault(text, []).append(_short(name))
    if len(groups) == 1 and len(results) > 1:
        return f"Scored: {next(iter(groups))}, the same in {_joined(next(iter(groups.values())))}."
    return f"Scored: {_joined([f'{text} in {_joined(names)}' for text, names in groups.items()])}." if groups else ""


def origin(provenance: Mapping[str, Any]) -> tuple[str, str]:
    """What is simulated and what is real: a heading and a text; plain text.

    Args:
        provenance: ``simulated`` says whether the frames are; ``trained_on`` is what the detector learnt from.
    """
    simulated, trained_on = provenance.get("simulated"), provenance.get("trained_on")
    learnt = f" The detector was trained on {trained_on}." if trained_on else ""
    if simulated is None:
        return "Where the data comes from", f"The evaluation does not say whether its frames are simulated.{learnt}"
    if simulated:
        return "Simulated frames", (
            "The roads, vehicles and laser returns on this page come from Farfield's ray-casting simulator; no real "
            f"recording is shown.{learnt} The detector, the file formats and the metric are those used on real data. "
            "The scores show that the whole chain works and how it falls with range; they do not say how well the "
            "detector would do on a real road."
        )
    return "Real frames", (
        f"The LiDAR frames and the annotated boxes on this page are real recordings.{learnt} A detector trained on "
        "other data, simulated data above all, scores lower on them than one trained on the same sensor."
    )


def pattern_note(name: str) -> str:
    """One sentence on a scan pattern, or nothing."""
    return PATTERN_NOTES.get(name.lower(), "")


def _short(name: str) -> str:
    title = pattern_title(name)
    return name if title == name else f"the {title.replace('Uniform', 'uniform')}"


def pattern_title(name: str) -> str:
    """A result's or cloud's name as people read it: ``"gaussian"`` becomes ``"Gaussian pattern"``."""
    return f"{name.capitalize()} pattern" if name.lower() in PATTERN_NOTES else name


def _joined(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""
