"""One annotated object, and what a format of label files must do so that it can be edited."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from farfield.frame import Key

Numbers = tuple[float, float, float, float, float, float, float]
"""x, y, z of the centre, length, width, height (full sizes, metres), yaw (radians): in the frame's coordinates."""

Value = str | float | bool


@dataclass(frozen=True, kw_only=True, slots=True)
class BoxLabel:
    """One annotated object of one frame.

    Args:
        id: Its name within the frame. That of an object which a file holds is its place among the file's objects of
            that frame: ``"0"``, ``"1"``...
        label: Class as the data set spells it.
        box: x, y, z, length, width, height, yaw, see :data:`Numbers`.
        track: Its identity over time as the data set writes it; empty where it has none.
        state: ``proposed``, ``edited``, ``accepted`` or ``rejected``; what a file holds was accepted.
        source: What it was drawn from: ``lidar``, ``radar``, ``camera``, ``interpolated``, ``propagated``,
            ``detector``; empty where that is not known, as in most files.
        attributes: What else the format says of it, such as K-Radar's ``availability``.
        score: The detector's score of a proposal, or None.
    """

    id: str
    label: str
    box: Numbers
    track: str = ""
    state: str = "accepted"
    source: str = ""
    attributes: Mapping[str, Value] = field(default_factory=dict)
    score: float | None = None

    @property
    def keyframe(self) -> bool:
        """Whether a person stands for it: interpolation and propagation leave it as it is."""
        made = self.source in ("interpolated", "propagated", "detector")
        return self.state in ("edited", "accepted") and not (made and self.state != "accepted")


@runtime_checkable
class LabelFormat(Protocol):
    """The label files of one data set. An object knows its data set's layout; what it parses comes from the caller.

    ``parse`` and ``render`` are functions of bytes: nothing is read or written by them.
    """

    @property
    def name(self) -> str:
        """The format's name, such as ``kradar-v2.1``."""

    @property
    def attributes(self) -> Mapping[str, tuple[Value, ...]]:
        """Attributes that the files can hold, each with its possible values; none listed: any."""

    def path(self, key: Key) -> Path:
        """The file in which a frame's labels stand or would stand; one file may hold several frames.

        Raises:
            DatasetError: If the data set has no such frame.
        """

    def parse(self, data: bytes, path: Path, keys: Sequence[Key]) -> Mapping[Key, tuple[BoxLabel, ...]]:
        """Labels of the frames in a file, in its order, with ``id`` the place in that order.

        Args:
            data: The file's bytes.
            path: The file, for messages.
            keys: Frames whose labels are wanted; one that the file does not mention has none.

        Raises:
            FileFormatError: If the file is damaged.
        """

    def render(self, data: bytes | None, path: Path, labels: Mapping[Key, Sequence[BoxLabel]]) -> bytes:
        """The file's bytes with other labels in some frames.

        An object whose ``id`` and values (as far as the files hold them) are those that ``parse`` finds in ``data``
        keeps its bytes, as do the header, everything that is no object, and the end of the file. One that changed is
        written anew in its place with ``repr(float)``, one that is missing in ``labels`` goes, and ids that ``data``
        does not have are appended in the order given.

        Args:
            data: The bytes of the file as it stands; None for a new one.
            path: The file, for messages.
            labels: All labels of each frame that changed; frames that are not named stay as they are.

        Raises:
            FileFormatError: If ``data`` is damaged.
            ConfigError: If a label cannot be written in this format, such as one of an unknown class.
        """
