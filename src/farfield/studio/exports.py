"""What a person takes away: pictures, films of them, label files, and one HTML file that opens from disk.

What that page would fetch stands in the file, packed by gzip and written in base64; the browser unpacks it by itself.
The built page cannot be opened from disk as it is: browsers refuse module scripts of ``file://``, but not inline ones.
"""

import base64
import gzip
import hashlib
import itertools
import json
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.errors import ConfigError
from farfield.studio.messages.replies import FrameState, Welcome
from farfield.studio.messages.rows import plain

_PNG = b"\x89PNG\r\n\x1a\n"
_MOST_BYTES = 1 << 30
_KINDS = {
    ".png": "image/png",
    ".gif": "image/gif",
    ".webp": "image/webp",
    ".html": "text/html; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".zip": "application/zip",
    ".json": "application/json",
}


@dataclass(frozen=True)
class ExportedFile:
    """A file to fetch.

    Args:
        path: Where it stands.
        name: What the browser calls it.
        kind: Media type.
    """

    path: Path
    name: str
    kind: str


class Exports:
    """Pictures that the page sent, and what was made."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._made: dict[str, ExportedFile] = {}
        self._numbers = itertools.count(1)
        self._bytes = 0

    @property
    def folder(self) -> Path:
        """The folder, made when it is first needed."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="farfield-studio-"))
        return self._folder

    def keep(self, png: bytes) -> str:
        """Keep a picture that the page sent; gives its name.

        Raises:
            ConfigError: If it is no PNG, or too much is kept already.
        """
        if not png.startswith(_PNG):
            raise ConfigError("shot: expected a PNG image")
        if self._bytes + len(png) > _MOST_BYTES:
            raise ConfigError(f"shot: {_MOST_BYTES >> 30} GiB of pictures are kept already; restart the studio")
        self._bytes += len(png)
        name = f"shot-{next(self._numbers)}"
        path = self.folder / f"{name}.png"
        path.write_bytes(png)
        self._made[name] = ExportedFile(path, path.name, _KINDS[".png"])
        return name

    def shots(self, names: tuple[str, ...]) -> list[Path]:
        """Files of pictures by name.

        Raises:
            ConfigError: If there is no such picture.
        """
        missing = [name for name in names if name not in self._made or self._made[name].kind != _KINDS[".png"]]
        if missing:
            raise ConfigError(f"export: expected pictures that were sent, got {missing[0]!r}")
        return [self._made[name].path for name in names]

    def new(self, name: str, ending: str) -> tuple[str, ExportedFile]:
        """A place for a file to be made, and its name in links.

        Args:
            name: What the browser is to call it.
            ending: Its ending, such as ``.gif``.
        """
        job = f"export-{next(self._numbers)}"
        called = name if name.lower().endswith(ending) else name + ending
        file = ExportedFile(self.folder / f"{job}{ending}", called, _KINDS[ending])
        self._made[job] = file
        return job, file

    def result(self, job: str) -> ExportedFile | None:
        """A file that was made."""
        file = self._made.get(job)
        return file if file is not None and file.path.is_file() else None

    def close(self) -> None:
        """Remove everything."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)


# The HTML file

MOST_FRAMES = 20
_SCRIPT = re.compile(r'<script type="module"[^>]*src="\./([\w.-]+)"[^>]*></script>')
_STYLE = re.compile(r'<link rel="stylesheet"[^>]*href="\./([\w.-]+)"[^>]*>')


def standalone(static: Path, welcome: Welcome, frames: Sequence[FrameState], payloads: Mapping[str, bytes]) -> str:
    """The file's text.

    Args:
        static: Folder of the built page.
        welcome: What is open.
        frames: The frames that it holds.
        payloads: Bytes by the link under which the page would fetch them.

    Raises:
        ConfigError: If there are too many frames, or the page is not built.
    """
    if not 0 < len(frames) <= MOST_FRAMES:
        size = sum(map(len, payloads.values())) / 2e6
        raise ConfigError(
            f"html: expected 1 to {MOST_FRAMES} frames, got {len(frames)} (some {size:.0f} MB): choose fewer, or make "
            "a film"
        )
    index = static / "index.html"
    if not index.is_file():
        raise ConfigError("html: the page is not built: run `npm ci && npm run build` in web/, or install a wheel")
    text = index.read_text("utf-8")
    script, style = _inlined(static, _SCRIPT, text), _inlined(static, _STYLE, text)
    script = re.sub(r"</(script)", r"<\\/\1", script, flags=re.IGNORECASE)
    embedded = {
        "welcome": plain(welcome),
        "frames": [plain(frame) for frame in frames],
        "payloads": {url: base64.b64encode(gzip.compress(body, 6, mtime=0)).decode() for url, body in payloads.items()},
    }
    data = json.dumps(embedded, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; img-src blob: data:; "
        "base-uri 'none'; form-action 'none'"
    )
    inline = f'<script type="application/json" id="farfield-data">{data}</script>\n'
    inline += f'    <script type="module">{script}</script>'
    text = _SCRIPT.sub(lambda _: inline, text, count=1)
    text = _STYLE.sub(lambda _: f"<style>{style}</style>", text, count=1)
    meta = f'<meta http-equiv="Content-Security-Policy" content="{policy}" />'
    return text.replace('<meta charset="utf-8" />', f'<meta charset="utf-8" />\n    {meta}', 1)


def _inlined(static: Path, pattern: re.Pattern[str], text: str) -> str:
    match = pattern.search(text)
    if match is None:
        raise ConfigError(
            f"html: expected one script and one style sheet in index.html, found none like {pattern.pattern}"
        )
    return (static / match[1]).read_text("utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
