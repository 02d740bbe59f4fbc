"""The papers' tables put to the test by one command: a declared grid of experiments, planned, run and decided.

reproduction = Reproduction.of("cirrus", budget="laptop", out=Path("runs/reproduce-cirrus-laptop"), report=print)
reproduction.outline()      # measures, then says what it costs and which claims can be decided
reproduction.run()          # the page; interrupted, the same call goes on
"""

from farfield.papers.grid import ExperimentGrid, load_grid
from farfield.papers.planning import GridPlan, described
from farfield.papers.reproducing import Reproduction

__all__ = ["ExperimentGrid", "GridPlan", "Reproduction", "described", "load_grid"]
