"""A score does not depend on the order of lines in a file; where a kit's rule does, the protocol says so."""

import numpy as np
import pytest

from farfield.frame import Annotation, Boxes, Key
from farfield.metrics import Bootstrap, Detections
from farfield.metrics.detections import PROTOCOLS

NO_BOOTSTRAP = Bootstrap(replicates=0)


def _crowd(seed: int) -> Detections:
    """Boxes so close that they contest predictions, whose scores are few: ties."""
    rng = np.random.default_rng(seed)
    boxes, annotations = dict[Key, Boxes](), dict[Key, Annotation]()
    for number in range(12):
        count = 14
        centre_m = np.column_stack(
            [rng.uniform(5, 40, count), rng.uniform(-6, 6, count), rng.uniform(-0.2, 0.2, count)]
        )
        labels = Boxes(
            centre_m=centre_m,
            size_m=np.tile([4.5, 1.9, 1.6], (count, 1)) * rng.uniform(0.8, 1.3, (count, 1)),
            yaw_rad=rng.uniform(-0.4, 0.4, count),
            label="vehicle",
        )
        annotations["s", str(number)] = Annotation(boxes=labels)
        boxes["s", str(number)] = labels.replace(
            centre_m=centre_m + rng.normal(0, 0.8, (count, 3)) * [1, 1, 0.2],
            size_m=labels.size_m * rng.uniform(0.7, 1.4, (count, 3)),
            yaw_rad=labels.yaw_rad + rng.normal(0, 0.3, count),
            score=rng.integers(1, 4, count) / 4,
        )
    return Detections(boxes=boxes, annotations=annotations, reference="radar", checked=True)


def _shuffled(detections: Detections, seed: int) -> Detections:
    rng = np.random.default_rng(seed)
    keys = list(detections.annotations)
    rng.shuffle(keys)
    turn = {tuple(key): rng.permutation(len(detections.boxes[tuple(key)])) for key in keys}
    return Detections(
        boxes={key: detections.boxes[key][rows] for key, rows in turn.items()},
        annotations={key: detections.annotations[key][rng.permutation(len(rows))] for key, rows in turn.items()},
        reference="radar",
        checked=True,
    )


@pytest.mark.parametrize("protocol", ["dds", "nuscenes", "kradar"])
@pytest.mark.parametrize("options", [{}, {"max_boxes": 5}], ids=["all", "five a frame"])
def test_no_figure_depends_on_the_order_of_lines(protocol: str, options: dict[str, int]) -> None:
    if protocol == "kradar" and options:
        pytest.skip("it has no such limit")
    settings = {"region": "none", "bootstrap": NO_BOOTSTRAP, **options}
    for seed in range(4):
        detections = _crowd(seed)
        first = detections.score(protocol, **settings)
        for order in range(4):
            again = _shuffled(detections, order).score(protocol, **settings)
            assert again.figures == first.figures
            assert again.ranges == first.ranges


def test_the_kits_own_order_stays_that_of_the_file_and_is_said() -> None:
    variant = PROTOCOLS["kradar-compat:revised_yaw_fixed"]
    result = _crowd(0).score(variant, bootstrap=NO_BOOTSTRAP)
    assert result.settings["order"] == "file"
    assert "order=file" in result.convention
    assert "order=nearest_first" in _crowd(0).score("kradar", bootstrap=NO_BOOTSTRAP).convention
    figures = {
        tuple(_shuffled(_crowd(0), order).score(variant, bootstrap=NO_BOOTSTRAP).figures.values()) for order in range(6)
    }
    assert len(figures) > 1  # as in the kit
