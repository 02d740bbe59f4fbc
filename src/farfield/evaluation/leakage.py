"""Whether a detector was trained on the frames on which it is tested."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.contents import NONE, common_frames
from farfield.datasets.open_sweeps import OpenSweeps, package_places
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.detectors.info import open_places
from farfield.errors import FarfieldError
from farfield.frame import Key
from farfield.vocabulary.counts import count_of

UNKNOWN = "not known"
_SPLITS = ("", "train", "val", "test")


def seen_in_training(data: Dataset, provenance: Mapping[str, Any], keys: set[Key]) -> tuple[str, int]:
    """What is known of a detector's training on frames: in words, and on how many of them it was trained for sure.

    Frames are compared by their contents, where the detector says what it learnt from by digests. Of earlier weights
    the data set, and each of its parts, is compared with the fingerprints of what they learnt from: names and sizes of
    files, which tell that frames are the same, and not that they are others. Of Open Sweeps all frames of a place count
    as soon as one of them was learnt from, by its contents or, in the package's own, by the place's name.

    Args:
        data: The frames, as the user opened them.
        provenance: The detector's.
        keys: The frames that count.
    """
    if not data.stored:
        return UNKNOWN, 0
    digests, complete = _learnt_digests(provenance)
    rows = [index for index, key in enumerate(data.keys) if key in keys]
    learnt_rows, certain = common_frames(data.select(rows), digests) if digests else ([], False)
    if isinstance(data.unwrapped, OpenSweeps):
        places = {data.sequences[row] for row, learnt in zip(rows, learnt_rows, strict=False) if learnt}
        own, named = package_places(data), open_places(provenance)
        places |= set(own).intersection(named or ())
        if places:
            return _places_in_training(places, keys)
        if own and named is not None and not (complete and certain) and _start_is_known(provenance):
            return f"none of the {count_of(len(keys), 'frame')}, by the places it names", 0
    if digests:
        if common := sum(learnt_rows):
            return _words(common, len(rows)), common
        none = f"none of the {count_of(len(rows), 'frame')}"
        if complete and certain:
            return f"{none}, by the bytes of their files", 0
        start = (provenance.get("start") or {}).get("weights")
        if start and certain and _learnt_digests({**provenance, "start": None})[1]:
            return f"{none} in the training itself; of the weights that it started from ({start}) {UNKNOWN}", 0
        return UNKNOWN, 0
    trained = _fingerprints(provenance)
    if not trained:
        return UNKNOWN, 0
    learnt: set[Key] | None = None
    for candidate in _candidates(data, provenance, {frames for _, frames in trained}):
        # Earlier versions left the reader's options out, and they change nothing in what was learnt from
        fingerprints = {candidate.fingerprint(options=options) for options in (True, False)}
        if any(other in fingerprints for other, _ in trained):
            learnt = (learnt or set()) | set(candidate.keys)
    if learnt is None:
        return UNKNOWN, 0
    common = len(learnt & keys)
    words = _words(common, len(keys)) if common else f"none of the {count_of(len(keys), 'frame')}"
    return f"{words}, by names and sizes of their files", common


def _places_in_training(places: Collection[str], keys: set[Key]) -> tuple[str, int]:
    """The same for frames of places of which some are among those learnt from."""
    names = sorted({sequence for sequence, _ in keys if sequence in places})
    common = sum(sequence in places for sequence, _ in keys)
    which = f"{'place' if len(names) == 1 else 'places'} {' and '.join(names)}"
    return f"{_words(common, len(keys))}, of the {which}", common


def _start_is_known(provenance: Mapping[str, Any]) -> bool:
    """Whether the weights from which a training started say from which places they learnt."""
    earlier = [provenance[name] for name in ("start", "adapted") if provenance.get(name)]
    return all(record.get("open_sweeps", ()) is not None for record in earlier)


def _words(common: int, frames: int) -> str:
    return f"all {count_of(frames, 'frame')}" if common == frames else f"{common} of {count_of(frames, 'frame')}"


def digests_text(provenance: Mapping[str, Any]) -> str | None:
    """What a detector learnt from, as other weights' provenance holds it; None where it is not all known.

    Args:
        provenance: The detector's.
    """
    digests, complete = _learnt_digests(provenance)
    return digests if complete else None


def _learnt_digests(provenance: Mapping[str, Any]) -> tuple[str, bool]:
    """Digests of the frames that a detector learnt from, and whether these are all that it learnt from.

    They are those of its streams, and of what the weights that it started from learnt from.
    """
    start, adapted = provenance.get("start"), provenance.get("adapted")
    texts = [stream.get("frame_digests") for stream in (provenance.get("streams") or {}).values()]
    texts += [] if start is None else [start.get("frame_digests")]
    texts += [] if adapted is None else [adapted.get("start_frame_digests")]
    frames = {frame for text in texts if text for frame in text.split()}
    return " ".join(sorted(frames - {NONE})), bool(texts) and None not in texts and NONE not in frames


def _fingerprints(provenance: Mapping[str, Any]) -> set[tuple[str, int]]:
    """Fingerprint and number of frames of each data set that was trained on."""
    streams = [*(provenance.get("streams") or {}).values(), provenance]
    pairs = ((stream.get("data_fingerprint"), stream.get("frames")) for stream in streams)
    return {(digest, frames) for digest, frames in pairs if isinstance(digest, str) and isinstance(frames, int)}


def _candidates(data: Dataset, provenance: Mapping[str, Any], sizes: set[int]) -> Iterator[Dataset]:
    """The data and its parts as the detector was trained to see them, of which some may be what it was trained on."""
    recipe = recipe_of_provenance(dict(provenance))
    reader = data.unwrapped
    annotated_origins: set[int] | None = None
    for name in _SPLITS:
        try:
            part = reader.split(name) if name else reader
            if annotated_origins is None:  # each frame is looked at once, not once a part
                annotated_origins = {index for index in range(len(reader)) if reader.has_annotation(index)}
            annotated = [index for index, origin in enumerate(part.origins) if origin in annotated_origins]
            for candidate in (part, part.select(annotated) if len(annotated) < len(part) else None):
                if candidate is not None and len(candidate) in sizes:
                    yield replay(candidate, recipe)
        except FarfieldError:  # too few drives to split, or no such view: then it was not trained on so
            continue
    if len(data) in sizes:
        yield replay(data, recipe)


def leakage_warning(frames_text: str, common: int) -> tuple[str, ...]:
    """A note for a score, where the detector was trained on frames that count.

    Args:
        frames_text: On which frames, as :func:`seen_in_training` says.
        common: How many they are.
    """
    if not common:
        return ()
    return (
        f"the detector learnt from {frames_text}: the score says how well it remembers, not how well it generalises",
    )


def frames_of_choice(data: Dataset, provenance: Mapping[str, Any], keys: set[Key]) -> int | None:
    """On how many frames a training was scored to keep the best of its weights, which these are; None: not known.

    Args:
        data: The frames, as the user opened them.
        provenance: The detector's.
        keys: The frames that count.
    """
    if not provenance.get("validation"):  # the weights of the last step: nothing chose them
        return 0
    digests = (provenance.get("held_out") or {}).get("frame_digests")
    if not digests or not data.stored:
        return None
    common, certain = common_frames(data.select([i for i, key in enumerate(data.keys) if key in keys]), digests)
    return sum(common) if certain or any(common) else None


def choice_text(chosen_by: int | None, frames: int) -> str:
    """What is known of frames that chose the weights, in words; empty where they chose nothing.

    Args:
        chosen_by: How many chose, as :func:`frames_of_choice` says.
        frames: How many count.
    """
    if chosen_by is None:
        return "whether they chose the weights, not known"
    return f"the weights were chosen by {_words(chosen_by, frames)}" if chosen_by else ""


def choice_warning(chosen_by: int | None, frames: int) -> tuple[str, ...]:
    """A note for a score on frames that chose the weights; arguments as of :func:`choice_text`."""
    if not chosen_by:
        return ()
    text = f"{choice_text(chosen_by, frames)}, on which a training was scored to keep its best weights"
    return (f"{text}: the score is too good for other frames",)
