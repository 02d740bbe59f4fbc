"""Bring the figures that `farfield detectors` lists in line with the results that README and docs quote: one source.

    python benchmarks/shipped_figures.py

Speeds come from results/detector_speed.txt, the shipped PointPillars' scores from results/simulated_detection.txt. The
scores of the radar experiments by weather come from results/radar_detectors_shipped.txt (``ship_radar_weights.py``) and
become the rows of these weights in docs/detectors.md too. Those of the equal budget stay as benchmarks/detectors.py
measured them.
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
RADAR_RESULTS = RESULTS / "radar_detectors_shipped.txt"
RADAR_WEIGHTS = ("rtnh-kradar-sim", "pointpillars-kradar-sim")
WEATHERS = ("total", "normal", "overcast", "fog", "rain", "sleet", "light_snow", "heavy_snow")
PAGE = ROOT / "docs" / "detectors.md"


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


def radar(text: str) -> dict[str, Any]:
    """AP by weather of the shipped radar experiments, from what radar_detectors.py printed."""
    lines = text.splitlines()
    data = re.search(r"^(\S+): (\d+) frames of (\d+) drives, fingerprint (\w+)$", text, re.MULTILINE)
    assert data is not None
    begin = lines.index("kradar: AP of Sedan at IoU 0.3, per cent")
    end = next(place for place in range(begin, len(lines)) if not lines[place])
    weights = {}
    for name in RADAR_WEIGHTS:
        rows = {
            words[1]: dict(zip(WEATHERS, (None if word == "-" else float(word) for word in words[2:]), strict=True))
            for words in (line.split() for line in lines[begin:end])
            if words[0] == name
        }
        about = next(line for line in lines[:begin] if line.startswith(f"{name} "))
        size = next(words for words in map(str.split, lines[end:]) if words[:1] == [name] and words[-1] == "M")
        weights[name] = {
            "detector": name.partition("-")[0],
            "cloud": re.sub(r".*, cloud ([\w-]+),.*", r"\1", about),
            "parameters_m": float(size[1]),
            "schedule": re.sub(r", reader .*", "", about.removeprefix(name).strip()),
            "ap_3d": rows["AP_3d"],
            "ap_bev": rows["AP_bev"],
        }
    return {
        "protocol": lines[end - 1],
        "data": f"{data[1]} ({data[4]}): {data[2]} frames of {data[3]} drives",
        "weights": weights,
    }


def in_page(text: str, known: dict[str, Any]) -> str:
    """The page with the rows of the shipped radar experiments as they were measured."""
    for name, measured in known["weights"].items():
        cells = [
            "-"
            if measured["ap_3d"][weather] is None
            else f"{measured['ap_3d'][weather]:.1f} ({measured['ap_bev'][weather]:.1f})"
            for weather in WEATHERS
        ]
        text = re.sub(rf"^\| `{name}` \|.*$", f"| `{name}` | {' | '.join(cells)} |", text, flags=re.MULTILINE)
    return text


def brought_in_line(figures: dict[str, Any]) -> dict[str, Any]:
    """The stored figures with today's speeds and the shipped weights' own scores."""
    measured = speeds()
    detectors = {
        name: {**known, "frame_ms": measured.get(name, known["frame_ms"])}
        for name, known in figures["detectors"].items()
    }
    detectors["pointpillars"]["shipped"] = {"scores": scores(), "budget": "2600 steps, the weights that ship"}
    known = {"radar": radar(RADAR_RESULTS.read_text("utf-8"))} if RADAR_RESULTS.is_file() else {}
    return {**figures, "detectors": detectors, **known}


def main() -> None:
    """Rewrite the stored figures, and the page's rows of the shipped radar experiments."""
    figures = brought_in_line(json.loads(FIGURES.read_text("utf-8")))
    FIGURES.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(f"written: {FIGURES.relative_to(ROOT)}")
    if "radar" in figures:
        PAGE.write_text(in_page(PAGE.read_text("utf-8"), figures["radar"]), encoding="utf-8")
        print(f"written: {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
