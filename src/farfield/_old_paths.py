"""Modules that pages of earlier versions imported from, under their old paths, for one version and with a warning."""

import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

HOMES = {
    "farfield.bulk.Bulk": "farfield.jobs:JobOptions",
    "farfield.bulk.BulkError": "farfield.jobs:BulkError",
    "farfield.bulk.Done": "farfield.jobs:UnitResult",
    "farfield.bulk.ENGINES": "farfield.jobs:ENGINES",
    "farfield.bulk.Engine": "farfield.jobs:Engine",
    "farfield.bulk.Journal": "farfield.jobs:JobJournal",
    "farfield.bulk.Unit": "farfield.jobs:Unit",
    "farfield.bulk.run": "farfield.jobs:run",
    "farfield.bulk.values": "farfield.jobs:values",
    "farfield.detectors.contract.Channels": "farfield.detectors.config:Channels",
    "farfield.detectors.contract.MapDetector": "farfield.detectors.network:MapDetector",
    "farfield.detectors.contract.Network": "farfield.detectors.network:Network",
    "farfield.detectors.grid.GridConfig": "farfield.detectors.config:GridConfig",
    "farfield.detectors.processes.normaliser": "farfield.detectors.losses:normaliser",
    "farfield.experiments.reproduce.Reproduction": "farfield.papers.reproducing:Reproduction",
    "farfield.experiments.reproduce.described": "farfield.papers.planning:described",
    "farfield.experiments.reproduce.load_grid": "farfield.papers.grid:load_grid",
    "farfield.imaging.depth.frame_depth": "farfield.depth:frame_depth",
    "farfield.imaging.privacy.Private": "farfield.privacy:Anonymized",
    "farfield.metrics.reading.read": "farfield.metrics.box_files:read",
    "farfield.recording.record": "farfield.simulation.recording:record",
    "farfield.reports.depth_picture.depth_picture": "farfield.figures.camera:depth_picture",
    "farfield.reports.figures.WINDOW_M": "farfield.figures.birds_eye:WINDOW_M",
    "farfield.reports.figures.overview": "farfield.figures.birds_eye:overview",
    "farfield.reports.objects.VEHICLES": "farfield.evaluation.report_data:VEHICLES",
    "farfield.reports.objects.sure": "farfield.evaluation.report_data:confident",
    "farfield.reports.plots.scan_patterns": "farfield.figures.plots:scan_patterns",
    "farfield.reports.style.figure_bytes": "farfield.figures.style:figure_bytes",
    "farfield.timing.StreamMatcher": "farfield.sync:StreamMatcher",
    "farfield.timing.fit_clock": "farfield.sync:fit_clock",
    "farfield.timing.match_times": "farfield.sync:match_times",
}
"""``module:name`` of today by the dotted name of before."""

_MODULES = {name.rpartition(".")[0] for name in HOMES}
_PACKAGES = {module.rpartition(".")[0] for module in _MODULES} - {"farfield", "farfield.detectors", "farfield.metrics"}


class OldPaths(MetaPathFinder, Loader):
    """Imports a module that is gone as one whose names are those of today."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Answer for modules of old paths alone; asked after all other finders."""
        del path, target
        if fullname not in _MODULES | _PACKAGES:
            return None
        return ModuleSpec(fullname, self, is_package=True)

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its names, looked up when they are used."""
        module.__dict__["__getattr__"] = partial(_name_of_today, module.__name__)


def _name_of_today(module: str, name: str) -> Any:
    home = HOMES.get(f"{module}.{name}")
    if home is None:
        raise AttributeError(f"module {module!r} has no attribute {name!r}")
    today, _, attribute = home.partition(":")
    warnings.warn(f"{module}.{name} is now {today}.{attribute}", DeprecationWarning, stacklevel=2)
    return getattr(import_module(today), attribute)


def install() -> None:
    """Let old paths be imported; a second call changes nothing."""
    if not any(type(finder).__name__ == "OldPaths" for finder in sys.meta_path):
        sys.meta_path.append(OldPaths())
