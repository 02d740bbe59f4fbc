"""Ship weights of the radar experiments, and bring the figures that the package and the pages list in line with them.

    python tools/shipped_figures.py figures
    python tools/shipped_figures.py real [REAL] [--printed]
    python tools/shipped_figures.py roads RUN
    python tools/shipped_figures.py weights [RTNH_RUN POINTPILLARS_RUN] [--weights-only]
                                            [--drives N] [--frames N] [--workers N]

``figures`` has one source for what `farfield detectors`, README and docs say: speeds come from the section ``lidar`` of
results/detector_speed.txt, the shipped PointPillars' scores from ``simulated`` of results/detectors.txt, the scores of
the radar experiments by weather from ``shipped`` of results/radar_detectors.txt; these become the rows of these weights
in docs/detectors.md too. Those of the equal budget stay as ``detectors.py budget`` measured them.

``real`` makes README's table of real frames anew: it runs ``detectors.py real`` on the frames of REAL (with
``--printed``, takes what that printed last) and writes a row for each set of frames: scores by range, objects scored,
scenes, and what of the frames was seen in training.

``roads`` writes the weights of RUN, a folder that ``make train-roads`` leaves, into weights_data as
``pointpillars-roads``, in float16 and without folders of a machine.

``weights``: a RUN is the folder of a finished training: ``farfield train rtnh-kradar-sim`` and
``pointpillars-kradar-sim`` with ``-o training.steps=1500 -o data.simulate.frames=4`` make the shipped ones. In this
order it

1. writes both files in float16 into src/farfield/detectors/weights_data, their provenance without folders of a machine;
2. scores what was written, as it will be loaded, on drives of seed 13 (``radar_detectors.py weathers``; the drives are
   simulated into data/kradar-sim-shipped unless they are there);
3. brings the figures in line with it;
4. runs ``farfield demo --radar`` and puts its picture into docs/images/radar_demo.jpg.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.detectors.weights import load_weights, resolve_weights, save_weights

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
FIGURES = ROOT / "src" / "farfield" / "detectors" / "weights_data" / "figures.json"
RANGES = ("0-70", "70-150", "150-250", "overall")
SHIPPED = "pointpillars-cirrus-sim"
ON_ROADS = "pointpillars-roads"
"""The weights of README's table of real frames."""
RADAR_WEIGHTS = ("rtnh-kradar-sim", "pointpillars-kradar-sim")
WEATHERS = ("total", "normal", "overcast", "fog", "rain", "sleet", "light_snow", "heavy_snow")
PAGE = ROOT / "docs" / "detectors.md"


def speeds() -> dict[str, dict[str, float]]:
    """Milliseconds a frame by detector and precision, of the networks in the pages' tables."""
    found: dict[str, dict[str, float]] = {}
    for line in section("detector_speed", "lidar").splitlines():
        row = re.match(r"(\w+)-cirrus-sim-table\s+(bf16|fp32)\s+(\d+) ", line)
        if row:
            found.setdefault(row[1], {})[row[2]] = float(row[3])
    return found


def scores() -> dict[str, dict[str, dict[str, float]]]:
    """DDS and wDDS of the shipped PointPillars by cloud, range and epsilon."""
    lines = section("detectors", "simulated").splitlines()
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
    return {**figures, "detectors": detectors, "radar": radar(section("radar_detectors", "shipped"))}


def section(script: str, name: str) -> str:
    """A section of what a benchmark printed."""
    text = (RESULTS / f"{script}.txt").read_text("utf-8")
    return re.split(r"^==== ", text.partition(f"==== {name}\n")[2], maxsplit=1, flags=re.MULTILINE)[0]


def list_figures() -> None:
    """Rewrite the stored figures, and the page's rows of the shipped radar experiments."""
    figures = brought_in_line(json.loads(FIGURES.read_text("utf-8")))
    FIGURES.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(f"written: {FIGURES.relative_to(ROOT)}")
    PAGE.write_text(in_page(PAGE.read_text("utf-8"), figures["radar"]), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")


README = ROOT / "README.md"
REAL_TABLE = re.compile(r"(?<=^\| real frames \|).*?(?=^\n)", flags=re.DOTALL | re.MULTILINE)
OVER_OBJECTS = re.compile(r"(?<=^Drawing objects for frames widens ).*$", flags=re.MULTILINE)
REAL_HEADS = (*RANGES, "objects scored", "scenes", "seen in training")
REAL_ROWS = {
    "Luminar, as they are": "real Luminar, three frames, looking ahead, {count} vehicles",
    "Luminar, turned by 180 degrees": "real Luminar, the same three, looking back, {count} vehicles",
    "KITTI, front camera's view": "real KITTI, three frames, {count} vehicles",
    "KITTI, further frames, front camera's view": "real KITTI, 14 further frames, {count} vehicles",
}
WORDS = {5: "five"}


@dataclass(frozen=True, kw_only=True)
class RealScores:
    """What the benchmark printed of the detector for real roads on one set of real frames."""

    vehicles: int
    scenes: str
    seen: str
    dds: tuple[str, ...]
    wdds: tuple[str, ...]
    over_frames: str
    over_objects: str
    objects: str

    @classmethod
    def of(cls, text: str, title: str) -> "RealScores":
        """The lines below a set's title; all vehicles count, hidden ones too."""
        own = text[text.index(f"\n{title}: ") :]
        row = re.search(rf"^  {ON_ROADS} .*$", own, flags=re.MULTILINE)[0]
        intervals = [*re.findall(r"\[0\.\d+, 0\.\d+\]", row), "", ""]
        cells = row.split()[5:13]  # after the name and four average precisions
        return cls(
            vehicles=int(re.search(r"(\d+) annotated", own)[1]),
            scenes=re.search(r"^ scenes: (.*)$", own, flags=re.MULTILINE)[1],
            seen=re.search(rf"^ seen in training, {ON_ROADS}: (.*)$", own, flags=re.MULTILINE)[1],
            dds=tuple(cells[:4]),
            wdds=tuple(cells[4:]),
            over_frames=intervals[0],
            over_objects=intervals[1],
            objects=row.rpartition(" of ")[2] if intervals[1] else "1",
        )

    def row(self, name: str) -> str:
        """The row of README's table."""
        cells = [
            "nothing annotated" if score == "-" else f"{float(score):.3f} ({float(wide):.3f})"
            for score, wide in zip(self.dds, self.wdds, strict=True)
        ]
        cells[-1] += f", {self.over_frames}" if self.over_frames else ""
        name = name.format(count=WORDS.get(self.vehicles, self.vehicles))
        return f"| {' | '.join([name, *cells, self.objects, self.scenes, self.seen])} |"


def with_real_rows(readme: str, text: str) -> str:
    """README with the table of real frames that a benchmark printed, and what its intervals become over objects."""
    scores = {title: RealScores.of(text, title) for title in REAL_ROWS}
    rows = [f" {' | '.join(REAL_HEADS)} |", "|" + "---|" * (len(REAL_HEADS) + 1)]
    table = "\n".join([*rows, *(scores[title].row(name) for title, name in REAL_ROWS.items())]) + "\n"
    ahead, back = (f"{float(one.dds[-1]):.3f} to {one.over_objects}" for one in list(scores.values())[:2])
    for pattern, written in ((REAL_TABLE, table), (OVER_OBJECTS, f"{ahead} and {back}.")):
        readme, count = pattern.subn(lambda _, new=written: new, readme)
        if count != 1:
            raise SystemExit(f"README.md: expected one place of {pattern.pattern!r}, found {count}")
    return readme


def list_real(real: Path | None, *, printed: bool) -> None:
    """Run the benchmark of real frames unless it was, and rewrite README's table."""
    if not printed:
        script = [sys.executable, "benchmarks/detectors.py", "real", *([] if real is None else [str(real)])]
        subprocess.run(script, cwd=ROOT, check=True)
    README.write_text(with_real_rows(README.read_text("utf-8"), section("detectors", "real")), encoding="utf-8")
    print(f"written: {README.relative_to(ROOT)}")


PICTURE = ROOT / "docs" / "images" / "radar_demo.jpg"
SCORED = "kradar-sim-shipped"


def without_machine(provenance: dict[str, Any]) -> dict[str, Any]:
    """The provenance without folders of a machine: data in ``data/NAME``, other files by their names."""
    portable = deepcopy(provenance)
    experiment = portable["experiment"]
    data, training = experiment["data"], experiment.get("training", {})
    for stream in [data] if "path" in data else data.values():
        if not stream.get("donors"):  # donors are named, they lie in no folder
            stream["path"] = f"data/{Path(stream['path']).name}"
    if training.get("negatives"):
        training["negatives"] = Path(training["negatives"]).name
    for start in (training.get("start"), portable.get("start")):
        if start and start.get("weights"):
            start["weights"] = "/".join(Path(start["weights"]).parts[-2:])  # stage and file
    return portable


def ship(run: str | Path, name: str, folder: Path = FIGURES.parent, *, scored: str = "") -> Path:
    """Write the weights of a run in float16 under a name, with the data that scored them; return the file."""
    network, provenance = load_weights(resolve_weights(run))
    trained = provenance["experiment"]["detector"]["name"]
    if not name.startswith(f"{trained}-"):
        raise SystemExit(f"{run}: expected a run of {name.partition('-')[0]}, got {trained}")
    target = folder / f"{name}.safetensors"
    state, config = network.state_dict(), network.config
    record = without_machine(provenance) | ({"scored": scored} if scored else {})
    save_weights(target, state, config=config, provenance=record, half=True)
    return target


def ship_weights(options: argparse.Namespace) -> None:
    """Write both files, score them, bring the figures in line, draw the demonstration's picture."""
    for run, name in zip(options.runs, RADAR_WEIGHTS, strict=True):
        path = ship(run, name, scored=SCORED)
        print(f"written: {path.relative_to(ROOT)}, {path.stat().st_size:,} bytes", flush=True)
    if options.weights_only:
        return
    scoring = ["--runs", *RADAR_WEIGHTS, "--against", *RADAR_WEIGHTS, "--into", SCORED, "--section", "shipped"]
    scoring += [f"--{name}={getattr(options, name)}" for name in ("drives", "frames", "workers")]
    subprocess.run([sys.executable, "benchmarks/radar_detectors.py", "weathers", *scoring], cwd=ROOT, check=True)
    list_figures()
    demo = ROOT / "runs" / "radar-demo"
    subprocess.run([sys.executable, "-m", "farfield.cli", "demo", "--radar", "--out", str(demo)], cwd=ROOT, check=True)
    shutil.copyfile(demo / "radar-evaluation" / "weathers.jpg", PICTURE)
    print(f"written: {PICTURE.relative_to(ROOT)}, {PICTURE.stat().st_size:,} bytes")


def main() -> None:
    """Do what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("figures")
    real = verbs.add_parser("real")
    real.add_argument("real", nargs="?", type=Path, help="folder of real frames; shared/real beside the project")
    real.add_argument("--printed", action="store_true", help="take what the benchmark printed last")
    roads = verbs.add_parser("roads")
    roads.add_argument("run", help="a finished training for real roads: its folder or its weights")
    weights = verbs.add_parser("weights")
    weights.add_argument("runs", nargs="*", default=[f"runs/{name}" for name in RADAR_WEIGHTS])
    weights.add_argument("--weights-only", action="store_true", help="write the two files and do no more")
    weights.add_argument("--drives", type=int, default=116)
    weights.add_argument("--frames", type=int, default=348, help="of all drives together")
    weights.add_argument("--workers", type=int, default=0)
    options = parser.parse_args()
    if options.verb == "figures":
        list_figures()
        return
    if options.verb == "real":
        list_real(options.real, printed=options.printed)
        return
    if options.verb == "roads":
        path = ship(options.run, ON_ROADS)
        print(f"written: {path.relative_to(ROOT)}, {path.stat().st_size:,} bytes")
        return
    if len(options.runs) != len(RADAR_WEIGHTS):
        parser.error(f"expected a run for each of {', '.join(RADAR_WEIGHTS)}, got {len(options.runs)}")
    ship_weights(options)


if __name__ == "__main__":
    main()
