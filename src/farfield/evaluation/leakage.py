"""Whether a detector learnt from the frames on which it is tried."""

from collections.abc import Iterator, Mapping
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.recipes import recipe_of_provenance, replay
from farfield.errors import FarfieldError
from farfield.frame import Key

UNKNOWN = "not known"
_PARTS = ("", "train", "val", "test")


def seen_in_training(data: Any, provenance: Mapping[str, Any], keys: set[Key]) -> tuple[str, int]:
    """What is known of a detector having learnt from frames: in words, and how many of them it learnt from for sure.

    The data set, and each of its parts, is compared with the fingerprints of what the detector was trained on.

    Args:
        data: The frames, as the user opened them.
        provenance: The detector's.
        keys: The frames that count.
    """
    trained = _fingerprints(provenance)
    if not isinstance(data, Dataset) or not trained:
        return UNKNOWN, 0
    learnt: set[Key] | None = None
    for candidate in _candidates(data, provenance, {number for _, number in trained}):
        if any(print_ == candidate.fingerprint() for print_, _ in trained):
            learnt = (learnt or set()) | set(candidate.keys)
    if learnt is None:
        return "not found, it learnt from other data", 0
    common = len(learnt & keys)
    if not common:
        return f"none of the {len(keys)} frames", 0
    return f"all {len(keys)} frames" if common == len(keys) else f"{common} of {len(keys)} frames", common


def _fingerprints(provenance: Mapping[str, Any]) -> set[tuple[str, int]]:
    """Fingerprint and number of frames of each data set that was learnt from."""
    streams = [*(provenance.get("streams") or {}).values(), provenance]
    pairs = ((stream.get("data_fingerprint"), stream.get("frames")) for stream in streams)
    return {(print_, number) for print_, number in pairs if isinstance(print_, str) and isinstance(number, int)}


def _candidates(data: Dataset, provenance: Mapping[str, Any], sizes: set[int]) -> Iterator[Dataset]:
    """The data and its parts as the detector was trained to see them, of which some may be what it learnt from."""
    recipe, whole = recipe_of_provenance(dict(provenance)), data.unwrapped
    for part in _PARTS:
        try:
            plain = whole.split(part) if part else whole
            marked = [index for index in range(len(plain)) if plain.has_annotation(index)]
            for found in (plain, plain.select(marked) if len(marked) < len(plain) else None):
                if found is not None and len(found) in sizes:
                    yield replay(found, recipe)
        except FarfieldError:  # too few drives to split, or no such view: then it was not learnt from so
            continue
    if len(data) in sizes:
        yield replay(data, recipe)


def leakage_warning(words: str, common: int) -> tuple[str, ...]:
    """A note for a score, where frames were learnt from."""
    if not common:
        return ()
    return (f"the detector learnt from {words}: the score says how well it remembers, not how well it generalises",)
