"""Every format that is read or written, from the registries: data sets, targets, labels, results, single clouds.

The names are those of the registries alone; facts stand beside the formats. A name without facts is an error, but for
those of other packages.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from farfield.datasets.convert import CAPACITIES
from farfield.datasets.formats import DATASETS, FormatFacts, find_format
from farfield.datasets.labels.formats import forms_in_a_folder, readers_saved_in_place
from farfield.datasets.result_files import RESULT_FORMATS
from farfield.datasets.unread import advice_on
from farfield.errors import ConfigError, FarfieldError
from farfield.frame.cloud import CLOUD_SUFFIXES
from farfield.metrics.box_files import FORMATS as SCORED_FORMS
from farfield.simulation.rig import RIGS
from farfield.vocabulary.forms import CLOUD_FORMS, LABEL_FORMS, RESULT_FORMS, FormFacts


@dataclass(frozen=True, kw_only=True)
class FormatEntry:
    """One format of data sets.

    Args:
        name: Its name, as ``--format`` takes it.
        origin: ``"farfield"``, or the package that has it.
        looked_for: What a folder is recognised by.
        facts: What is known of it; None for those of other packages that say nothing.
        written: How it is written: ``"convert --to kitti"``, ``"simulate"``.
        saved: Whether the studio saves labels in the data set's own files.
        scored: The protocol that scores detections in it unless another is named.
        broken: Why it cannot be used; empty where it can.
        options: What its reader can be told, as ``--reader NAME=VALUE`` and ``open_dataset`` take it.
    """

    name: str
    origin: str
    looked_for: str
    facts: FormatFacts | None
    written: tuple[str, ...] = ()
    saved: bool = False
    scored: str = ""
    broken: str = ""
    options: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FormEntry:
    """One form of files beside data sets.

    Args:
        kind: ``"labels"``, ``"results"`` or ``"clouds"``.
        name: Its name; of clouds the suffix.
        facts: What is known of it.
        uses: What reads and writes it, in words.
    """

    kind: str
    name: str
    facts: FormFacts
    uses: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FormatCatalogue:
    """All of them.

    Args:
        datasets: Formats of data sets, in the order in which folders are tried.
        forms: Labels, results and single clouds.
        targets: Targets of conversions in words, by what `farfield convert --to` takes.
    """

    datasets: tuple[FormatEntry, ...]
    forms: tuple[FormEntry, ...]
    targets: Mapping[str, str] = field(default_factory=dict)

    def find(self, word: str) -> tuple[FormatEntry | FormEntry, ...]:
        """Those of a name (several kinds may have it), else those that a word stands for or that are described by it.

        Args:
            word: A format, or any word that a user has: a sensor, a suffix, a data set, a tool.

        Raises:
            ConfigError: If there is none; the message says what is known of files of such a suffix.
        """
        entries: tuple[FormatEntry | FormEntry, ...] = (*self.datasets, *self.forms)
        plain = _squeezed(word).lstrip(".")
        names = _WORDS.get(plain, ())
        ways = (
            lambda entry: entry.name == word or _squeezed(entry.name).lstrip(".") == plain,
            lambda entry: entry.name in names,
            lambda entry: _mentions(_described(entry), word, plain),
        )
        matches = [tuple(filter(way, entries)) for way in ways] if plain else []
        if any(matches[:2]):
            return tuple(dict.fromkeys((*matches[0], *matches[1])))
        if any(matches):
            return matches[2]
        advice = advice_on(Path(f"x.{word.lstrip('.').lower()}"))
        if advice:
            raise ConfigError(f"{word} is not read ({advice}).")
        listed = ", ".join(dict.fromkeys(entry.name for entry in entries))
        raise ConfigError(
            f"Expected a format, or a sensor, suffix, data set or tool that one is described by, one of {listed}; got "
            f"{word!r}."
        )


_WORDS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("velodyne", "vlp16", "vlp32", "hdl32", "hdl64", "vls128", "alphaprime"), ("captures", "bags")),
    **dict.fromkeys(("hesai", "pandar", "pandar64", "pandar40", "pandarxt", "qt128"), ("captures", "bags")),
    **dict.fromkeys(("ouster", "os0", "os1", "os2", "osdome"), ("ouster", "osf", "bags")),
    **dict.fromkeys(("pcap", "pcapng"), ("captures", "ouster")),
    **dict.fromkeys(
        ("rosbag", "rosbags", "rosbag2", "bag", "ros", "ros1", "ros2", "mcap", "db3", "foxglove"), ("bags",)
    ),
    **dict.fromkeys(("livox", "robosense", "innoviz", "aeva", "luminar", "sick"), ("bags", "folder", ".pcd")),
    **dict.fromkeys(("parquet", "waymov2", "womd"), ("waymo",)),
    **dict.fromkeys(("feather", "av2"), ("argoverse2",)),
    **dict.fromkeys(("laspy", "copc"), (".las", ".laz")),
    **dict.fromkeys(("mmdetection3d", "mmdet3d", "pcdet"), ("openpcdet",)),
    **dict.fromkeys(("vod", "delft"), ("view_of_delft",)),
    **dict.fromkeys(("datumaro",), ("cvat",)),
    "xtreme1": ("openlabel", "cvat"),
    "csv": ("boxes-csv",),
}
"""What words of users stand for that no format has in its name: sensors, suffixes, tools."""


def _squeezed(text: str) -> str:
    return re.sub(r"[\s_-]", "", text.lower())


def _described(entry: FormatEntry | FormEntry) -> str:
    """The words that describe a format, what it lacks aside."""
    facts = entry.facts
    if isinstance(entry, FormEntry):
        return f"{entry.name} {entry.facts.title} {entry.facts.holds} {entry.facts.extra}"
    own = "" if facts is None or isinstance(facts, FormFacts) else f"{facts.title} {facts.read} {facts.extra}"
    return f"{entry.name} {entry.looked_for} {own}"


def _mentions(text: str, word: str, plain: str) -> bool:
    """Whether a text has a word, or of a longer one its letters, whatever is written between."""
    whole = re.search(rf"(?<![a-z0-9]){re.escape(word.lower().lstrip('.'))}(?![a-z])", text.lower())
    return whole is not None or (len(plain) >= _LONG_WORD and plain in _squeezed(text))


_LONG_WORD = 6


def _options(reader: object) -> tuple[str, ...]:
    """The options of a reader with their types, as its signature has them."""
    parameters = list(inspect.signature(reader).parameters.values()) if callable(reader) else []
    return tuple(
        f"{parameter.name} ({inspect.formatannotation(parameter.annotation)})"
        for parameter in parameters
        if parameter.kind is parameter.KEYWORD_ONLY
    )


def format_catalogue() -> FormatCatalogue:
    """Every format that is registered here.

    Raises:
        ConfigError: If a format of this package has no facts.
    """
    return FormatCatalogue(
        datasets=tuple(map(_entry, DATASETS.names())),
        forms=(*_labels(), *_results(), *_clouds()),
        targets={capacity.words or target: capacity.title for target, capacity in CAPACITIES.items()},
    )


def _entry(name: str) -> FormatEntry:
    origin = DATASETS.origin(name)
    try:
        format = find_format(name)
        reader = format.load()
    except (FarfieldError, ImportError) as error:
        return FormatEntry(name=name, origin=origin, looked_for="", facts=None, broken=str(error))
    if format.facts is None and name in DATASETS.builtin:
        raise ConfigError(f"format {name!r}: expected facts in its entry, datasets/entries/{name}.py; got none")
    written = [
        f"convert --to {capacity.words or target}"
        for target, capacity in CAPACITIES.items()
        if capacity.read_by == name
    ]
    return FormatEntry(
        name=name,
        origin=origin,
        looked_for=format.looked_for,
        facts=format.facts,
        written=(*written, *(["simulate"] if name in RIGS.names() else [])),
        saved=name in readers_saved_in_place(),
        scored=reader.protocol,
        options=_options(reader),
    )


def _labels() -> list[FormEntry]:
    exported = [f"convert --to {name}" if name in CAPACITIES else "" for name in forms_in_a_folder()]
    return [
        FormEntry(
            kind="labels",
            name=name,
            facts=_facts(LABEL_FORMS, name, "labels"),
            uses=tuple(filter(None, ("annotate", convert))),
        )
        for name, convert in zip(forms_in_a_folder(), exported, strict=True)
    ]


def _results() -> list[FormEntry]:
    return [
        FormEntry(
            kind="results",
            name=name,
            facts=_facts(RESULT_FORMS, name, "results"),
            uses=(
                *(["predict --to"] if name in RESULT_FORMATS else []),
                *(["score --format"] if name in SCORED_FORMS else []),
            ),
        )
        for name in dict.fromkeys((*SCORED_FORMS, *RESULT_FORMATS))
    ]


def _clouds() -> list[FormEntry]:
    return [
        FormEntry(kind="clouds", name=suffix, facts=_facts(CLOUD_FORMS, suffix, "clouds"), uses=("a folder", "predict"))
        for suffix in CLOUD_SUFFIXES
    ]


def _facts(table: Mapping[str, FormFacts], name: str, kind: str) -> FormFacts:
    """Facts of a registered form.

    Raises:
        ConfigError: If there are none.
    """
    if name not in table:
        raise ConfigError(f"form {name!r} of {kind}: expected facts in farfield.vocabulary.forms, got none")
    return table[name]
