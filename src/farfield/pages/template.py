"""Pages from the templates that lie in this folder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any


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
    environment.filters.update(filters or {})
    return environment.get_template(name).render(style=(home / "page.css").read_text(encoding="utf-8"), **values)


def _text(folder: Traversable, name: str) -> str | None:
    file = folder / name
    return file.read_text(encoding="utf-8") if file.is_file() else None
