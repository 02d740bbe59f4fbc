"""Transfer between radar data sets (K-Radar, appendix G) as a declared grid: worlds, rows, shares, decisions.

transfer = TransferExperiment(table=load_table(), out=Path("runs/reproduce-kradar-transfer"))
transfer.outline()          # measures, then says what it costs
transfer.run()              # simulates, trains and scores; interrupted, the same call goes on
transfer.write()            # the table as text, JSON and a page
"""

from farfield.papers.transfer.experiment import TransferExperiment
from farfield.papers.transfer.results import cells_of, lines_of
from farfield.papers.transfer.table import TransferTable, load_table, transfer_jobs

__all__ = ["TransferExperiment", "TransferTable", "cells_of", "lines_of", "load_table", "transfer_jobs"]
