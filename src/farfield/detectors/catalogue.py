"""What is known of each detector: its paper, its size, its speed and its score on a frozen split. Needs no torch.

The figures are records: ``benchmarks/detectors.py budget`` measures them and writes ``weights_data/figures.json`` with
the split, its checksum, the machine and the commit; ``tools/shipped_figures.py`` takes speeds and the shipped weights'
scores, those of the radar experiments by weather too, from the results that the pages quote. Nothing here is measured
while it is read.
"""

from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from farfield.detectors.spec import DETECTORS
from farfield.files.json_text import plain_json


@dataclass(frozen=True)
class CatalogueEntry:
    """One detector.

    Args:
        name: Its name in an experiment's ``detector.name``.
        paper: Where it comes from.
        weights: Name of its bundled weights, for ``load_detector``; empty if none ship.
        further: Names of others that ship, such as those for another sensor.
        parameters: Number of trained parameters of the recorded network, or None.
        frame_ms: Milliseconds a frame from points to boxes by precision.
        scores: DDS figures by cloud, range and epsilon: ``scores["gaussian"]["150-250"]["0.006"]``.
        shipped: The same of the weights that ship, where they learnt longer than ``scores`` says.
        setting: Further facts of the record: grid, schedule.
        origin: Where the detector comes from: "farfield", "registered here", or the package that has it.
        broken: Why it cannot be used; empty where it can.
    """

    name: str
    paper: str
    weights: str = ""
    further: tuple[str, ...] = ()
    parameters: int | None = None
    frame_ms: dict[str, float] = field(default_factory=dict)
    scores: dict[str, dict[str, dict[str, float | None]]] = field(default_factory=dict)
    shipped: dict[str, dict[str, dict[str, float | None]]] = field(default_factory=dict)
    setting: dict[str, Any] = field(default_factory=dict)
    origin: str = "farfield"
    broken: str = ""


@dataclass(frozen=True)
class WeatherScores:
    """What bundled weights reach in each weather, on simulated K-Radar drives.

    Args:
        weights: Their name.
        detector: The detector's.
        cloud: The cloud that they read.
        parameters_m: Number of trained parameters, millions.
        schedule: What they were trained with.
        ap_3d: AP of Sedan at IoU 0.3 in per cent, in total and by weather; None where nothing is annotated.
        ap_bev: The same seen from above.
    """

    weights: str
    detector: str
    cloud: str
    parameters_m: float
    schedule: str
    ap_3d: dict[str, float | None]
    ap_bev: dict[str, float | None]


@cache
def figures() -> dict[str, Any]:
    """The recorded figures as they are stored; empty keys where nothing was recorded."""
    path = files("farfield.detectors") / "weights_data" / "figures.json"
    stored: dict[str, Any] = plain_json(path.read_bytes()) if path.is_file() else {"detectors": {}}
    return stored


def catalogue() -> list[CatalogueEntry]:
    """Every detector with what is recorded of it: ours, then those registered here and those of other packages."""
    recorded = figures()["detectors"]
    shipped = _bundled_names()
    entries = []
    for name in DETECTORS:
        origin, broken = DETECTORS.origin(name), DETECTORS.broken(name)
        record = recorded.get(name, {}) if origin == "farfield" else {}
        own = [record["weights"]] if record.get("weights") in shipped else []
        own += [weights for weights in shipped if weights.startswith(f"{name}-") and weights not in own]
        own = own if origin == "farfield" else []
        entries.append(
            CatalogueEntry(
                name=name,
                paper="" if broken else DETECTORS[name].paper,
                weights=own[0] if own else "",
                further=tuple(own[1:]),
                parameters=record.get("parameters"),
                frame_ms=record.get("frame_ms", {}),
                scores=record.get("scores", {}),
                shipped=record.get("shipped", {}).get("scores", {}),
                setting=record.get("setting", {}),
                origin=origin,
                broken=broken,
            )
        )
    return entries


def by_weather() -> list[WeatherScores]:
    """What the bundled weights for K-Radar's sensors reach in each weather; none where nothing was recorded."""
    recorded = figures().get("radar", {}).get("weights", {})
    shipped = _bundled_names()
    return [WeatherScores(weights=name, **record) for name, record in recorded.items() if name in shipped]


def _bundled_names() -> list[str]:
    folder = files("farfield.detectors") / "weights_data"
    names = (path.name for path in folder.iterdir())
    return sorted(name.removesuffix(".safetensors") for name in names if name.endswith(".safetensors"))
