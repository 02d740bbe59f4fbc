"""URLs among a verb's words: data are read from stores, outputs are uploaded when they are whole."""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TextIO, cast

from farfield.files.remote_stores import is_url
from farfield.vocabulary.counts import count_of

OUTPUTS = frozenset(
    {"out", "target", "folder", "json", "picture", "html", "film", "draw", "save", "bundle", "edits"},
)
"""Arguments of verbs that name what is written."""


def run_with_urls(
    function: Callable[..., int | None], args: tuple[Any, ...], named: Mapping[str, Any], names: Iterable[str]
) -> int | None:
    """Run a verb whose arguments may be URLs.

    Args:
        function: The verb.
        args: Its arguments by place.
        named: Its arguments by name.
        names: The names of the arguments by place.
    """
    arguments = {**dict(zip(names, args, strict=False)), **named}
    if not any(map(_has_url, arguments.values())):
        return function(*args, **named)
    with ExitStack() as stack:
        urls: dict[str, str] = {}
        changed = {
            name: _output(value, stack, urls) if name in OUTPUTS else _input(value) for name, value in arguments.items()
        }
        by_name = {name: changed.pop(name) for name in named}
        stack.enter_context(redirect_stdout(cast("TextIO", _Naming(sys.stdout, urls))))
        return function(*changed.values(), **by_name)


class _Naming:
    """A stream on which outputs go by their URLs instead of by where they are made."""

    def __init__(self, stream: Any, urls: Mapping[str, str]) -> None:
        self.stream, self.urls = stream, urls

    def write(self, text: str) -> int:
        for path, url in self.urls.items():
            text = text.replace(path, url)
        return int(self.stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def _has_url(value: Any) -> bool:
    if isinstance(value, tuple | list):
        return any(map(_has_url, value))
    if is_dataclass(value):
        return any(_has_url(getattr(value, field.name)) for field in fields(value))
    return isinstance(value, Path) and is_url(str(value))


def _input(value: Any) -> Any:
    """An argument with its paths that are URLs as such."""
    from farfield.files.remote_paths import as_path

    if isinstance(value, tuple | list):
        return type(value)(map(_input, value))
    if is_dataclass(value) and not isinstance(value, type) and _has_url(value):
        return replace(value, **{field.name: _input(getattr(value, field.name)) for field in fields(value)})
    return as_path(str(value)) if _has_url(value) else value


def _output(value: Any, stack: ExitStack, urls: dict[str, str]) -> Any:
    """An output with its path on this machine, where it is a URL; it is uploaded as the stack ends.

    Args:
        value: The argument.
        stack: Uploads at its end.
        urls: Takes the URL by the path.
    """
    if not _has_url(value) or not isinstance(value, Path):
        return value
    from farfield.files.remote_paths import as_path

    url = str(as_path(str(value)))
    path = stack.enter_context(_uploading(url))
    urls[str(path)] = url
    return path


@contextmanager
def _uploading(url: str) -> Iterator[Path]:
    from farfield.jobs.uploads import uploaded

    with uploaded(url, bar=_bar) as path:
        print(f"{url}: made in {path}, and uploaded when it is whole", file=sys.stderr)
        yield path
    print(f"{url}: uploaded", file=sys.stderr)


def _bar(files: Iterable[Any], what: str) -> Iterator[Any]:
    from farfield.cli._output import bar

    listed = list(files)
    yield from bar(listed, f"{what} ({count_of(len(listed), 'file')})", transient=True)
