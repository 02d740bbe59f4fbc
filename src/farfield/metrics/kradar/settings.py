"""The options of K-Radar's average precision, and the settings that published results were made with.

K-Radar's development kit scores with KITTI's code, changed in several ways over time, so that published figures differ
by label version, region, score cut, recall points, reference of the height, treatment of empty frames and of the yaw.
Each of these is an option here, and the variants name the combinations in use.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import pairwise
from typing import Any, Literal

from farfield.errors import ConfigError
from farfield.metrics.bootstrap import Bootstrap
from farfield.metrics.options import check_numbers, check_range_bins, json_options, option_text
from farfield.metrics.recall_sampling import RECALL_POINTS
from farfield.vocabulary.classes import CIRRUS_FROM_ANY_KRADAR
from farfield.vocabulary.kradar import KRADAR_ORIGIN_M, REGIONS_M, Bounds

_CHOICES: dict[str, tuple[object, ...]] = {
    "boxes_in": ("radar", "os2-64"),
    "recall_points": RECALL_POINTS,
    "sampling": ("filled", "gaps"),
    "empty_frames": ("counted", "dropped"),
    "outside": ("dropped", "kept"),
    "yaw": ("correct", "as_shipped"),
    "order": ("nearest_first", "file"),
    "z_center": (0.5, 1.0),
}
_FIRST = (
    "label_version",
    "region",
    "azimuth_deg",
    "score_cut",
    "recall_points",
    "empty_frames",
    "yaw",
    "z_center",
    "outside",
    "decimals",
    "sampling",
    "order",
)


@dataclass(frozen=True, kw_only=True)
class KRadarSettings:
    """Options of K-Radar's average precision; the defaults are those of protocol ``kradar``.

    Args:
        classes: Classes that are scored, each for itself.
        relabel: Class names that stand for another, in both kinds of boxes.
        ious: Overlaps that a match must exceed.
        region: Where annotated boxes count, by their centre in the radar's frame: ``"narrow"``, ``"wide"``,
            ``"none"`` (everywhere), or six bounds x from, x to, y from, y to, z from, z to.
        azimuth_deg: Largest azimuth of a centre seen from the radar, on either side, unless the region is ``"none"``;
            None for no limit. The kit has 50 in its first release and 53 since.
        outside: Predictions outside the region are ``"dropped"``, or ``"kept"`` as in the kit, where they are false.
        boxes_in: Frame in which the boxes are given; those of the os2-64 are moved into the radar's.
        origin_m: Where the radar stands in the os2-64's frame.
        score_cut: Predictions count whose score is above it.
        recall_points: 11 (recalls 0, 0.1 ... 1), 40 (1/40 ... 1) or 41 (0, 1/40 ... 1).
        sampling: With fewer than 41 annotated boxes KITTI's code leaves recall samples at 0 (``"gaps"``), so that no
            detector reaches 100; ``"filled"`` takes the precision at that recall.
        empty_frames: Frames without an annotated box of the classes in the region are ``"counted"``, so that
            predictions there are false, or ``"dropped"`` with their predictions.
        yaw: ``"as_shipped"`` turns every box by 90 degrees about its centre, as the kit does.
        z_center: Share of the height that lies below z: 0.5 where z is the centre; 1.0 takes z as the top, as the
            kit's first evaluation does.
        decimals: Annotated values are rounded to so many decimals first, as in the kit's text files; None: not.
        order: In which annotated boxes choose their predictions, and which of equal scores or overlaps is first:
            ``"nearest_first"`` to the radar, so that the order of a file's lines bears on no figure, or ``"file"``, as
            in the kit.
        label_version: Of the annotation, such as ``"v2.1"``; it stands beside the result.
        range_bins_m: Edges of the half-open range bins; both kinds of boxes are cut by their own range from the radar.
        bootstrap: How intervals are drawn.

    Raises:
        ConfigError: If an option is not one of those possible.
    """

    classes: tuple[str, ...] = ("vehicle", "large_vehicle")
    relabel: Mapping[str, str] = field(default_factory=lambda: dict(CIRRUS_FROM_ANY_KRADAR))
    ious: tuple[float, ...] = (0.3, 0.5, 0.7)
    region: str | tuple[float, ...] = "wide"
    azimuth_deg: float | int | None = 53.0
    outside: Literal["dropped", "kept"] = "dropped"
    boxes_in: Literal["radar", "os2-64"] = "radar"
    origin_m: tuple[float, float, float] = KRADAR_ORIGIN_M
    score_cut: float | int = 0.0
    recall_points: int = 40
    sampling: Literal["filled", "gaps"] = "filled"
    empty_frames: Literal["counted", "dropped"] = "counted"
    yaw: Literal["correct", "as_shipped"] = "correct"
    z_center: float = 0.5
    decimals: int | None = None
    order: Literal["nearest_first", "file"] = "nearest_first"
    label_version: str = "not stated"
    range_bins_m: tuple[float, ...] = (0.0, 20.0, 40.0, 60.0, 80.0)
    bootstrap: Bootstrap = field(default_factory=Bootstrap)

    def __post_init__(self) -> None:
        check_numbers(self)
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                expected = ", ".join(map(str, choices))
                raise ConfigError(f"{name}: expected one of {expected}, got {getattr(self, name)!r}")
        if not self.classes or len(set(self.classes)) < len(self.classes):
            raise ConfigError(f"classes: expected one or more different names, got {self.classes}")
        for name in self.classes:
            if self.relabel.get(name, name) != name:
                raise ConfigError(f"classes: {name!r} is relabelled as {self.relabel[name]!r}; name that one")
        if any("/" in name for name in self.classes):
            raise ConfigError(f"classes: expected names without a slash, got {self.classes}")
        if not self.ious or not all(0 < iou < 1 for iou in self.ious) or len(set(self.ious)) < len(self.ious):
            raise ConfigError(f"ious: expected different numbers between 0 and 1, got {self.ious}")
        if self.azimuth_deg is not None and not 0 < self.azimuth_deg <= 180:
            raise ConfigError(f"azimuth_deg: expected an angle up to 180 or None, got {self.azimuth_deg}")
        if self.decimals is not None and not 0 <= self.decimals <= 12:
            raise ConfigError(f"decimals: expected 0 to 12 or None, got {self.decimals}")
        if not math.isfinite(self.score_cut):
            raise ConfigError(f"score_cut: expected a finite number, got {self.score_cut}")
        check_range_bins(self.range_bins_m)
        object.__setattr__(self, "region", _checked_region(self.region))

    @property
    def label(self) -> str:
        """The classes as one phrase."""
        return ", ".join(self.classes)

    @property
    def bounds_m(self) -> Bounds | None:
        """x, y and z from and to in the radar's frame, or None for everywhere."""
        return None if self.region == "none" else _bounds(self.region)

    @property
    def bins_m(self) -> tuple[tuple[float, float], ...]:
        """The half-open range bins as (low, high)."""
        return tuple(pairwise(self.range_bins_m))

    def to_json(self) -> dict[str, Any]:
        """All options as JSON values."""
        return json_options(asdict(self))

    def convention(self) -> str:
        """The options on which the figures depend, in one line."""
        values = self.to_json()
        shown = {name: values[name] for name in _FIRST}
        shown["region"] = self.region if isinstance(self.region, str) else values["region"]
        if self.bounds_m is None:
            del shown["azimuth_deg"], shown["outside"]
        shown["decimals"] = "none" if self.decimals is None else self.decimals
        return "exact rotated IoU; " + option_text(shown)


def _bounds(region: str | tuple[float, ...]) -> Bounds:
    return REGIONS_M[region] if isinstance(region, str) else region  # type: ignore[return-value]


def _checked_region(region: str | tuple[float, ...]) -> str | tuple[float, ...]:
    if isinstance(region, str):
        if region in REGIONS_M or region == "none":
            return region
        try:
            region = tuple(float(word) for word in region.split(","))
        except ValueError:
            region = ()
    numbers = tuple(float(number) for number in region)
    if len(numbers) != 6 or not all(low < high for low, high in zip(numbers[::2], numbers[1::2], strict=True)):
        expected = "narrow, wide, none or six bounds x,x,y,y,z,z, each pair rising"
        raise ConfigError(f"region: expected {expected}, got {region!r}")
    return numbers


_KIT: dict[str, Any] = {
    "empty_frames": "dropped",
    "outside": "kept",
    "decimals": 2,
    "sampling": "gaps",
    "order": "file",
}
_OLD: dict[str, Any] = {"recall_points": 11, "z_center": 1.0, **_KIT}
_REVISED: dict[str, Any] = {"recall_points": 41, "z_center": 0.5, **_KIT}
_EVALUATORS: dict[str, dict[str, Any]] = {
    "old_as_shipped": {**_OLD, "yaw": "as_shipped"},
    "old_yaw_fixed": {**_OLD, "yaw": "correct"},
    "revised_as_shipped": {**_REVISED, "yaw": "as_shipped"},
    "revised_yaw_fixed": {**_REVISED, "yaw": "correct"},
}
_NARROW: dict[str, Any] = {"region": "narrow", "label_version": "v1.0", "classes": ("vehicle",)}
_WIDE: dict[str, Any] = {"region": "wide", "label_version": "v2.0", "classes": ("vehicle", "large_vehicle")}
VARIANTS: dict[str, dict[str, Any]] = {
    **{
        name + (f"@{cut:g}" if cut else ""): {**options, "score_cut": cut}
        for name, options in _EVALUATORS.items()
        for cut in (0.0, 0.3, 0.5, 0.7)
    },
    "rtnh_narrow": {**_EVALUATORS["old_as_shipped"], **_NARROW, "score_cut": 0.3, "azimuth_deg": 50.0},
    "rtnh_wide": {**_EVALUATORS["revised_as_shipped"], **_WIDE, "score_cut": 0.3, "azimuth_deg": 53.0},
    "lidar_wide": {**_EVALUATORS["old_as_shipped"], **_WIDE, "score_cut": 0.3, "azimuth_deg": 53.0},
    "asf_narrow": {**_EVALUATORS["revised_as_shipped"], **_NARROW, "score_cut": 0.0, "azimuth_deg": 53.0},
    "asf_wide": {**_EVALUATORS["revised_as_shipped"], **_WIDE, "score_cut": 0.0, "azimuth_deg": 53.0},
}
"""Options of each ``kradar-compat`` variant.

Four evaluators (``eval.py`` and ``eval_revised.py``, each as shipped and with the yaw fixed), with the score cuts in
use as ``@0.3``, and published results by the configuration that made them: RTNH on the narrow and the wide region, the
LiDAR detectors on the wide one (SECOND, PV-RCNN++), and the fusion ASF.
"""


def kradar_settings(protocol: str = "kradar", **options: Any) -> KRadarSettings:
    """Settings of ``"kradar"``, or of a variant ``"kradar-compat:NAME"``, whose options are then fixed.

    Raises:
        ConfigError: If the variant or an option is unknown, or an option differs from what the variant fixes.
    """
    names = [option.name for option in fields(KRadarSettings)]
    unknown = sorted(set(options) - set(names))
    if unknown:
        raise ConfigError(f"{protocol}: expected options among {', '.join(names)}; got {', '.join(unknown)}")
    if protocol == "kradar":
        return KRadarSettings(**options)
    variant = protocol.partition(":")[2]
    if variant not in VARIANTS:
        raise ConfigError(
            f"protocol: expected kradar-compat:VARIANT with one of {', '.join(VARIANTS)}; got {protocol!r}. "
            f"For {_by_labels()}."
        )
    fixed = VARIANTS[variant]
    changed = sorted(name for name in options if name in fixed and options[name] != fixed[name])
    if changed:
        raise ConfigError(
            f"{protocol} fixes {', '.join(f'{name}={fixed[name]}' for name in changed)}; {_taking(options)}, or choose "
            "protocol kradar, which takes every option"
        )
    return KRadarSettings(**{**options, **fixed})


def _taking(options: Mapping[str, Any]) -> str:
    """Which variants take some options, in words."""
    able = [name for name, fixed in VARIANTS.items() if all(fixed.get(o, v) == v for o, v in options.items())]
    if not able:
        return "no variant takes these options together"
    return f"choose a variant that takes {', '.join(f'{o}={v}' for o, v in options.items())}: {_listed(able)}"


def _by_labels() -> str:
    """The variants by the version of the labels that they are for."""
    groups: dict[str, list[str]] = {}
    for name, fixed in VARIANTS.items():
        groups.setdefault(fixed.get("label_version", "any"), []).append(name)
    return "; for ".join(f"{version} labels: {_listed(names)}" for version, names in groups.items())


def _listed(names: Sequence[str]) -> str:
    """Variants by name, those that differ in the score's cut as one."""
    plain = dict.fromkeys(name.partition("@")[0] for name in names)
    cuts = list(dict.fromkeys(f"@{name.partition('@')[2]}" for name in names if "@" in name))
    return ", ".join(plain) + (f" (also with {', '.join(cuts)})" if cuts else "")
