"""Transfer between radar data sets (K-Radar, appendix G) as one declared table: worlds, rows, shares, decisions."""

from farfield.papers.transfer.deciding import cells_of, lines_of
from farfield.papers.transfer.declared import TransferTable, load_table, runs_of
from farfield.papers.transfer.planning import outline
from farfield.papers.transfer.running import TransferExperiment

__all__ = ["TransferExperiment", "TransferTable", "cells_of", "lines_of", "load_table", "outline", "runs_of"]
