"""Paths of the machine taken out of texts; names of files and stamps masked where that is asked for."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import Any

from farfield.datasets.formats import looked_for
from farfield.files.atomic import readable

ROOT_NAME = "DATA"
"""What stands for the data set's folder."""
_ABSOLUTE = re.compile(r"(?<![\w.*<>}])(?:[A-Za-z]:[\\/]|/|~/)[^\s,;:'\"()\[\]]*[^\s,;:'\"()\[\].]")
_TOKEN = re.compile(r"[^\s,;'\"()\[\]{}/\\]+")
_STAMP = re.compile(r"\d[\d.]{7,}")
_LETTERS = re.compile(r"[A-Za-z]+")


class Scrubber:
    """Makes texts fit to be sent: no path of the machine, and masked names if that is asked for.

    Names are masked alike everywhere, so that it can still be told which file a finding is about; those of folders that
    the layouts of data sets have are left.

    Args:
        root: The data set's folder, whose path becomes :data:`ROOT_NAME`.
        names: Names of files, folders, sequences and frames.
        masked: Whether names and stamps are masked.
    """

    def __init__(self, root: Path, names: Iterable[str], *, masked: bool) -> None:
        self.masked = masked
        self._roots = sorted({str(root), str(root.resolve()), str(root.absolute()), readable(str(root))}, key=len)[::-1]
        self._roots = [name for name in self._roots if name not in (".", "/", "")]
        self._layout = {word.lower() for text in looked_for().values() for word in _LETTERS.findall(text)} | _OUR_WORDS
        self._masks: dict[str, str] = {}
        if masked:
            for name in names:
                self._mask(PurePath(name).stem)

    def _mask(self, stem: str) -> str:
        if stem in self._masks or (
            all(word.lower() in self._layout for word in _LETTERS.findall(stem))
            and (_LETTERS.search(stem) and not _STAMP.search(stem))
        ):
            return self._masks.get(stem, stem)
        self._masks[stem] = f"name{len(self._masks) + 1}"
        return self._masks[stem]

    def name(self, name: str) -> str:
        """A name or a path from the root on."""
        if not self.masked:
            return name
        parts = []
        for part in name.split("/"):
            path = PurePath(part)
            parts.append(part if part in (".", "..", "") or "*" in part else self._mask(path.stem) + path.suffix)
        return "/".join(parts)

    def text(self, text: str) -> str:
        """A sentence."""
        for root in self._roots:
            text = text.replace(root, ROOT_NAME)
        text = _ABSOLUTE.sub("PATH", text)
        if not self.masked:
            return text
        text = _TOKEN.sub(self._masked_token, text)
        return _STAMP.sub("STAMP", text)

    def _masked_token(self, match: re.Match[str]) -> str:
        token = match.group()
        bare = token.strip(".:?!")
        path = PurePath(bare)
        for name, suffix in ((bare, ""), (path.stem, path.suffix)):
            if name in self._masks:
                return token.replace(bare, self._masks[name] + suffix)
        return token

    def tree(self, value: Any) -> Any:
        """All texts of JSON, keys included."""
        if isinstance(value, Mapping):
            return {self.text(str(key)): self.tree(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [self.tree(part) for part in value]
        return self.text(value) if isinstance(value, str) else value


_OUR_WORDS = {"training", "testing", "image", "label", "calib", "velodyne", "lidar", "radar", "camera", "cam", "os"}
_OUR_WORDS |= {"groundtruth", "obj", "annotation", "labels", "images", "info", "time", "navtech", "polar", "cartesian"}
_OUR_WORDS |= {
    "kradar",
    "revised",
    "visibility",
    "zyx",
    "cube",
    "tesseract",
    "dataset",
    "front",
    "left",
    "rear",
    "right",
}
