"""What is special about a data set, in words beside its figures."""

from collections import Counter

from farfield.datasets.base import Dataset
from farfield.datasets.kradar import KRadar
from farfield.errors import FarfieldError


def dataset_notes(dataset: Dataset) -> tuple[str, ...]:
    """Of a K-Radar: versions of its annotations, and where its conditions come from; nothing of others."""
    reader = dataset.unwrapped
    if not isinstance(reader, KRadar):
        return ()
    versions = Counter(reader.entries[index].version or "none" for index in dataset.origins)
    said: Counter[str] = Counter()
    for sequence in dict.fromkeys(dataset.sequences):
        try:
            said[reader.of_sequence(sequence).conditions_from or "nowhere"] += 1
        except FarfieldError:
            said["a damaged file"] += 1
    shown = ", ".join(f"{version} in {count:,} frames" for version, count in versions.most_common())
    places = ", ".join(f"{place} in {count} sequences" for place, count in said.most_common())
    return f"annotations: {shown}", f"conditions come from: {places}"
