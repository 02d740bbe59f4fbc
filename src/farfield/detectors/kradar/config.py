"""What RTN and RTNH share: K-Radar's two regions, their anchors and thresholds, and the choice of the head."""

from typing import Any, Literal

from pydantic import Field, model_validator
from torch import Tensor

from farfield.detectors.anchors.grid import AnchorGrid
from farfield.detectors.anchors.head import AnchorHead, AnchorHeadConfig
from farfield.detectors.contract import MapDetector
from farfield.detectors.features import FeatureMap
from farfield.detectors.inputs import CloudInput
from farfield.detectors.kradar.cells import RadarGridConfig, cell_columns
from farfield.detectors.kradar.softmax_head import SoftmaxHead
from farfield.detectors.voxels import OLD_NAMES
from farfield.vocabulary.kradar import REGIONS_M

_SEDAN = {"size_m": (4.2, 2.1, 2.0), "z_m": 0.0, "positive_iou": 0.5, "negative_iou": 0.2}
_BOTTOM_M = -1.08

FORMS: dict[str, dict[str, Any]] = {
    "published": {  # cfg_RTNH.yml, benchmark v1.0
        "grid": {},
        "anchors": {"vehicle": _SEDAN},
        "box_weight": 1.0,
        "max_points": 0,
        "cell_channels": 64,
        "score_threshold": 0.3,
        "nms_iou": 0.1,
    },
    "wide": {  # cfg_RTNH_wide.yml, benchmark v2.0
        "grid": {"half_width_m": REGIONS_M["wide"][3], "z_max_m": REGIONS_M["wide"][5]},
        "anchors": {
            "vehicle": {**_SEDAN, "z_m": _BOTTOM_M + 1.0},
            "large_vehicle": {
                "size_m": (9.5, 3.2, 3.7),
                "z_m": _BOTTOM_M + 1.85,
                "positive_iou": 0.45,
                "negative_iou": 0.15,
            },
        },
        "head": "openpcdet",
        "matching": "iou",
        "candidates": 4096,
        "max_points": 4,
        "cell_channels": 32,
        "score_threshold": 0.1,
        "nms_iou": 0.01,
    },
}
"""Settings that each form stands for; what an experiment sets itself comes first."""


class RadarDetectorConfig(AnchorHeadConfig):
    """Settings that RTN and RTNH share. ``form`` decides what the others are unless they are given."""

    old_names = OLD_NAMES

    form: Literal["published", "wide"] = Field(
        "published",
        description="published: narrow region, Sedan, softmax head; wide: two classes, OpenPCDet's anchor head",
    )
    grid: RadarGridConfig = RadarGridConfig()
    proposals: Literal["predicted", "anchors"] = Field(
        "predicted", description="with form: published, what must overlap a box to be assigned to it"
    )
    power: Literal["linear", "log"] = Field("linear", description="log: log(1 + power / 0.01) instead of the power")
    use_doppler: bool = Field(False, description="also read the cells' Doppler")
    use_flags: bool = Field(False, description="also read whether Doppler and height are known: several radars")
    neck_width: int = Field(256, ge=1, le=4096, description="channels that each stage gives to the bird's-eye map")

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, settings: Any) -> Any:
        if not isinstance(settings, dict):
            return settings
        usual = FORMS.get(str(settings.get("form", "published")), {})
        return {**{key: value for key, value in usual.items() if key in cls.model_fields}, **settings}

    @model_validator(mode="after")
    def _square_cells(self) -> "RadarDetectorConfig":
        if self.grid.cell_m[0] != self.grid.cell_m[1]:
            raise ValueError(f"expected cells as long as wide, got {self.grid.cell_m}: the anchors' cells are square")
        return self

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return cell_columns(self.use_doppler, self.use_flags)


class RadarDetector(MapDetector):
    """Reads radar points on their raster; its head has one set of anchors at every cell."""

    head: AnchorHead | SoftmaxHead

    def __init__(self, config: RadarDetectorConfig) -> None:
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}

    def add_head(self, c_in: int, multiple: int) -> None:
        """Make the head of the configuration's form, on a map of the raster's resolution."""
        config = self.config
        _, nx, ny = config.grid.shape(multiple)
        cell_m, y_min_m = config.grid.cell_m[0], config.grid.y_min_m(multiple)
        anchors = AnchorGrid(config.anchors, nx=nx, ny=ny, cell_m=cell_m, y_min_m=y_min_m)
        if config.form == "wide":
            self.head = AnchorHead(config, c_in, anchors)
        else:
            self.head = SoftmaxHead(config, c_in, anchors, proposals=config.proposals)
        self.assigner, self.channels = self.head.assigner, c_in

    def on_raster(self, values: Tensor) -> FeatureMap:
        """The trunk's map, shape (b, c, nx, ny), with its place."""
        grid = self.head.anchors
        return FeatureMap(values=values, cell_m=grid.cell_m, origin_m=(0.0, grid.y_min_m))
