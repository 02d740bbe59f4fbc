"""A box of a frame as the journal writes it."""

from collections.abc import Mapping
from typing import Any

from farfield.datasets.labels.contract import BoxLabel, Numbers

_PLAIN: tuple[tuple[str, Any], ...] = (
    ("track", ""),
    ("state", "accepted"),
    ("source", ""),
    ("attributes", {}),
    ("score", None),
)


def value_of(label: BoxLabel, proposal: Numbers | None = None) -> dict[str, Any]:
    """The journal's value of a label; what is as usual is left out.

    Args:
        label: The label.
        proposal: The detector's box from which it came.
    """
    value: dict[str, Any] = {"label": label.label, "box": [float(number) for number in label.box]}
    for name, usual in _PLAIN:
        present = getattr(label, name)
        if present != usual:
            value[name] = dict(present) if name == "attributes" else present
    if proposal is not None:
        value["proposal"] = [float(number) for number in proposal]
    return value


def label_of(name: str, value: Mapping[str, Any]) -> BoxLabel:
    """The label of a value.

    Raises:
        ValueError: If the value is no box's.
    """
    known = {"label", "box", "proposal", *(field for field, _ in _PLAIN)}
    if not isinstance(value, Mapping) or not {"label", "box"} <= value.keys() <= known:
        raise ValueError(f"expected the value of a box, got {str(value)[:80]}")
    more = {field: value[field] for field, _ in _PLAIN if field in value}
    return BoxLabel(id=name, label=str(value["label"]), box=numbers(value["box"]), **more)


def numbers(box: Any) -> Numbers:
    """Seven numbers of a box.

    Raises:
        ValueError: If they are not seven numbers.
    """
    if len(box) != 7 or not all(isinstance(number, int | float) for number in box):
        raise ValueError(f"expected seven numbers of a box, got {str(box)[:80]}")
    x, y, z, length, width, height, yaw = map(float, box)
    return x, y, z, length, width, height, yaw
