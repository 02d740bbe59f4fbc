"""Pages from the templates that lie in this folder."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

from farfield.vocabulary.counts import count_of

_SECTION = re.compile(r"<section([^>]*)>(\s*)<h2>(.*?)</h2>", re.DOTALL)
_PLACE = "<!-- contents -->\n"
_FEW = 4
"""Pages of fewer sections have no list of contents."""


@dataclass(frozen=True)
class PageImage:
    """A picture in a page.

    Args:
        uri: ``data:`` address.
        alt: What it shows, for those who cannot see it.
        caption: What stands under it.
        heading: What stands above it.
    """

    uri: str
    alt: str
    caption: str = ""
    heading: str = ""


def render_template(
    name: str,
    filters: Mapping[str, Callable[..., Any]] | None = None,
    *,
    package: str = "farfield.pages",
    **values: Any,
) -> str:
    """A page as HTML; what it shows is escaped, and a value that a template misses is an error.

    Args:
        name: File of the template, such as ``"page.html"``.
        filters: Functions that the template may apply.
        package: Package in whose folder the file lies; what it extends or includes may lie in this one.
        values: What it shows.
    """
    from jinja2 import ChoiceLoader, Environment, FunctionLoader, StrictUndefined

    home = files("farfield.pages")
    environment = Environment(
        loader=ChoiceLoader([FunctionLoader(partial(_text, folder)) for folder in (files(package), home)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({"count_of": count_of, "shown": fact_text, **(filters or {})})
    style = (home / "page.css").read_text(encoding="utf-8")
    return _with_contents(environment.get_template(name).render(style=style, **values))


def fact_text(value: Any) -> str:
    """A setting's value in words: numbers to six digits, lists and mappings by commas."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str | int):
        return str(value)
    if isinstance(value, list | tuple) and all(isinstance(item, str | int | float) for item in value):
        return ", ".join(fact_text(item) for item in value) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {fact_text(item)}" for key, item in value.items()) or "none"
    return json.dumps(value, default=str)


def _with_contents(page: str) -> str:
    """The page with an anchor at each section, and a list that leads to them where they are several."""
    titles = [re.sub(r"<[^>]+>", "", match[3]).strip() for match in _SECTION.finditer(page)]
    anchors: list[str] = []
    for title in titles:
        stem = re.sub(r"[^a-z0-9]+", "-", re.sub(r"&[a-z0-9#]+;", " ", title.lower())).strip("-") or "section"
        taken = sum(anchor == stem or re.fullmatch(rf"{stem}-\d+", anchor) is not None for anchor in anchors)
        anchors.append(f"{stem}-{taken + 1}" if taken else stem)
    left = iter(anchors)
    page = _SECTION.sub(lambda match: f'<section{match[1]} id="{next(left)}">{match[2]}<h2>{match[3]}</h2>', page)
    rows = "".join(f'<li><a href="#{anchor}">{title}</a></li>\n' for anchor, title in zip(anchors, titles, strict=True))
    contents = f'<nav aria-label="Contents"><ul>\n{rows}</ul></nav>\n' if len(titles) >= _FEW else ""
    return page.replace(_PLACE, contents, 1)


def _text(folder: Traversable, name: str) -> str | None:
    file = folder / name
    return file.read_text(encoding="utf-8") if file.is_file() else None
