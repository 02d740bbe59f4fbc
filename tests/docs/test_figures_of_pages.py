"""The figures of README and docs are those that the benchmarks printed."""

import re
from functools import cache
from pathlib import Path

import pytest
import shipped_figures

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
SETTINGS = ROOT / "docs" / "experiments.md"  # its tables hold defaults, which a test of its own compares
CLAIMS = ROOT / "docs" / "claims.md"  # printed from the results by a tool, whose own test compares it
PAGES = [ROOT / "README.md", *sorted({*(ROOT / "docs").glob("*.md")} - {SETTINGS, CLAIMS})]
FIGURE = re.compile(r"(?<![\w.])0\.\d{3}(?!\d)")
PRINTED = re.compile(r"(?<![\w.])\d+\.\d{3,}(?!\d)")
ELSEWHERE = {
    "simulator.md": {"0.948", "0.563"},  # published figures, beside which ours stand
    "validation.md": {"0.427", "0.454"},  # of a slow test, test_patterns_train.py
    "metrics.md": {"0.003", "0.006", "0.009"},
    "adaptation.md": {"0.999"},  # a rate of averaging
}
SEVERAL = (  # rows whose cells come from several tables
    "Luminar ahead |", "Luminar back |", "KITTI, five vehicles |",
    "returns within 2 / 5 / 10", "the same, all returns", "12 | small detectors",
)  # fmt: skip
BINS = ("0-70", "70-150", "150-250", "overall")
SECTIONS = {
    "`cirrus-sim-val-v2`, Gaussian": ("simulated", "pointpillars-cirrus-sim:", "gaussian"),
    "`cirrus-sim-val-v2`, uniform": ("simulated", "pointpillars-cirrus-sim:", "uniform"),
    "first simulator's `cirrus-sim-val-v1`, Gaussian": (
        "simulated, on v1",
        "pointpillars-cirrus-sim:",
        "gaussian",
    ),
    "first simulator's `cirrus-sim-val-v1`, uniform": (
        "simulated, on v1",
        "pointpillars-cirrus-sim:",
        "uniform",
    ),
    "real Luminar, three": ("real", "Luminar, as they are", ""),
    "real Luminar, the same": ("real", "Luminar, turned", ""),
    "real KITTI, three": ("real", "KITTI, front", ""),
    "real KITTI, 14": ("real", "KITTI, further", ""),
}


def rounded(text: str) -> set[str]:
    """A figure to three decimals, both ways where it lies in the middle between two."""
    value = float(text)
    return {f"{value - 1e-9:.3f}", f"{value + 1e-9:.3f}"}


def section(name: str, title: str, inner: str) -> list[str]:
    """The lines of a section of detectors.txt from a title on, and from an inner title on below it."""
    text = (RESULTS / "detectors.txt").read_text(encoding="utf-8").partition(f"==== {name}\n")[2]
    lines = text.partition("\n==== ")[0].splitlines()
    start = next(place for place, line in enumerate(lines) if line.startswith(title))
    return lines[start:] if not inner else lines[next(p for p in range(start, len(lines)) if inner in lines[p][:12]) :]


def by_range(
    name: str, title: str, inner: str, weights: str
) -> tuple[list[str | None], list[str | None], tuple[str, str]]:
    """DDS and wDDS 0.006 by range and overall, and the interval of DDS overall, as a results file has them."""
    lines = section(name, title, inner)
    if not inner:  # one line a detector
        cells = next(line for line in lines if f"{weights} " in line).split()[5:]
        values = [None if cell == "-" else cell for cell in cells]
        return values[:4], values[4:8], (cells[8].strip("[],"), cells[9].strip("[],"))
    rows = {part: next(line for line in lines if line.split()[:1] == [part]).split()[1:] for part in BINS}
    low, high = (cell.strip("[],") for cell in rows["overall"][-2:])
    return [rows[part][5] for part in BINS], [rows[part][7] for part in BINS], (low, high)


def rows_of(page: str) -> list[list[str]]:
    lines = (ROOT / page).read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]


@pytest.mark.parametrize("page", ["README.md", "docs/detectors.md"])
@pytest.mark.parametrize("title", SECTIONS)
def test_scores_by_range_are_those_of_the_results(page: str, title: str) -> None:
    weights = "pointpillars-roads" if page == "README.md" else "pointpillars-cirrus-sim"
    scores, weighted, interval = by_range(*SECTIONS[title], weights)
    found = [row for row in rows_of(page) if row[0].startswith(title)]
    assert found or (page == "README.md" and ("v1" in title or title == "real KITTI, three"))
    for row in found:
        for cell, score, wide in zip(row[1:5], scores, weighted, strict=True):
            if score is None:
                assert cell == "nothing annotated"
                continue
            figures = FIGURE.findall(cell)
            assert figures[0] in rounded(score), (row[0], cell, score)
            assert figures[1] in rounded(str(wide)), (row[0], cell, wide)
            assert tuple(figures[2:]) in ((), interval), (row[0], cell, interval)
    if page == "README.md" and found:
        assert FIGURE.findall(found[0][4])[2:] == list(interval)


@pytest.mark.parametrize(
    ("title", "number"), [("real Luminar, three", 284), ("real KITTI, three", 5), ("real KITTI, 14", 58)]
)
def test_real_rows_name_their_number_of_objects(title: str, number: int) -> None:
    name, head, _ = SECTIONS[title]
    assert f"{number} annotated of class vehicle" in section(name, head, "")[0]
    for row in (
        row for page in ("README.md", "docs/detectors.md") for row in rows_of(page) if row[0].startswith(title)
    ):
        assert f"{ {5: 'five'}.get(number, number) } vehicles" in row[0]


def test_readmes_table_of_real_frames_is_what_its_command_writes() -> None:
    """And a changed figure, number of objects or word on training in the results is noticed."""
    readme, printed = (ROOT / "README.md").read_text("utf-8"), shipped_figures.section("detectors", "real")
    assert shipped_figures.with_real_rows(readme, printed) == readme
    for old, new in (
        ("0.6974", "0.9974"),
        ("0.682] of 36", "0.682] of 37"),
        ("0.582] of", "0.682] of"),
        ("nothing: simulated frames, Open", "all 3 frames: simulated frames, Open"),
    ):
        assert old in printed
        assert shipped_figures.with_real_rows(readme, printed.replace(old, new, 1)) != readme
    with pytest.raises(SystemExit, match="expected one place"):
        shipped_figures.with_real_rows("no table", printed)


@cache
def blocks() -> frozenset[frozenset[str]]:
    """The figures of every four lines that stand together in a results file, to three decimals."""
    found = set()
    for path in RESULTS.glob("*.txt"):
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [{each for text in PRINTED.findall(line) for each in rounded(text)} for line in lines]
        found |= {frozenset().union(*rows[start : start + 4]) for start in range(max(1, len(rows) - 3))}
    return frozenset(found)


def strange(cells: str, elsewhere: set[str], *, several: bool = False) -> set[str]:
    """Figures of a row that no results file has: together in one block of lines, or, of several tables, anywhere."""
    figures = {*FIGURE.findall(cells)} - elsewhere
    near = frozenset().union(*blocks()) if several else max(blocks(), key=lambda block: len(block & figures))
    return figures - near


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_row_of_a_table_was_printed_as_one(page: Path) -> None:
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            row = line.strip("| ")
            several = row.startswith((*SECTIONS, *SEVERAL))
            assert strange(line, ELSEWHERE.get(page.name, set()), several=several) == set(), row


def test_a_stale_row_and_a_wrong_figure_are_noticed() -> None:
    """The row of KITTI that stood here when its script printed 0.4063 and 0.173; and a digit changed anywhere."""
    assert strange("0.316 (0.319) | nothing annotated | 0.297 (0.300) | 0.294 | 0.191", set())
    rows = [line for line in PAGES[0].read_text(encoding="utf-8").splitlines() if len(FIGURE.findall(line)) > 3]
    assert len(rows) > 3
    for row in rows:
        first = FIGURE.findall(row)[0]
        assert strange(row.replace(first, "0.999"), set())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_figure_of_a_text_was_printed(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith("|")]
    assert strange(" ".join(lines), ELSEWHERE.get(page.name, set()), several=True) == set()


@pytest.mark.parametrize("page", ["README.md", "docs/detectors.md"])
def test_real_rows_say_how_far_they_carry(page: str) -> None:
    """Three sweeps of one scene are not three frames: 284 boxes are about 95 objects."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert any(row[0].startswith("real Luminar") for row in rows_of(page))
    assert "one scene, three sweeps a tenth of a second apart" in text
    assert f"about {round(284 / 3)} objects" in text
    assert f"{1.96 * (0.25 / (284 / 3)) ** 0.5:.2f}" == "0.10"
