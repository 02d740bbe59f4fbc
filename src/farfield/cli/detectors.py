"""``farfield detectors``."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from farfield.cli._output import check_outputs, console, write_json
from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.detectors.catalogue import CatalogueEntry, WeatherScores

_RANGES = ("0-70", "70-150", "150-250", "overall")


def run(
    *,
    cloud: Literal["gaussian", "uniform"] = "gaussian",
    epsilon: str = "0.006",
    measure: bool = False,
    json: Annotated[Path | None, tyro.conf.arg(aliases=["--json-out"])] = None,
) -> int:
    """List the detectors with their size, speed and score.

    examples:
      farfield detectors
      farfield detectors --cloud uniform --epsilon 0
      farfield detectors --measure

    Speed and score are records of this version, on the machine and the frozen split named below the table; --measure
    times the bundled weights to 250 m on this machine instead, on simulated frames. A second table has the weights for
    K-Radar's sensors, with AP by weather.

    Args:
        cloud: The scan pattern of the scores.
        epsilon: Weight of wDDS: 0 (DDS), 0.003, 0.006 or 0.009.
        measure: Time the bundled weights here.
        json: Also write everything as JSON into this file; - prints it too.
    """
    from rich.table import Table

    from farfield.detectors.catalogue import by_weather, catalogue, figures

    if epsilon not in ("0", "0.003", "0.006", "0.009"):
        raise ConfigError(f"--epsilon: expected one of 0, 0.003, 0.006, 0.009; got {epsilon!r}")
    check_outputs((), files={"--json": json})
    entries = catalogue()
    speeds = {entry.name: _measure(entry) if measure else _recorded(entry) for entry in entries}
    table = Table(box=None, pad_edge=False)
    metric = "DDS" if epsilon == "0" else f"wDDS {epsilon}"
    for column in ("detector", "from", "weights", "parameters", "ms a frame", *(f"{metric}\n{r} m" for r in _RANGES)):
        table.add_column(column.replace("overall m", "overall"), justify="left" if column in ("detector",) else "right")
    for entry in entries:
        paper = "cannot be used" if entry.broken else entry.paper or "-"
        scores = entry.shipped or entry.scores
        table.add_row(entry.name, paper, entry.weights or "-", *_row(entry, speeds[entry.name], scores, cloud, epsilon))
        if entry.shipped:
            table.add_row("", "with the equal budget", "-", *_row(entry, "", entry.scores, cloud, epsilon))
    console(width=160).print(table)
    for entry in entries:
        if entry.broken:
            print(f"\n{entry.broken}")
        elif entry.origin != "farfield":
            print(f"\n{entry.name}: of {entry.origin}")
    record = figures()
    if record.get("split"):
        print(
            f"\nscores: {record['split']} ({record['sha256'][:12]}), {cloud} clouds, on simulation; equal budget: "
            f"{record['budget']}; a row with a second one below has the scores of the weights that ship\n"
            + ("" if measure else f"speed: {record['points']}, {record['machine']}, {record['precision']}\n")
            + f"recorded {record['date']} at commit {record['commit']}"
        )
    _print_weathers(by_weather(), record.get("radar", {}))
    print("\ntrain one: farfield train NAME-cirrus-sim, for radar NAME*-kradar-sim; farfield experiments lists them")
    print("use one: farfield predict WEIGHTS DATA")
    if json is not None:
        write_json(json, {**record, "detectors": [asdict(entry) for entry in entries]})
    return 0


def _print_weathers(rows: "list[WeatherScores]", about: Mapping[str, Any]) -> None:
    """The weights for K-Radar's sensors, a column a weather."""
    from rich.table import Table

    if not rows:
        return
    table = Table(box=None, pad_edge=False)
    weathers = list(rows[0].ap_3d)
    for column in ("weights", "reads", "parameters", *(f"AP_3d\n{name.replace('_', ' ')}" for name in weathers)):
        table.add_column(column, justify="left" if column == "weights" else "right")
    for row in rows:
        cells = ("-" if value is None else f"{value:.1f}" for value in row.ap_3d.values())
        table.add_row(row.weights, row.cloud, f"{row.parameters_m:.2f} M", *cells)
    print()
    console(width=160).print(table)
    print(f"\nAP_3d of Sedan at IoU 0.3, per cent, protocol kradar; {about['data']}, on simulation, not trained on")
    for row in rows:
        print(f"{row.weights}: {row.schedule}")
    print("see them at work: farfield demo --radar")


def _row(entry: "CatalogueEntry", speed: str, by_cloud: Mapping[str, Any], cloud: str, epsilon: str) -> list[str]:
    scores = by_cloud.get(cloud, {})
    values = [scores.get(name, {}).get(epsilon) for name in _RANGES]
    size = "-" if entry.parameters is None else f"{entry.parameters / 1e6:.2f} M"
    return [size, speed, *("-" if value is None else f"{value:.3f}" for value in values)]


def _recorded(entry: "CatalogueEntry") -> str:
    return " / ".join(f"{entry.frame_ms[name]:.0f} {name}" for name in sorted(entry.frame_ms)) or "-"


def _measure(entry: "CatalogueEntry") -> str:
    """Median time of a few simulated frames through the bundled weights, milliseconds."""
    import time

    import numpy as np

    from farfield.api import load_detector
    from farfield.simulation import simulate_sequence

    if not entry.weights.endswith("-cirrus-sim"):
        return "-"
    detector = load_detector(entry.weights)
    clouds = [frame.cloud() for frame in simulate_sequence("cirrus-sim", seed=1, sequence=0, frames=2)]
    taken = []
    for index in range(10):
        began = time.perf_counter()
        detector(clouds[index % len(clouds)])
        taken.append(1e3 * (time.perf_counter() - began))
    return f"{np.median(taken[2:]):.0f} {detector.precision}"
