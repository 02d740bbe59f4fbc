"""The sentences of a report: what was reached, what is simulated, what the words mean."""

from collections.abc import Collection, Mapping
from typing import Any

from farfield.evaluation.report_data import counts, figure, part_names
from farfield.figures.tables import Results, range_name
from farfield.metrics.detections import Protocol
from farfield.metrics.presenting import BASICS, Presentation, Words
from farfield.metrics.result import Subject, subject_of
from farfield.vocabulary.counts import count_of
from farfield.vocabulary.patterns import PATTERN_NOTES

_SENSORS: Mapping[str, tuple[str, str]] = {
    "lidar": (
        "LiDAR",
        "A sensor that sends out laser pulses and times their echoes. Each echo is one point in three dimensions.",
    ),
    "radar": (
        "Radar",
        "A sensor that sends out radio waves and measures from where, how strongly and how fast they return. Its cells "
        "are drawn where their power is high.",
    ),
}


def glossary(presentation: Presentation, kinds: Collection[str]) -> Words:
    """The words of a page: of its sensors, of every score, and of the protocol.

    Args:
        presentation: What the protocol states.
        kinds: Kinds of the sensors whose clouds are shown.
    """
    sensors = tuple(terms for kind, terms in _SENSORS.items() if kind in kinds)
    box, recall, precision, interval = BASICS
    return (*sensors, box, recall, precision, *presentation.glossary, interval)


def headline(results: Results, protocol: Protocol, presentation: Presentation) -> str:
    """What was reached, in one or two sentences; plain text."""
    if not results:
        return "Pictures only: nothing was scored."
    score = presentation.main
    scored = {name: figure(result, score) if score else None for name, result in results.items()}
    reached_by_name = {name: value for name, value in scored.items() if value is not None}
    if not reached_by_name:
        return "Nothing is annotated in the region that counts, so there is no score."
    label = next((label for result in results.values() if (label := _label(result))), "object")
    unit = protocol.presenter.unit(score)
    reached = _enumerated(
        [
            _value(value, unit) + _beside(results[n], protocol, presentation) + f" on {_short(n)}"
            for n, value in reached_by_name.items()
        ]
    )
    perfect = {"": " (1 is perfect)", "%": " (100 is perfect)"}.get(unit, "")
    subject = "" if "," in label else f" of {label}"  # of several classes, the score's name says which
    title = protocol.presenter.title(score)
    first = f"{title[:1].upper()}{title[1:]}{subject}, all ranges together{perfect}: {reached}."
    best = max(reached_by_name, key=lambda name: reached_by_name[name])
    by_range = [(range_name(part), figure(results[best], score, part=part)) for part in part_names(results[best])]
    falls = [f"{_value(value, unit)} from {name}" for name, value in by_range if value is not None]
    only = "" if len(reached_by_name) == 1 else f"On {_short(best)} it"
    return first + (f" {only or 'It'} is {_enumerated(falls)}." if len(falls) > 1 else "")


def _label(result: Mapping[str, Any]) -> str:
    """The class that was scored, with those that counted as it."""
    subject = subject_of(result)
    return (str(result.get("label") or "") if subject is None else subject.label).replace("_", " ")


def _value(value: float, unit: str) -> str:
    return f"{100 * value:.1f}" if unit == "%" else f"{value:.2f}"


def _beside(result: Mapping[str, Any], protocol: Protocol, presentation: Presentation) -> str:
    value = figure(result, presentation.beside) if presentation.beside else None
    name = presentation.beside
    return (
        "" if value is None else f" ({protocol.presenter.title(name)} {_value(value, protocol.presenter.unit(name))})"
    )


def subjects(results: Results) -> list[str]:
    """What each result is of, in one line each; nothing for results from before they said so."""
    stated = (Subject.from_json(result.get("subject")) for result in results.values())
    return [str(subject) for subject in stated if subject is not None]


def notes(results: Results) -> list[str]:
    """What was assumed or left out, each once, with the results that it holds for where they are not all."""
    results_by_note: dict[str, list[str]] = {}
    for name, result in results.items():
        for note in result.get("notes") or ():
            results_by_note.setdefault(str(note), []).append(name)
    return [
        note if len(names) == len(results) else f"{', '.join(names)}: {note}" for note, names in results_by_note.items()
    ]


def scope(results: Results) -> str:
    """How much was scored, in one sentence; plain text."""
    groups: dict[str, list[str]] = {}
    for name, result in results.items():
        number = counts(result)
        if number:
            frames = number.get("frames_given", number.get("frames", 0))
            text = f"{count_of(frames, 'frame', spec=',')} with "
            text += f"{count_of(number.get('annotated', 0), 'annotated object', spec=',')}"
            groups.setdefault(text, []).append(_short(name))
    if len(groups) == 1 and len(results) > 1:
        return f"Scored: {next(iter(groups))}, the same in {_enumerated(next(iter(groups.values())))}."
    return (
        f"Scored: {_enumerated([f'{text} in {_enumerated(names)}' for text, names in groups.items()])}."
        if groups
        else ""
    )


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
            "The roads, objects and sensor returns on this page come from Farfield's simulator; no real "
            f"recording is shown.{learnt} The detector, the file formats and the metric are those used on real data. "
            "The scores show that the whole chain works and how it falls with range; they do not say how well the "
            "detector would do on a real road."
        )
    return "Real frames", (
        f"The frames and the annotated boxes on this page are real recordings.{learnt} A detector trained on "
        "other data, simulated data above all, scores lower on them than one trained on the same sensor."
    )


def pattern_note(name: str) -> str:
    """One sentence on a scan pattern, or nothing."""
    return PATTERN_NOTES.get(name.lower(), "")


def metres(edges_m: Collection[float]) -> str:
    """Range edges as people read them: ``"70, 150 and 250 m"``."""
    return f"{_enumerated([f'{edge:g}' for edge in edges_m])} m"


def _short(name: str) -> str:
    title = pattern_title(name)
    return name if title == name else f"the {title.replace('Uniform', 'uniform')}"


def pattern_title(name: str) -> str:
    """A result's or cloud's name as people read it: ``"gaussian"`` becomes ``"Gaussian pattern"``."""
    return f"{name.capitalize()} pattern" if name.lower() in PATTERN_NOTES else name


def _enumerated(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""
