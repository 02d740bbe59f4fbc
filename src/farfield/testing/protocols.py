"""What every protocol keeps, whoever wrote it: plain functions that raise AssertionError."""

import json
from collections.abc import Mapping

import numpy as np

from farfield.frame import Annotation
from farfield.geometry.boxes import Boxes
from farfield.metrics import PROTOCOLS, Detections, Protocol


def example() -> Detections:
    """Perfect boxes of two classes in six frames of two drives, one frame of them annotated as empty."""
    boxes, annotations = {}, {}
    for number in range(6):
        many = 0 if number == 3 else 10
        index = np.arange(many)
        marked = Boxes(
            centre_m=np.column_stack([5.0 + 6.0 * index, (index % 3) * 3.0 - 3.0, np.zeros(many)]),
            size_m=np.tile([4.0, 2.0, 1.5], (many, 1)),
            yaw_rad=np.linspace(-1, 1, many),
            label=np.where(index % 5 == 0, "pedestrian", "vehicle"),
            track_id=index,
        )
        key = (f"drive{number % 2}", str(number))
        annotations[key] = Annotation(boxes=marked)
        boxes[key] = marked.replace(score=np.linspace(0.5, 0.9, many))
    return Detections(boxes=boxes, annotations=annotations, reference="radar")


def check_protocol(protocol: str | Protocol) -> None:
    """Check a protocol: the best and the worst score, order, JSON, empty frames.

    Args:
        protocol: The protocol, or its name in ``farfield.metrics.PROTOCOLS``.

    Raises:
        AssertionError: If something does not hold; the message says what and how to fix it.
    """
    checked = PROTOCOLS[protocol] if isinstance(protocol, str) else protocol
    detections = example()
    best = detections.score(checked)
    for part, figures in {"figures": best.figures, **best.ranges}.items():
        wrong = [name for name, value in figures.items() if value is not None and not np.isfinite(value)]
        assert not wrong, f"{checked}: {part}: {', '.join(wrong)} must be finite, or None where nothing counts"
    tree = json.loads(json.dumps(best.to_json(), allow_nan=False))
    top = checked.headline(tree)
    assert any(value is not None for value in top.values()), f"{checked}: headline() must name figures of the result"
    assert checked.settings(detections) == checked.settings(detections), (
        f"{checked}: settings() must depend on its arguments alone"
    )
    assert tree["protocol"] == str(checked), f"{checked}: Result.protocol must be the protocol's name"
    assert str(best), f"{checked}: a result must print itself"
    check_worse(checked, detections, top)
    check_order(checked, detections, top)
    check_empty(checked, detections)


def check_worse(protocol: Protocol, detections: Detections, top: Mapping[str, float | None]) -> None:
    """Boxes that are moved, and no boxes at all, score no more than perfect ones."""
    shift = np.array([0.8, 0.0, 0.0])
    shifted = {key: boxes.replace(centre_m=boxes.centre_m + shift) for key, boxes in detections.boxes.items()}
    low: Mapping[str, float | None] = {}
    for worse, name in ((shifted, "moved by 0.8 m"), ({}, "absent")):
        low = protocol.headline(detections.replaced(worse).score(protocol).to_json())
        for figure, value in top.items():
            other = low.get(figure)
            assert other is None or value is None or other <= value, (
                f"{protocol}: {figure} is larger for boxes that are {name} than for perfect ones; "
                "leave figures of which less is better out of headline()"
            )
    none = [value for value in low.values() if value is not None]
    most = max(value for value in top.values() if value is not None)
    assert none, f"{protocol}: no boxes at all where some are annotated must score something, such as 0"
    assert max(none) < most, f"{protocol}: no boxes at all must score less than perfect ones"


def check_order(protocol: Protocol, detections: Detections, top: Mapping[str, float | None]) -> None:
    """The order of boxes and of frames does not matter."""
    rng = np.random.default_rng(0)
    turned = {key: boxes[rng.permutation(len(boxes))] for key, boxes in reversed([*detections.boxes.items()])}
    again = detections.replaced(turned).score(protocol)
    assert_close(protocol.headline(again.to_json()), top, f"{protocol}: the order of boxes and frames must not matter")


def check_empty(protocol: Protocol, detections: Detections) -> None:
    """Frames without boxes, and no frames, give a result that JSON holds."""
    nothing = Annotation(boxes=Boxes.empty())
    bare = Detections(boxes={}, annotations=dict.fromkeys(detections.annotations, nothing)).score(protocol)
    json.dumps(bare.to_json(), allow_nan=False)
    assert not any(protocol.headline(bare.to_json()).values()), f"{protocol}: frames without boxes must give None, or 0"
    json.dumps(Detections(boxes={}, annotations={}).score(protocol).to_json(), allow_nan=False)


def assert_close(one: Mapping[str, float | None], other: Mapping[str, float | None], what: str) -> None:
    """Compare figures by name to 1e-12."""
    assert one.keys() == other.keys(), f"{what}: {sorted(one)} and {sorted(other)}"
    for name, value in one.items():
        second = other[name]
        if value is None or second is None:
            assert value is second, f"{what}: {name} is {value} and {second}"
        else:
            assert abs(value - second) <= 1e-12, f"{what}: {name} is {value} and {second}"
