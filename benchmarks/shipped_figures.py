"""Bring the figures that `farfield detectors` lists in line with the results that README and docs quote: one source.

    python benchmarks/shipped_figures.py

Speeds come from results/detector_speed.txt, the shipped PointPillars' scores from results/simulated_detection.txt; the
scores of the equal budget stay as benchmarks/detectors.py measured them.
"""

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
FIGURES = ROOT / "src" / "farfield" / "detectors" / "weights_data" / "figures.json"
RANGES = ("0-70", "70-150", "150-250", "overall")
SHIPPED = "pointpillars-cirrus-sim"


def speeds() -> dict[str, dict[str, float]]:
    """Milliseconds a frame by detector and precision, of the networks in the pages' tables."""
    found: dict[str, dict[str, float]] = {}
    for line in (RESULTS / "detector_speed.txt").read_text("utf-8").splitlines():
        row = re.match(r"(\w+)-cirrus-sim-table\s+(bf16|fp32)\s+(\d+) ", line)
        if row:
            found.setdefault(row[1], {})[row[2]] = float(row[3])
    return found


def scores() -> dict[str, dict[str, dict[str, float]]]:
    """DDS and wDDS of the shipped PointPillars by cloud, range and epsilon."""
    lines = (RESULTS / "simulated_detection.txt").read_text("utf-8").splitlines()
    begin = next(place for place, line in enumerate(lines) if line.startswith(f"{SHIPPED}:"))
    found: dict[str, dict[str, dict[str, float]]] = {}
    for line in lines[begin + 1 :]:
        if not line.startswith(" "):
            break
        words = line.split()
        if words[0] in ("gaussian:", "uniform:"):
            found[words[0][:-1]] = rows = {}
        elif words[0] in RANGES:
            rows[words[0]] = dict(zip(("0", "0.003", "0.006", "0.009"), map(float, words[6:10]), strict=True))
    return found


def brought_in_line(figures: dict[str, Any]) -> dict[str, Any]:
    """The stored figures with today's speeds and the shipped weights' own scores."""
    measured = speeds()
    detectors = {
        name: {**known, "frame_ms": measured.get(name, known["frame_ms"])}
        for name, known in figures["detectors"].items()
    }
    detectors["pointpillars"]["shipped"] = {"scores": scores(), "budget": "2600 steps, the weights that ship"}
    return {**figures, "detectors": detectors}


def main() -> None:
    """Rewrite the stored figures."""
    stored = json.loads(FIGURES.read_text("utf-8"))
    FIGURES.write_text(json.dumps(brought_in_line(stored), indent=1) + "\n", encoding="utf-8")
    print(f"written: {FIGURES.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
