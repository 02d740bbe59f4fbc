"""Every protocol, built in or registered: the same few things hold for all of them."""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pytest

from farfield.errors import ConfigError
from farfield.metrics import PROTOCOLS, Detections, Protocol, Result, protocol, score
from farfield.metrics.centre.matching import found_by
from farfield.metrics.comparing import compare, read_results
from farfield.metrics.detections import ForeignProtocol, protocol_of
from farfield.testing import check_protocol
from farfield.testing.protocols import example

NAMES = (
    "dds",
    "nuscenes",
    "nuscenes-detection",
    "argoverse2",
    "waymo",
    "waymo-let",
    "kitti",
    "tracking",
    "kradar",
    "kradar-compat:old_as_shipped@0.3",
    "kradar-compat:revised_yaw_fixed",
)


class Recall(Protocol):
    """The share of boxes that are found, as a newcomer would write it."""

    @dataclass(frozen=True, kw_only=True)
    class Settings:
        """What can be chosen."""

        label: str = "vehicle"
        distance_m: float = 2.0

    def evaluate(self, found: Detections, settings: Any) -> Result:
        """Recall of one class."""
        marked = {k: a.boxes[a.boxes.label == settings.label] for k, a in found.annotations.items()}
        hits = [found_by(found.boxes[k], boxes, distance_m=settings.distance_m) >= 0 for k, boxes in marked.items()]
        share = float(np.concatenate(hits).mean()) if any(map(len, hits)) else None
        return Result(
            protocol="recall",
            label=settings.label,
            settings=asdict(settings),
            convention="",
            figures={"recall": share},
        )


@pytest.fixture
def registered() -> Iterator[None]:
    protocol("recall")(Recall)
    yield
    PROTOCOLS._registered.pop("recall")


@pytest.mark.parametrize("name", NAMES)
def test_every_protocol_holds_what_all_promise(name: str) -> None:
    check_protocol(name)


def test_a_registered_protocol_is_found_and_holds_it_too(registered: None) -> None:
    assert "recall" in PROTOCOLS.names()
    assert PROTOCOLS.origin("recall") == "registered here"
    check_protocol("recall")
    boxes = {key: part for key, part in example().boxes.items() if key[0] == "drive0"}
    annotations = {key: annotation.boxes for key, annotation in example().annotations.items()}
    result = score(boxes, annotations, protocol="recall", label="pedestrian")
    assert result.figures == {"recall": pytest.approx(3 / 5)}
    assert "recall of 'pedestrian'" in str(result)
    assert "recall: distance_m=2" in str(result)
    assert score(boxes, annotations, protocol=Recall(), distance_m=1.0).label == "vehicle"
    assert [each.label for each in example().score_each("recall")] == ["vehicle", "pedestrian"]
    with pytest.raises(ConfigError, match="expected options among label, distance_m; got far_m"):
        score(boxes, annotations, protocol="recall", far_m=3)


def test_whole_numbers_and_lists_are_taken_as_edges() -> None:
    found = example()
    one = found.score("dds", range_bins_m=[0, 70, 150], epsilons=(0,)).to_json()
    assert one == found.score("dds", range_bins_m=(0.0, 70.0, 150.0), epsilons=(0.0,)).to_json()
    assert [type(edge) for edge in one["settings"]["range_bins_m"]] == [float] * 3


def test_what_is_no_protocol_is_refused(without_shape_checks: None) -> None:
    with pytest.raises(ConfigError, match="built in"):
        protocol("dds")(Recall)
    with pytest.raises(ConfigError, match="inherits"):
        protocol("recall")(int)  # type: ignore[type-var]
    with pytest.raises(ConfigError, match="no variants"):
        PROTOCOLS["dds:wide"]
    with pytest.raises(ConfigError, match="one of dds"):
        PROTOCOLS["coco"]


def test_the_variant_is_the_objects_argument() -> None:
    assert str(PROTOCOLS["kradar-compat:rtnh_wide"]) == "kradar-compat:rtnh_wide"
    assert PROTOCOLS["kradar-compat:rtnh_wide"].family == PROTOCOLS["kradar"].family == "kradar"
    assert isinstance(protocol_of({"protocol": "theirs:x"}), ForeignProtocol)


def test_results_of_a_protocol_that_is_not_installed_are_compared(tmp_path: Any, registered: None) -> None:
    path = tmp_path / "theirs.json"
    tree = example().score("recall").to_json() | {"protocol": "theirs"}
    path.write_text(json.dumps(tree))
    text = compare(read_results([path, path], ["a", "b"]))
    assert "theirs, vehicle" in text
    assert ["a", "1.0000"] in [line.split() for line in text.splitlines()]
    with pytest.raises(ConfigError, match="not installed"):
        protocol_of(tree).evaluate(example(), None)


def test_one_score_imports_one_protocol() -> None:
    code = (
        "import sys; from farfield.metrics import score; score({}, {}, protocol='dds')\n"
        "print(*(name for name in sys.modules if name.startswith('farfield.metrics.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[2] for name in done.stdout.split()}
    assert not loaded & {"kitti", "kradar", "reading", "comparing"}
    assert "farfield.metrics.centre.nuscenes" not in done.stdout.split()
