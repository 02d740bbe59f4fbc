"""Doors for other packages: the examples, as installed beside Farfield, and packages that are broken."""

import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

import farfield as ff
from farfield.cli import main
from farfield.datasets import DATASETS
from farfield.detectors import DETECTORS
from farfield.errors import ConfigError, DatasetError
from farfield.files.boxes_csv import BoxRows, write_boxes_csv
from farfield.metrics import PROTOCOLS
from farfield.registry import PluginError
from farfield.testing import check_dataset, check_detector, check_protocol

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
Install = Callable[[str, Mapping[str, Mapping[str, str]]], None]
TORN = {group: {"torn": "no_such_package.thing:KIND"} for group in ("detectors", "datasets", "protocols")}


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Lets a package appear as installed: a function of its name and its entry points by group and name."""
    site = tmp_path / "site"
    site.mkdir()

    def put(package: str, points: Mapping[str, Mapping[str, str]]) -> None:
        folder = site / f"{package.replace('-', '_')}-0.1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.1.0\n")
        groups = (
            [f"[farfield.{group}]", *(f"{name} = {value}" for name, value in named.items())]
            for group, named in points.items()
        )
        (folder / "entry_points.txt").write_text("\n".join(line for lines in groups for line in lines) + "\n")
        monkeypatch.syspath_prepend(site)

    before = {registry: set(registry._loaded) for registry in (DATASETS, DETECTORS, PROTOCOLS)}
    yield put
    for registry, names in before.items():
        for name in set(registry._loaded) - names:
            del registry._loaded[name]
    for name in [name for name in sys.modules if name.partition(".")[0] in ("farfield_example", "test_example")]:
        del sys.modules[name]


@pytest.fixture
def example(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package of examples/, as its pyproject.toml says."""
    project = tomllib.loads((EXAMPLES / "pyproject.toml").read_text())["project"]
    monkeypatch.syspath_prepend(EXAMPLES)
    groups = {group.removeprefix("farfield."): named for group, named in project["entry-points"].items()}
    install(project["name"], groups)


@pytest.fixture
def survey(example: None, tmp_path: Path) -> Path:
    """The example's data set."""
    from test_example import write_survey

    return write_survey(tmp_path / "survey")


def test_the_notebook_of_the_readme_runs(survey: Path) -> None:
    pytest.importorskip("torch")
    (code,) = re.findall(r"```python\n(.*?)```", (EXAMPLES / "README.md").read_text(), flags=re.DOTALL)
    registered = (DATASETS, DETECTORS, PROTOCOLS)
    try:
        exec(code, {"__name__": "notebook"})
        assert ff.open_dataset(survey, format="my-survey").name == "my-survey"
        check_protocol("my-recall")
        assert DETECTORS.origin("my-pillars") == "registered here"
        assert DETECTORS["my-pillars"].config_class().name == "my-pillars"
    finally:
        for registry in registered:
            registry._registered.clear()


@pytest.mark.parametrize(("name", "limit"), [("dataset", 80), ("detector", 80), ("protocol", 80), ("method", 60)])
def test_examples_are_short(name: str, limit: int) -> None:
    assert len((EXAMPLES / "farfield_example" / f"{name}.py").read_text().splitlines()) < limit


def test_the_data_set_opens_by_what_it_looks_like(survey: Path, tmp_path: Path) -> None:
    data = ff.open_dataset(survey)
    assert (data.name, len(data), DATASETS.origin("survey")) == ("survey", 3, "farfield-example")
    assert [len(frame.boxes) for frame in data] == [2, 2, 0]
    check_dataset(data)
    with pytest.raises(ConfigError, match="survey reader does not know the option 'labels'"):
        ff.open_dataset(survey, labels="v2")
    (survey / "boxes.csv").unlink()
    assert not ff.open_dataset(survey)[0].has_annotation
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"Looked for .*\bsurvey\b"):
        ff.open_dataset(tmp_path / "empty")


def test_the_protocol_scores_files(
    example: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], without_shape_checks: None
) -> None:
    check_protocol("recall")
    place = np.array([[20.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    for name, shift_m in (("labels", 0.0), ("found", 1.5)):
        rows = BoxRows(
            frame=np.array(["1", "2"]),
            label=np.full(2, "vehicle"),
            centre_m=place + np.array([[shift_m, 0, 0], [0, 0, 0]]),
            size_m=np.ones((2, 3)),
            yaw_rad=np.zeros(2),
            score=None if name == "labels" else np.ones(2),
        )
        write_boxes_csv(tmp_path / f"{name}.csv", rows)
    words = ["score", str(tmp_path / "found.csv"), str(tmp_path / "labels.csv"), "--protocol", "recall"]
    for options, expected in (([], 1.0), (["--options", "distance_m=1"], 0.5)):
        assert main([*words, *options, "--json", str(tmp_path / "out.json")]) == 0
        assert json.loads((tmp_path / "out.json").read_text())["recall"] == expected
    assert "recall of 'vehicle'" in capsys.readouterr().out
    assert main([*words, "--options", "far_m=1"]) == 1
    assert "expected options among label, distance_m" in capsys.readouterr().err


def test_a_broken_package_is_named_and_hurts_no_other(
    example: None, install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install("torn-package", TORN)
    reason = "'torn' of the package torn-package cannot be used: ModuleNotFoundError: No module named 'no_such_package'"
    assert main(["detectors"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert reason in shown
    assert "mean-pillars: of farfield-example" in shown
    for words in (["--help"], ["experiments"]):
        assert main(words) == 0
    for verb in ("score", "train", "evaluate", "detectors"):
        assert main([verb, "--help"]) == 0
    for registry in (DETECTORS, DATASETS, PROTOCOLS):
        assert reason in registry.broken("torn")
        with pytest.raises(PluginError, match="no_such_package"):
            _ = registry["torn"]
    assert str(PROTOCOLS["recall"]) == "recall"
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"torn: cannot be used: .*no_such_package"):
        ff.open_dataset(tmp_path / "empty")


def test_what_is_registered_as_another_thing_is_named_too(
    install: Install, capsys: pytest.CaptureFixture[str], without_shape_checks: None
) -> None:
    wrong = {"wrong": "json:dumps"}
    install("wrong-package", {"detectors": wrong, "protocols": wrong, "datasets": wrong})
    assert main(["detectors"]) == 0
    assert "wrong-package cannot be used: expected a farfield.detectors.DetectorSpec" in " ".join(
        capsys.readouterr().out.split()
    )
    assert "expected a class that inherits" in PROTOCOLS.broken("wrong")
    with pytest.raises(ConfigError, match="expected a Format, or a Dataset class"):
        ff.open_dataset(Path(), format="wrong")


def test_two_packages_with_one_name_are_both_named(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    for package in ("one-package", "other-package"):
        install(package, {"detectors": {"twice": f"{package.replace('-', '_')}:KIND"}})
    with pytest.raises(PluginError, match="'twice': registered by one-package and other-package; uninstall one"):
        _ = DETECTORS["twice"]
    assert main(["detectors"]) == 0
    assert "registered by one-package and other-package" in " ".join(capsys.readouterr().out.split())


def test_an_entry_point_never_takes_the_place_of_a_built_in_name(install: Install) -> None:
    install("greedy-package", {"detectors": {"second": "no_such_package:KIND"}})
    assert DETECTORS.origin("second") == "farfield"
    assert DETECTORS["second"].name == "second"


def test_the_detector_goes_through_the_checks(example: None) -> None:
    pytest.importorskip("torch")
    from test_example import SMALL

    check_detector("mean-pillars", SMALL)


@pytest.mark.parametrize("method", ["supervised", "gradient-reversal"])
def test_the_detector_trains_by_an_experiment(survey: Path, tmp_path: Path, method: str) -> None:
    pytest.importorskip("torch")
    from test_example import SMALL

    one = {"path": str(survey), "clouds": ["lidar"]}
    settings = {
        "name": "mine",
        "data": one if method == "supervised" else {"source": one, "target": one},
        "method": {"name": method},
        "detector": {"name": "mean-pillars", **SMALL},
        "training": {
            "steps": 3,
            "batch_size": 2,
            "precision": "fp32",
            "threads": 1,
            "workers": 0,
            "log_every_steps": 1,
        },
    }
    (tmp_path / "mine.yaml").write_text(json.dumps(settings))  # JSON is YAML
    assert main(["train", str(tmp_path / "mine.yaml"), "--out", str(tmp_path)]) == 0
    steps = [json.loads(line) for line in (tmp_path / "mine" / "log.jsonl").read_text().splitlines()]
    assert len(steps) == 3
    assert ("domain_source" in steps[0]) == (method == "gradient-reversal")
    detector = ff.load_detector(tmp_path / "mine")
    assert detector.config.name == "mean-pillars"
    found = ff.detect(detector, ff.open_dataset(survey))
    assert found.score("recall").figures["recall"] is not None
