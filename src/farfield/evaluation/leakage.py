"""Whether a detector was trained on the frames on which it is tested."""

from collections.abc import Iterator, Mapping
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.contents import NONE, common_frames
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.errors import FarfieldError
from farfield.frame import Key

UNKNOWN = "not known"
_SPLITS = ("", "train", "val", "test")


def seen_in_training(data: Dataset, provenance: Mapping[str, Any], keys: set[Key]) -> tuple[str, int]:
    """What is known of a detector's training on frames: in words, and on how many of them it was trained for sure.

    Frames are compared by their contents, where the detector says what it learnt from by digests. Of earlier weights
    the data set, and each of its parts, is compared with the fingerprints of what they learnt from: names and sizes of
    files, which tell that frames are the same, and not that they are others.

    Args:
        data: The frames, as the user opened them.
        provenance: The detector's.
        keys: The frames that count.
    """
    if not data.stored:
        return UNKNOWN, 0
    digests, complete = _learnt_digests(provenance)
    if digests:
        rows = [index for index, key in enumerate(data.keys) if key in keys]
        learnt_rows, certain = common_frames(data.select(rows), digests)
        if common := sum(learnt_rows):
            return _words(common, len(rows)), common
        return (f"none of the {len(rows)} frames, by the bytes of their files" if complete and certain else UNKNOWN), 0
    trained = _fingerprints(provenance)
    if not trained:
        return UNKNOWN, 0
    learnt: set[Key] | None = None
    for candidate in _candidates(data, provenance, {frames for _, frames in trained}):
        fingerprint = candidate.fingerprint()
        if any(fingerprint == other for other, _ in trained):
            learnt = (learnt or set()) | set(candidate.keys)
    if learnt is None:
        return UNKNOWN, 0
    common = len(learnt & keys)
    words = _words(common, len(keys)) if common else f"none of the {len(keys)} frames"
    return f"{words}, by names and sizes of their files", common


def _words(common: int, frames: int) -> str:
    return f"all {frames} frames" if common == frames else f"{common} of {frames} frames"


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
