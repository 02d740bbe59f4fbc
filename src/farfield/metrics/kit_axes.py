"""In which axes the boxes of K-Radar's kit folders stand: decided from the numbers, and said, never taken for granted.

The kit (``dict_datum_to_kitti`` of kaist-avelab/K-Radar, utils/util_pipeline.py) writes KITTI's columns with exchanged
axes: x y z hold y (left), z (up) and x (ahead) of the radar, the middle of the box and not its bottom, and rotation_y
holds the yaw itself, which by KITTI's own rule stands for a box turned by a quarter (issue 81 there). Copies of the kit
that mend the turn write yaw - 90 degrees, and other tools write KITTI's own axes or the LiDAR's into the same folders.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from farfield.errors import ConfigError
from farfield.files.kitti import KittiObjects
from farfield.geometry.boxes import Boxes
from farfield.geometry.kitti import upright_from_camera
from farfield.vocabulary.counts import count_of

AXES = ("exchanged", "exchanged-turned", "camera", "lidar")
"""y z x of the radar, the middle, and the yaw, as the kit ships; the same with yaw - 90 degrees; KITTI's own camera;
x y z of the radar as they are, the middle, and the yaw."""
STAND_IN_PX = (50.0, 50.0, 150.0, 150.0)
"""The 2D box that the kit writes with every box."""
_ALONG, _ACROSS = np.cos(np.deg2rad(30)), np.cos(np.deg2rad(60))
_MOST_ALONG, _FEW = 0.6, 10
_FLAT_M = 3.0
_VEHICLES = ("sed", "bus", "Sedan", "Bus or Truck", "Car", "Truck", "vehicle", "large_vehicle")


def boxes_in_axes(objects: KittiObjects, axes: str, *, score: Float[np.ndarray, " n"] | None = None) -> Boxes:
    """The boxes of KITTI's columns in our axes: x ahead, y left, z up.

    Args:
        objects: n rows with 3D boxes.
        axes: One of :data:`AXES`.
        score: Scores, shape (n,), or None.

    Raises:
        ConfigError: If there are no such axes.
    """
    if axes not in AXES:
        raise ConfigError(f"--axes: expected one of {', '.join(AXES)}, got {axes!r}")
    if axes == "camera":
        centre, size, yaw = upright_from_camera(objects.bottom_m, objects.size_m, objects.rotation_y_rad)
        return Boxes(centre_m=centre, size_m=size, yaw_rad=yaw, label=objects.type, score=score)
    order = [0, 1, 2] if axes == "lidar" else [2, 0, 1]
    return Boxes(
        centre_m=objects.bottom_m[:, order].copy(),
        size_m=objects.size_m[:, ::-1].copy(),
        yaw_rad=objects.rotation_y_rad + (np.pi / 2 if axes == "exchanged-turned" else 0.0),
        label=objects.type,
        score=score,
    )


def columns_of_boxes(boxes: Boxes) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Sizes h w l and x y z as the kit ships them: the inverse of :func:`boxes_in_axes` for ``exchanged``.

    >>> box = Boxes(centre_m=np.array([[30.0, 2.0, 0.5]]), size_m=np.array([[4.0, 2.0, 1.5]]), yaw_rad=np.zeros(1))
    >>> columns_of_boxes(box)[1].tolist()
    [[2.0, 0.5, 30.0]]
    """
    return boxes.size_m[:, ::-1].copy(), boxes.centre_m[:, [1, 2, 0]].copy()


def decide_axes(parts: Sequence[KittiObjects]) -> tuple[str, str]:
    """Which axes the boxes of a kit's folders have, and what says so, in a sentence.

    Positions are decided by the kit's stand-in 2D boxes, or by which column lies flat along the road and where it lies;
    the turn by how vehicles head: of K-Radar's 115,229 boxes (labels v2.1) 89 % of the vehicles head within 30 degrees
    of x, 8 % beyond 60.

    Args:
        parts: The boxes, by file.

    Raises:
        ConfigError: If the numbers do not decide it, or contradict one another; names the flag that does.
    """
    bottom_m = np.concatenate([np.zeros((0, 3)), *[part.bottom_m for part in parts]])
    box_px = np.concatenate([np.zeros((0, 4)), *[part.box_px for part in parts]])
    turn_rad = np.concatenate([np.zeros(0), *[part.rotation_y_rad for part in parts]])
    labels = np.concatenate([np.zeros(0, "<U1"), *[part.type for part in parts]])
    if not len(bottom_m):
        return "exchanged", "there is no box whose axes had to be decided"
    # Which column is upright: objects on a road lie within a few metres there, and tens of metres in the others.
    spread_m = np.percentile(bottom_m, 95, axis=0) - np.percentile(bottom_m, 5, axis=0)
    stands_in = bool((box_px == STAND_IN_PX).all())
    shown = ", ".join(f"{name} {value:.1f} m" for name, value in zip("xyz", spread_m, strict=True))
    if stands_in and spread_m[1] > max(_FLAT_M, spread_m[2]) and len(bottom_m) >= _FEW:
        raise _undecided(f"the 2D boxes are the kit's, but y is not upright: of the middle nine tenths {shown}")
    if stands_in:
        places = "x y z as left, up, ahead, by the 2D boxes 50 50 150 150 that the kit alone writes"
    else:
        flat = [column for column in (1, 2) if spread_m[column] < _FLAT_M]
        if len(flat) != 1 or len(bottom_m) < _FEW:
            raise _undecided(
                f"{count_of(len(bottom_m), 'box', 'boxes')} spread over {shown}: not one column is upright"
            )
        if flat == [2]:
            return "lidar", f"x y z as ahead, left, up: z alone is upright (spread {shown})"
        middle_m = float(np.median(bottom_m[:, 1]))
        if middle_m > 0.9:
            return "camera", f"KITTI's own axes: y is upright and points down (median {middle_m:.1f} m below)"
        if middle_m > 0.6:
            raise _undecided(f"y is upright with a median of {middle_m:.2f} m, which may be up or down")
        places = f"x y z as left, up, ahead: y is upright (spread {shown}) with a median of {middle_m:.1f} m"
    # How vehicles head: along the road, as a rule.
    vehicles = np.isin(labels, _VEHICLES)
    cosine = np.abs(np.cos(turn_rad[vehicles]))
    along, across = (float((part).mean()) if len(cosine) else 0.0 for part in (cosine > _ALONG, cosine < _ACROSS))
    if along < _MOST_ALONG:
        raise _undecided(
            f"{places}; but of {count_of(len(cosine), 'vehicle')} {along:.0%} head along x and {across:.0%} across, so "
            "that rotation_y may be the yaw (exchanged, as the kit ships) or yaw - 90 degrees (exchanged-turned)"
        )
    return (
        "exchanged",
        f"{places}; rotation_y as the yaw: {along:.0%} of {count_of(len(cosine), 'vehicle')} head along x",
    )


def _undecided(why: str) -> ConfigError:
    return ConfigError(
        f"--axes: the axes of the boxes cannot be decided from them ({why}). Say --axes {'|'.join(AXES)}"
    )
