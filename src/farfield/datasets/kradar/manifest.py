"""Which gigabytes of K-Radar each task needs: those that a tree holds, and those of the published set.

Published sizes are estimates: the report's figures for the largest sequence (tesseracts 360 GB, cubes 72, os1-128 14,
os2-64 7, a camera 4.5) over its 1,195 frames, times the 34,994 annotated ones; the polar maps' 16.2 MB a frame.
"""

import json
from pathlib import Path
from typing import Any

from farfield.datasets.base import Dataset
from farfield.datasets.kradar.layout import CAMERAS, LIDARS, RADAR_PRODUCTS, product_path
from farfield.files.atomic import write_text

MANIFEST_NAME = "radar_store.json"
_ANNOTATED, _LARGEST = 34_994, 1_195
_LARGEST_GB = {"tesseract": 360.0, "cube": 72.0, "os1-128": 14.0, "os2-64": 7.0, **dict.fromkeys(CAMERAS, 4.5)}
PUBLISHED_BYTES = {name: round(gb * 1e9 * _ANNOTATED / _LARGEST) for name, gb in _LARGEST_GB.items()} | {
    "polar3d": 16_207_920 * _ANNOTATED,
    "labels": round(0.5e6 * _ANNOTATED / _LARGEST),
}
"""Bytes of a modality in the whole published set, about; a modality of unknown size is absent."""

# Every entry is a choice: the first alternative that a tree holds is enough.
TASKS: dict[str, tuple[tuple[str, ...], ...]] = {
    "train RTNH (sparse radar)": (("cells", "sparse", "cube", "tesseract"), ("labels",)),
    "train RTN (dense radar)": (("cells", "cube", "tesseract"), ("labels",)),
    "train a LiDAR baseline": (("os2-64",), ("labels",)),
    "view frames": (("cells", "sparse", "polar3d", "cube", "tesseract"), ("os2-64",), ("cam-front",), ("labels",)),
    "score files of boxes": (("labels",),),
    "make a store of cells": (("tesseract", "cube", "polar3d"),),
    "study Doppler": (("polar3d", "tesseract", "cells"),),
}


def modalities(dataset: Dataset) -> dict[str, tuple[int, int]]:
    """Number of files and bytes of each modality that a tree holds; labels are those that the reader uses."""
    folders = {product_path(name, "1", 0).parts[-2 if name in _IN_SEQUENCE else -3]: name for name in _KNOWN}
    found = dict.fromkeys((*_KNOWN, "labels"), (0, 0))
    seen: set[Path] = set()
    for index in range(len(dataset)):
        for path in dataset.files(index):
            place = next((folders[part] for part in path.parts[-3:-1] if part in folders), None)
            name = place or ("labels" if path.suffix == ".txt" else None)
            if name is not None and path not in seen:
                seen.add(path)
                count, size = found[name]
                found[name] = count + 1, size + path.stat().st_size
    return {name: counted for name, counted in found.items() if counted[0]}


_KNOWN = (*RADAR_PRODUCTS, *LIDARS, *CAMERAS)
_IN_SEQUENCE = tuple(name for name in _KNOWN if product_path(name, "1", 0).parts[0] == "1")


def needs(held: dict[str, tuple[int, int]]) -> dict[str, Any]:
    """What each task reads: of the tree, and of the published set.

    Args:
        held: What :func:`modalities` returns.

    Returns:
        By task: ``reads`` (modalities), ``missing`` (choices of which the tree holds none), ``bytes`` (of what it
        reads), ``published_reads`` and ``published_bytes_about`` (the smallest published choice).
    """
    tasks = {}
    for task, choices in TASKS.items():
        reads = [next((name for name in choice if name in held), None) for choice in choices]
        sized = [[name for name in choice if name in PUBLISHED_BYTES] for choice in choices]
        smallest = [min(names, key=PUBLISHED_BYTES.__getitem__) for names in sized]
        tasks[task] = {
            "reads": [name for name in reads if name is not None],
            "missing": [" or ".join(choice) for name, choice in zip(reads, choices, strict=True) if name is None],
            "bytes": sum(held[name][1] for name in reads if name is not None),
            "published_reads": smallest,
            "published_bytes_about": sum(PUBLISHED_BYTES[name] for name in smallest),
        }
    return tasks


def write_manifest(dataset: Dataset, target: Path, settings: str) -> Path:
    """Write the manifest of a store: its settings, its size, the source's modalities and what each task needs.

    Args:
        dataset: The source.
        target: Folder of the store.
        settings: The store's settings in one line.
    """
    store = {
        name: [path.stat().st_size for path in target.glob(product_path(name, "*", 0).parent.joinpath("*").as_posix())]
        for name in ("cells", "polar3d")
    }
    held = modalities(dataset)
    stored = {name: (len(sizes), sum(sizes)) for name, sizes in store.items() if sizes}
    text = {
        "settings": settings,
        "store": {name: {"files": count, "bytes": size} for name, (count, size) in stored.items()},
        "source": {name: {"files": count, "bytes": size} for name, (count, size) in held.items()},
        "published_bytes_about": PUBLISHED_BYTES,
        "tasks": needs(held | stored),
    }
    path = target / MANIFEST_NAME
    write_text(path, json.dumps(text, indent=1) + "\n")
    return path
