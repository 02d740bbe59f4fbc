"""Pages from the templates that lie in this folder."""

from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any


def render_template(name: str, filters: Mapping[str, Callable[..., Any]] | None = None, **values: Any) -> str:
    """A page as HTML; what it shows is escaped, and a value that a template misses is an error.

    Args:
        name: File of the template, such as ``"page.html"``.
        filters: Functions that the template may apply.
        values: What it shows.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    home = files("farfield.reports")
    environment = Environment(
        loader=FunctionLoader(lambda file: (home / file).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters or {})
    return environment.get_template(name).render(style=(home / "page.css").read_text(encoding="utf-8"), **values)
