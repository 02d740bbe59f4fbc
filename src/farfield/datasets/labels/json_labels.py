"""Label files in JSON, edited value by value: what did not change keeps its bytes, also within an object."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from farfield.datasets.labels.contract import BoxLabel, Numbers, Value
from farfield.datasets.labels.lines import kept_numbers
from farfield.errors import ConfigError
from farfield.files.cuboids import Cuboid, CuboidEntry
from farfield.files.json_text import remove, set_value
from farfield.frame import Key

_BOM = "\ufeff"


class JsonLabels(ABC):
    """What the JSON formats have in common: :class:`~farfield.datasets.labels.contract.LabelFormat` but for ``path``.

    A format says how its cuboids are found, what an entry says of one, and how one more is put in.
    """

    name: ClassVar[str]
    attributes: Mapping[str, tuple[Value, ...]] = {}

    @abstractmethod
    def path(self, key: Key) -> Path:
        """The file of a frame."""

    @abstractmethod
    def placed(self, data: bytes, path: Path) -> Sequence[CuboidEntry]:
        """All cuboids of a file with the ways to them."""

    @abstractmethod
    def empty(self) -> str:
        """A file without objects."""

    @abstractmethod
    def values(self, cuboid: Cuboid, text: str, place: CuboidEntry | None) -> Mapping[tuple[str | int, ...], Any]:
        """What an entry says of a cuboid, by the way to it within the entry."""

    @abstractmethod
    def with_new(self, text: str, cuboid: Cuboid) -> str:
        """A file's text with a cuboid more."""

    def of_frame(self, placed: CuboidEntry, key: Key) -> bool:
        """Whether a cuboid is a frame's; a file that holds one frame names none."""
        name = placed.cuboid.frame
        if name in ("", key[1]):
            return True
        return name.isdecimal() and key[1].isdecimal() and int(name) == int(key[1])

    def prepared(self, text: str, place: CuboidEntry | None, cuboid: Cuboid) -> str:
        """A file's text that can hold a cuboid; formats that list their classes add one here."""
        del place, cuboid
        return text

    def stale(self) -> Sequence[tuple[str | int, ...]]:
        """What no longer holds of a box that was moved, such as its count of points."""
        return ()

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Labels of the frames in the file's order."""
        placed = self.placed(data, path)
        return {key: tuple(_labels([each for each in placed if self.of_frame(each, key)])) for key in keys}

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file with other labels in some frames."""
        text = self.empty() if data is None else data.decode("utf-8")
        placed = [] if data is None else self.placed(data, path)
        gone: list[tuple[str | int, ...]] = []
        fresh: list[Cuboid] = []
        for key, wanted in labels.items():
            left = {label.id: label for label in wanted}
            for number, place in enumerate([each for each in placed if self.of_frame(each, key)]):
                new = left.pop(str(number), None)
                moves = new is not None and self.moves(place.cuboid, new)
                if new is None or moves:
                    gone.append(place.steps)
                if new is not None and moves:
                    fresh.append(_cuboid(new, place.cuboid))
                elif new is not None:
                    text = self._changed(text, place, new)
            fresh += [_cuboid(label, Cuboid(frame=key[1], label="", box=label.box)) for label in left.values()]
        for steps in sorted(gone, reverse=True):
            text = remove(text, steps)
        for cuboid in fresh:
            text = self.with_new(self.prepared(text, None, cuboid), cuboid)
        return text.encode()

    def moves(self, old: Cuboid, new: BoxLabel) -> bool:
        """Whether an object has to leave its place in the file, such as for another track."""
        del old, new
        return False

    def _changed(self, text: str, place: CuboidEntry, new: BoxLabel) -> str:
        cuboid = _cuboid(new, place.cuboid)
        if cuboid == place.cuboid:
            return text
        text = self.prepared(text, place, cuboid)
        before, after = (self.values(each, text, place) for each in (place.cuboid, cuboid))
        for steps, value in after.items():
            if steps not in before or before[steps] != value:
                text = set_value(text, (*place.steps, *steps), value)
        if cuboid.box != place.cuboid.box:
            for steps in self.stale():
                text = remove(text, (*place.steps, *steps))
        return text


def _labels(placed: Sequence[CuboidEntry]) -> list[BoxLabel]:
    return [
        BoxLabel(id=str(number), label=one.label, box=one.box, track=one.track, attributes=one.attributes)
        for number, one in enumerate(each.cuboid for each in placed)
    ]


def _cuboid(label: BoxLabel, old: Cuboid) -> Cuboid:
    box: Numbers = kept_numbers(old.box, label.box)
    attributes = dict(old.attributes) | dict(label.attributes)
    if not label.label:
        raise ConfigError(f"label {label.id}: expected a class, got none")
    return replace(old, label=label.label, box=box, track=label.track, attributes=attributes)
