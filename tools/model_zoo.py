"""Write docs/model-zoo.md: every detector's weights that ship, with card, scores, speed and licence.

python tools/model_zoo.py            print the page
python tools/model_zoo.py --write    write it

Nothing is measured here: the cards are what the weights files record, scores and speeds those of
``weights_data/figures.json`` and of ``benchmarks/results``. Weights without a record get a card that says so.
"""

import json
import re
import struct
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from farfield.detectors.catalogue import CatalogueEntry, WeatherScores, by_weather, catalogue, figures
from farfield.detectors.info import open_places

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "model-zoo.md"
RESULTS = ROOT / "benchmarks" / "results"
WEIGHTS = files("farfield.detectors") / "weights_data"
RANGES = ("0-70", "70-150", "150-250", "overall")
REAL = {
    "Luminar, as they are": "real Luminar, ahead",
    "Luminar, turned by 180 degrees": "real Luminar, behind",
    "KITTI, front camera's view": "real KITTI, 3 frames",
    "KITTI, further frames, front camera's view": "real KITTI, 14 further frames",
}
HEAD = """# Model zoo

Printed by `tools/model_zoo.py` from the weights files, from what `farfield detectors` shows, and from the results that
the benchmarks printed; nothing is measured for this page.
[Detectors](detectors.md) has the networks, longer tables and how far the figures carry.

All weights and the code that runs them are Apache-2.0, and no licence of a data set is attached to them: they learnt
from simulated frames and, where their card names places, from [Open Sweeps](open-sweeps.md). **Scores on simulated
frames are no forecast for a real road**: the rows of real frames are few, and say so.

```bash
farfield predict NAME my-sweeps --out boxes.csv       # use one
farfield evaluate NAME my-sweeps                      # how good it is on yours
farfield train EXPERIMENT                             # train one yourself: farfield experiments lists them
```
"""


def header(name: str) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Configuration, provenance and size in bytes of bundled weights, without loading them."""
    path = WEIGHTS / f"{name}.safetensors"
    with path.open("rb") as stream:
        (length,) = struct.unpack("<Q", stream.read(8))
        record = json.loads(stream.read(length))["__metadata__"]
    return json.loads(record["config"]), json.loads(record["provenance"]), Path(str(path)).stat().st_size


def streams_of(provenance: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The data that an experiment learnt from, one entry a stream."""
    data = provenance.get("experiment", {}).get("data", {})
    return [data] if "path" in data else [stream for stream in data.values() if isinstance(stream, Mapping)]


def learnt_from(provenance: Mapping[str, Any]) -> str:
    """Where the frames of a training came from, and how many there were."""
    sources = []
    for stream in streams_of(provenance):
        made = stream.get("simulate") or {}
        donors = stream.get("donors") or {}
        if made:
            drives, frames = int(made["sequences"]), int(made["frames"])
            sources.append(f"{drives * frames:,} frames of {drives} drives of `{made['preset']}`")
        elif donors:
            sources.append(
                f"`{Path(str(stream['path'])).name}` with simulated road users, {donors['copies']} copies a sweep"
            )
        else:
            sources.append(f"`{Path(str(stream.get('path', 'not recorded'))).name}`")
    return "; ".join(sources) or "not recorded"


def schedule(provenance: Mapping[str, Any]) -> str:
    """Steps and batch of a training, and that it went on from other weights."""
    training = provenance.get("experiment", {}).get("training", {})
    steps, batch = training.get("steps"), training.get("batch_size")
    after = " after an earlier training" if provenance.get("start") else ""
    return f"{steps:,} steps of {batch} frames{after}" if steps and batch else "not recorded"


def classes_of(config: Mapping[str, Any]) -> str:
    """The classes that a configuration's detector tells apart."""
    return (
        ", ".join(f"`{name}`" for name in config.get("classes") or config.get("anchors") or config.get("sizes_m") or ())
        or "not recorded"
    )


def reach_of(config: Mapping[str, Any]) -> str:
    """How far ahead and to the sides a configuration's detector looks."""
    grid = config.get("grid") or config.get("window") or {}
    if "range_m" not in grid:
        return "not recorded"
    return f"{grid['range_m']:g} m ahead, {grid['half_width_m']:g} m to each side"


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (columns, ["---"] * len(columns), *rows))


def two_digits(value: float | str | None) -> str:
    """A score with as many digits as its interval allows, or a dash."""
    return "-" if value in (None, "-") else f"{float(value):.2f}"


def section(script: str, name: str) -> str:
    """A section of what a benchmark printed; empty where there is none."""
    path = RESULTS / f"{script}.txt"
    text = path.read_text("utf-8") if path.is_file() else ""
    return re.split(r"^==== ", text.partition(f"==== {name}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]


def real_scores() -> dict[str, dict[str, list[str]]]:
    """DDS by range on real frames: by title of the frames, by weights."""
    scores: dict[str, dict[str, list[str]]] = {title: {} for title in REAL}
    for text in (section("detectors", "real"), section("detectors", "real, all detectors")):
        for title, rows in scores.items():
            own = text.partition(f"\n{title}: ")[2].partition(" with 5 points")[0]
            for line in own.splitlines():
                name, *cells = line.split() or [""]
                if len(cells) >= 8 and re.fullmatch(r"[01]\.\d+", cells[0]):
                    rows.setdefault(name, cells[4:8])
    return scores


def open_scores() -> dict[str, list[list[str]]]:
    """AP on Open Sweeps by weights: place, number of objects, AP and interval."""
    rows: dict[str, list[list[str]]] = {}
    pattern = r"^ (\S+) +(all|\w+) +\d+ +(\d+) +(\d\.\d+) \[(\d\.\d+), (\d\.\d+)\]"
    for name, place, objects, score, low, high in re.findall(pattern, section("open_sweeps", "scores"), re.MULTILINE):
        interval = f"{two_digits(score)} [{two_digits(low)}, {two_digits(high)}]"
        rows.setdefault(name, []).append([f"Open Sweeps, {place}", objects, interval])
    return rows


def by_range(entry: CatalogueEntry, name: str) -> list[list[str]]:
    """Rows of DDS and wDDS 0.006 on the frozen split of simulated frames, for the weights of the record."""
    if name != figures()["detectors"].get(entry.name, {}).get("weights"):
        return []
    scores = entry.shipped or entry.scores
    return [
        [
            f"simulated, {cloud} pattern",
            *(f"{two_digits(by[part].get('0'))} ({two_digits(by[part].get('0.006'))})" for part in RANGES),
        ]
        for cloud, by in scores.items()
    ]


def card(entry: CatalogueEntry, name: str, weathers: Mapping[str, WeatherScores]) -> str:
    """The section of one weights file."""
    config, provenance, size = header(name)
    weather = weathers.get(name)
    recorded = name == figures()["detectors"].get(entry.name, {}).get("weights")
    parameters = entry.parameters if recorded else (weather.parameters_m * 1e6 if weather else None)
    speed = " / ".join(f"{entry.frame_ms[kind]:.0f} ms {kind}" for kind in sorted(entry.frame_ms)) if recorded else ""
    clouds = dict.fromkeys(str(cloud) for stream in streams_of(provenance) for cloud in stream.get("clouds", ()))
    places = open_places(provenance)
    named = "not recorded" if places is None else ", ".join(places) or "none"
    weight = "not recorded" if parameters is None else f"{parameters / 1e6:.2f} M parameters"
    lines = [
        f"**Detector**: `{entry.name}` ({entry.paper}).",
        f"**Reads**: clouds such as {', '.join(f'`{cloud}`' for cloud in clouds) or 'not recorded'}.",
        f"**Detects**: {classes_of(config)}, {reach_of(config)}.",
        f"**Size**: {weight}, {size / 1e6:.1f} MB.",
        f"**Learnt from**: {learnt_from(provenance)}; {schedule(provenance)}; real places: {named}.",
        f"**Thresholds**: score {config.get('score_threshold', '-')}, suppression {config.get('nms_iou', '-')}, "
        f"{config.get('max_boxes', '-')} boxes a frame.",
        f"**Speed**: {speed or 'not recorded'}"
        + (f" ({figures()['points']}; {figures()['machine']})." if speed else "."),
        "**Licence**: Apache-2.0.",
    ]
    parts = [f"## {name}", "\n".join(f"- {line}" for line in lines)]
    rows = by_range(entry, name)
    rows += [
        [f"{title}, DDS", *map(two_digits, scores[name])]
        for source, title in REAL.items()
        if name in (scores := real_scores()[source])
    ]
    if rows:
        parts.append("DDS of vehicles by range in metres, in brackets wDDS with epsilon 0.006:")
        parts.append(table(["frames", *RANGES], rows))
    if rows_of_places := open_scores().get(name):
        parts.append(
            "AP at 2 m of vehicles within 70 m, protocol `open-sweeps`, with the 95 % interval over drawn objects:"
        )
        parts.append(table(["frames", "objects", "AP"], rows_of_places))
    if weather:
        about = figures().get("radar", {}).get("data", "")
        parts.append(f"AP in per cent of Sedan at IoU 0.3, protocol `kradar`; {about}, simulated, not trained on:")
        heads = ["", *(kind.replace("_", " ") for kind in weather.ap_3d)]
        cells = (("3D", weather.ap_3d), ("bird's eye", weather.ap_bev))
        lines_of = ([head, *("-" if v is None else f"{v:.1f}" for v in row.values())] for head, row in cells)
        parts.append(table(heads, lines_of))
    if not rows and not rows_of_places and not weather:
        parts.append("No score of these weights is recorded.")
    return "\n\n".join(parts)


def page() -> str:
    """The whole page: weights in the order of the catalogue; detectors of other packages are left out."""
    weathers = {row.weights: row for row in by_weather()}
    own = [entry for entry in catalogue() if entry.origin == "farfield"]
    named = [(entry, name) for entry in own for name in (entry.weights, *entry.further) if name]
    rows = [[f"[`{name}`](#{name})", entry.name, entry.paper, schedule(header(name)[1])] for entry, name in named]
    bare = [entry.name for entry in own if not entry.weights]
    parts = [HEAD.rstrip(), table(["weights", "detector", "paper", "trained"], rows)]
    if bare:
        parts.append(f"Without weights, to be trained: {', '.join(f'`{name}`' for name in bare)}.")
    return "\n\n".join([*parts, *(card(entry, name, weathers) for entry, name in named)]) + "\n"


def main() -> None:
    """Print the page, or write it."""
    if "--write" not in sys.argv[1:]:
        print(page(), end="")
        return
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
