"""One HTML file that opens from disk without a server: the page, its script and the frames in it.

What the page would fetch stands in the file, packed by gzip and written in base64; the browser unpacks it by itself.
The built page cannot be opened from disk as it is: browsers refuse module scripts of ``file://``, but not inline ones.
"""

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from farfield.errors import ConfigError
from farfield.studio.messages.base import plain
from farfield.studio.messages.replies import FrameState, Welcome

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
    held = {
        "welcome": plain(welcome),
        "frames": [plain(frame) for frame in frames],
        "payloads": {url: _packed(body) for url, body in payloads.items()},
    }
    data = json.dumps(held, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
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
    found = pattern.search(text)
    if found is None:
        raise ConfigError(
            f"html: expected one script and one style sheet in index.html, found none like {pattern.pattern}"
        )
    return (static / found[1]).read_text("utf-8")


def _packed(body: bytes) -> str:
    return base64.b64encode(gzip.compress(body, 6, mtime=0)).decode()


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
