"""The papers' tables put to the test by one command: a declared grid of experiments, planned, run and decided.

reproduction = Reproduction.of("cirrus", budget="laptop", out=Path("runs/reproduce-cirrus-laptop"), report=print)
reproduction.outline()      # measures, then says what it costs and which claims can be decided
reproduction.run()          # the page; interrupted, the same call goes on

Names are imported when they are used: claims and what was decided on them are read without torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farfield.papers.grid import ExperimentGrid, load_grid
    from farfield.papers.planning import GridPlan, described
    from farfield.papers.reproducing import Reproduction

_HOMES = {
    "ExperimentGrid": "grid",
    "GridPlan": "planning",
    "Reproduction": "reproducing",
    "described": "planning",
    "load_grid": "grid",
}
__all__ = ["ExperimentGrid", "GridPlan", "Reproduction", "described", "load_grid"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"farfield.papers.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
