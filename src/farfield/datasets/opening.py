"""open_dataset: the reader that a folder needs, with its options, and the words where there is none."""

import inspect
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from farfield.datasets import open_sweeps
from farfield.datasets.base import Dataset
from farfield.datasets.class_mapping import MAPPING_NAME, maps_classes, read_class_mapping
from farfield.datasets.downloads import archive_sentences
from farfield.datasets.formats import find_format, looked_for
from farfield.datasets.frame_maps import described, make
from farfield.datasets.reader_options import typed_options
from farfield.datasets.recipes import maps_of_options, plain
from farfield.datasets.recognition import recognise
from farfield.datasets.unread import advice_on, unread_files
from farfield.errors import ConfigError, DatasetError, did_you_mean
from farfield.files.atomic import readable
from farfield.files.remote_paths import RemotePath, as_path, list_anew
from farfield.files.remote_stores import UNFINISHED

_EVERYWHERE = ("poses", "rotate_deg")  # options of every format
_CLOUD_FLAGS = {
    "bin_columns": " (--columns): its files say their columns themselves",
    "column_names": " (--columns NAMES): its format names its columns",
    "intensity_scale": " (--intensity-scale): its format says the full scale",
    "point_times": " (--point-times): its format says what its points' times are",
}


def open_dataset(path: Path | str, *, format: str | None = None, **options: Any) -> Dataset:
    """Open a data set; its format is recognised from what the folder holds.

    Options that decide how frames are seen become maps, see :attr:`Dataset.maps`: ``poses`` and ``rotate_deg`` for
    every format, and ``reference``, ``radar_rate``, ``radar_region``, ``radar_over``, ``labels_at``,
    ``whole_bodies`` for those that offer them.

    Args:
        path: Its root folder; its URL in an object store, such as ``s3://bucket/drives``; or ``"open-sweeps"``, real
            sweeps of streets that ship with the package.
        format: One of :data:`~farfield.datasets.formats.DATASETS`; None recognises it.
        **options: ``poses``, a file or folder of poses as ``farfield odometry`` writes them; ``rotate_deg``, which
            turns every frame counter-clockwise about z (180 looks backwards); and those of the format's reader, such as
            ``columns``. ``mapping`` renames the classes of every format (``classes: {Auto: vehicle}``; without it
            ``mapping.yaml`` in the root, where it is such a file), or describes a Cirrus layout.

    Raises:
        DatasetError: If the folder does not exist or nothing in it is recognised.
        ConfigError: If the format or an option is unknown.

    >>> open_dataset("Cirrus_dataset1")[0].boxes  # doctest: +SKIP
    Boxes(95: 2 large_vehicle, 1 pedestrian, 92 vehicle)
    """
    root = as_path(path).expanduser()
    if str(path) == open_sweeps.NAME and not root.exists():
        root = open_sweeps.ROOT
    if isinstance(root, RemotePath):
        _check_remote(root)
    if not root.is_dir():
        raise DatasetError(f"{path}: expected a data set's folder, found {_no_folder(root)}")
    recognised = format or recognise(root)
    classes, options = _class_mapping(root, recognised, options)
    if format is None:
        format = recognised
        if options.get("mapping") is not None and format != "folder":  # another layout: what it is like stands there
            format = "cirrus"
    if format is None:
        held = sorted(entry.name for entry in root.iterdir())
        shown = ", ".join(held[:8]) + (", ..." if len(held) > 8 else "") or "nothing"
        texts = looked_for()
        broken = "".join(f" {name}: {text}" for name, text in texts.items() if text.startswith("cannot be used"))
        hints = _unread(root) + _archived(root) + _inside(root)
        raise DatasetError(
            f"{root}: recognised no data set. It holds: {shown}. {hints}Looked for {', '.join(texts)}; "
            f"farfield formats NAME says what one is recognised by.{broken}"
        )
    reader = find_format(format).load()
    own = _checked_options(format, reader, options)
    options = typed_options(reader, options)
    opened = reader(root, **{name: value for name, value in options.items() if name in own})
    opened.options = {name: plain(value) for name, value in options.items() if name in own}
    _check_names(opened)
    opened = opened if not classes else opened.mapped(make("classes", {"classes": classes}))
    return _viewed(opened, {name: value for name, value in options.items() if name not in own})


def _check_remote(root: RemotePath) -> None:
    """List a store's folder anew, and refuse one of which only a part may be there.

    Raises:
        DatasetError: If it is being uploaded.
    """
    list_anew()
    if (root / UNFINISHED).exists():
        raise DatasetError(
            f"{root}: expected a finished upload, got one that is under way or was cut off. Run the command that "
            "writes it again: it goes on where it stopped."
        )


def _check_names(data: Dataset) -> None:
    """Refuse names of sequences and frames that no file of results could hold, before any work.

    Raises:
        DatasetError: If one is not UTF-8.
    """
    for name in dict.fromkeys([*data.sequences, *data.frame_ids]):
        if readable(name) != name:
            raise DatasetError(
                f"{data.root}: expected names in UTF-8, got {readable(name)}. Rename the file or folder, such as by "
                "convmv -f latin1 -t utf8."
            )


def _class_mapping(
    root: Path, format: str | None, options: Mapping[str, Any]
) -> tuple[Mapping[str, str], dict[str, Any]]:
    """The classes of a mapping for any format, given or beside the data, and the options less that mapping.

    Own folders read it themselves; a mapping of a Cirrus layout stays an option.
    """
    mapping = options.get("mapping")
    if format in (None, "folder") or not (mapping is None or isinstance(mapping, str | Path)):
        return {}, dict(options)
    beside = root / MAPPING_NAME
    path = as_path(mapping) if mapping is not None else beside if beside.is_file() else None
    beside_others = mapping is None and format != "cirrus"  # which has a mapping of another kind
    if path is None or not (beside_others or maps_classes(path)):
        return {}, dict(options)
    return read_class_mapping(path), {name: value for name, value in options.items() if name != "mapping"}


def _no_folder(root: Path) -> str:
    """What stands where a folder should, and what to do; the end of a sentence."""
    if root.is_symlink() and not root.exists():
        return f"a link to {root.readlink()}, which is not there or leads in a circle."
    if not root.exists():
        near: list[str] = []
        with suppress(OSError):
            near = [] if isinstance(root, RemotePath) else [one.name for one in root.parent.iterdir() if one.is_dir()]
        return f"nothing.{did_you_mean(root.name, [*near, open_sweeps.NAME])}"
    from farfield.files.bags import FILE_SUFFIXES
    from farfield.frame.cloud import CLOUD_SUFFIXES

    if root.suffix.lower() in (*FILE_SUFFIXES, *CLOUD_SUFFIXES):
        return f"one file. Name the folder that holds it: {root.parent}."
    advice = advice_on(root)
    return f"a file ({advice})." if advice else "a file."


def _unread(root: Path) -> str:
    """Sentences on files that no reader takes."""
    texts = unread_files(root)
    links = [entry for entry in root.iterdir() if entry.is_symlink() and not entry.exists()]
    if links:
        texts = (*texts, f"{links[0].name} is a link to {links[0].readlink()}, which is not there")
    return "".join(f"{text}. " for text in texts)


def _archived(root: Path) -> str:
    """Sentences on what lies in a folder's archives."""
    sentences = archive_sentences(root)
    if not sentences:
        return ""
    store = f" K-Radar's radar: farfield convert {root} STORE --to radar-store." if "K-Radar" in str(sentences) else ""
    return f"In its archives: {'; '.join(sentences)}. Unpack them into one folder.{store} "


def _inside(root: Path) -> str:
    """A sentence on data sets one folder deeper, and on labels that stand outside them."""
    folders = sorted(entry for entry in root.iterdir() if entry.is_dir())[:50]
    format_of_folder = {entry.name: name for entry in folders if (name := recognise(entry)) is not None}
    shown = ", ".join(f"{entry} ({name})" for entry, name in list(format_of_folder.items())[:3])
    if not format_of_folder:
        return ""
    is_own = "folder" in format_of_folder.values()
    outside = [
        entry.name
        for entry in sorted(root.iterdir())
        if is_own and entry.name not in format_of_folder and _holds_labels(entry)
    ]
    move = f", with {', '.join(outside)} moved into it, since labels beside the folder are not read" if outside else ""
    return f"One folder deeper there is {shown}: open that{move}. "


def _holds_labels(path: Path) -> bool:
    """Whether a name is one of labels: of a table, or of a folder of files."""
    is_table = path.suffix.lower() == ".csv" and path.is_file()
    return is_table or any(word in path.name.lower() for word in ("label", "annotation", "boxes"))


def _checked_options(format: str, reader: Any, options: Mapping[str, Any]) -> set[str]:
    """Options that are the reader's own; the others are views, of which it must offer each."""
    own = _parameters(reader)
    if own is None:
        return set(options) - {*_EVERYWHERE, *reader.view_options}
    offered = [*own, *(name for name in reader.view_options if name not in own), *_EVERYWHERE]
    unknown = [name for name in options if name not in offered]
    if unknown:
        flag = _CLOUD_FLAGS.get(unknown[0], "")
        raise ConfigError(
            f"open_dataset: the {format} reader does not know the option {unknown[0]!r}{flag}; it knows "
            f"{', '.join(offered)}"
        )
    return set(own)


def _parameters(reader: Any) -> list[str] | None:
    """The options of a reader's own; None where it takes any."""
    parameters = [*inspect.signature(reader).parameters.values()][1:]
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return None
    return [parameter.name for parameter in parameters]


def known_options(path: Path | str, options: Iterable[str]) -> set[str]:
    """Those of some options of :func:`open_dataset` that a data set's format knows; all where it is not recognised."""
    root = as_path(path).expanduser()
    format = recognise(root) if root.is_dir() else None
    reader = None if format is None else find_format(format).load()
    own = None if reader is None else _parameters(reader)
    if reader is None or own is None:
        return set(options)
    return set(options) & {*own, *reader.view_options, *_EVERYWHERE, "mapping"}


def _viewed(data: Dataset, options: Mapping[str, Any]) -> Dataset:
    """The data set through the maps that options stand for, less those that change nothing."""
    if not options:
        return data
    turn = options.get("rotate_deg") or 0.0
    if any(abs(abs(turn) - part * np.pi) < 1e-3 for part in (0.25, 0.5, 0.75, 1, 1.5, 2)):
        raise ConfigError(
            f"open_dataset: expected rotate_deg in degrees, got {turn:g}: radians? That is {np.rad2deg(turn):g} degrees"
        )
    reference = options.get("reference")
    if reference is not None and reference not in data.references:
        offered = " or ".join(data.references)
        raise ConfigError(f"open_dataset: expected reference {offered} for {data.name}, got {reference!r}")
    usual = [("coordinates", {"reference": own}) for own in data.references[:1]]
    usual += [("radar_view", {})] if "radar_rate" in data.view_options else []
    changes_nothing = [described(make(name, settings)) for name, settings in usual]
    for function in maps_of_options(options):
        data = data if described(function) in changes_nothing else data.mapped(function)
    return data
