"""The declared claims: every one is there, names what exists, and its published difference is the paper's."""

import hashlib
from pathlib import Path

import pytest

from farfield.errors import ConfigError, FarfieldError
from farfield.experiments.catalogue import shipped
from farfield.metrics import PROTOCOLS
from farfield.papers.claims import CLAIMS, Claims, load
from farfield.vocabulary.conditions import WEATHERS

# Differences of the papers' tables as they were written down by hand, DDS or AP3D: a second source to the tables.
PUBLISHED = {
    "C1": (0.077, 0.066, 0.071, 0.040),
    "C2": (0.136, 0.218, 0.141, 0.188),
    "C3": (0.010, 0.008, 0.006),
    "C4": (0.018,),
    "C5": (0.023,),
    "C6": (0.005, 0.003),
    "C7": (0.010,),
    "C8": (None,),
    "C9": (0.018,),
    "C10": (0.008, 0.010),
    "C11": (0.0005,),
    "C12": (None, None, 0.024),
    "C13": (0.018, 0.093),
    "C14": (0.025, 0.024),
    "C15": (0.017, 0.014),
    "K1": (0.073,),
    "K2": (0.020, 0.106, 0.188, 0.100, 0.148),
    "K3": (0.024, 0.043, 0.025),
    "K4": (0.212,),
    "K5": (0.0026,),
    "K6": (0.068, 0.087, None, None),
}
WEIGHTED = {"C4": 0.019, "C5": 0.016, "C7": 0.020, "C9": 0.029, "C11": -0.0006, "C12": 0.027}
SIXTEEN = 16


@pytest.fixture(params=CLAIMS)
def claims(request: pytest.FixtureRequest) -> Claims:
    return load(request.param)


def test_all_claims_are_declared() -> None:
    assert [claim.id for claim in load("cirrus")] == [f"C{number}" for number in range(16)]
    assert [claim.id for claim in load("kradar")] == [f"K{number}" for number in range(1, 8)]


@pytest.mark.parametrize("claim", [*PUBLISHED])
def test_published_differences_are_the_papers(claim: str) -> None:
    declared = load("cirrus" if claim.startswith("C") else "kradar")[claim]
    found = [pair.published(declared.metrics[0]) for pair in declared.comparisons]
    assert len(found) == len(PUBLISHED[claim])
    for value, expected in zip(found, PUBLISHED[claim], strict=True):
        assert (value is None) == (expected is None)
        if expected is not None:
            assert value == pytest.approx(expected, abs=6e-4)


@pytest.mark.parametrize(("claim", "expected"), WEIGHTED.items())
def test_published_differences_in_wdds(claim: str, expected: float) -> None:
    pair = load("cirrus")[claim].comparisons[-1]
    assert pair.published("wdds") == pytest.approx(expected, abs=6e-4)


def test_the_hash_is_that_of_the_files_bytes(claims: Claims, tmp_path: Path) -> None:
    data = claims.path.read_bytes()
    assert claims.sha256 == hashlib.sha256(data).hexdigest()
    changed = tmp_path / "changed.yaml"
    changed.write_bytes(data + b"# one more word\n")
    assert load(changed).sha256 != claims.sha256
    assert load(changed).document == claims.document


def test_figures_are_those_of_protocols_and_parts_are_known(claims: Claims) -> None:
    for metric in claims.metrics.values():
        assert not metric.protocol or metric.protocol in PROTOCOLS.names()
    ranges = {"overall", "near", "mid", "far", "0-200", "200-250"}
    known = ranges | {f"weather/{name}" for name in WEATHERS}
    pairs = [pair for claim in claims for pair in (*claim.comparisons, *claim.controls)]
    assert {part for pair in pairs for row in (pair.a, pair.b) for part in row.parts} <= known


def test_every_run_is_needed_and_the_laptops_grid_has_sixteen_and_controls(claims: Claims) -> None:
    needed = {run for claim in claims for run in claim.runs}
    assert needed == claims.runs.keys()
    if claims.paper == "cirrus":
        detectors = {"voxelnet", "second", "pointrcnn"}  # of the grid's own size only one is trained
        controls = {"range_twin", "range_density", "pattern_coin"}
        assert all(run.least_budget == "laptop" for run in claims.runs.values())
        rows = claims.runs.keys() - detectors - controls
        assert len(rows) + len({"device_a"}) == SIXTEEN  # the other device's detector is a run, no row


def test_a_rows_number_is_the_figure_of_its_part() -> None:
    claims = load("kradar")
    row = claims["K4"].comparisons[0].a
    assert str(row.scalar(claims.metrics["ap3d"])) == (
        "ap/vehicle/3d/0.3 (weather/normal) - ap/vehicle/3d/0.3 (weather/sleet)"
    )
    near = load("cirrus")["C1"].comparisons[1].a
    assert str(near.scalar(load("cirrus").metrics["wdds"], {"near": "0-64"})) == "dds/0.006/dds (0-64)"


def test_margins_become_hypotheses() -> None:
    claims = load("cirrus")
    eight, eleven = (claims[name].comparisons[0].hypothesis for name in ("C8", "C11"))
    assert (eight.kind, eight.margin) == ("not_below", 0.01)
    assert (eleven.kind, eleven.margin) == ("equivalent", 0.01)


def test_claims_are_not_listed_as_experiments() -> None:
    assert not {entry.path.parent.name for entry in shipped()} & {"claims"}


ONE = "  - {id: X, words: w, table: I, metrics: [dds], comparisons: [{a: {run: one}, b: {run: two}}]}\n"
GOOD = f"""
paper: cirrus
metrics: {{dds: {{words: DDS, protocol: dds, figure: dds/0/dds}}, points: {{words: points, statistic: points}}}}
runs: {{one: {{words: one}}, two: {{words: two}}}}
claims:
{ONE}"""


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("run: two", "run: three", "expected a run among one, two"),
        ("metrics: [dds]", "metrics: [map]", "expected a metric among dds, points"),
        ("metrics: [dds]", "metrics: [points]", "none for a statistic"),
        ("{run: two}", "{run: two, published: I gauss}", "expected a row among gaussian, uniform"),
        ("{run: two}", "{run: two, published: X gaussian}", "expected a table among I, II"),
        ("{run: two}", "{run: two, part: far, published: II second}", "has no part far"),
        ("{run: two}}", "{run: two}, kind: equivalent}", "more than 0"),
        ("{run: two}}", "{run: two}, sign: 1}", "no such key"),
        ("protocol: dds, figure: dds/0/dds", "protocol: dds", "a protocol with a figure"),
        (
            "claims:",
            "claims:\n  - {id: X, words: w, table: I, metrics: [dds], comparisons: [{a: {run: one}, b: {run: two}}]}",
            "each id once",
        ),
        ("paper: cirrus", "paper: [", "YAML"),
    ],
)
def test_what_cannot_be_decided_is_refused(tmp_path: Path, before: str, after: str, said: str) -> None:
    path = tmp_path / "claims.yaml"
    path.write_text(GOOD)
    assert load(path)["X"].comparisons[0].published("dds") is None
    path.write_text(GOOD.replace(before, after, 1))
    with pytest.raises(FarfieldError, match=said):
        load(path)


def test_absent_files_and_claims_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected one of cirrus, kradar"):
        load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="expected one of C0, C1"):
        load("cirrus")["K1"]
