"""What an exported file says of itself: a JSON text among its metadata, checked before anything of it is used."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from farfield.detectors.onnx.points import PointReading
from farfield.detectors.onnx.readings import (
    PillarReading,
    RadarCellReading,
    RadarMapReading,
    Reading,
    SecondReading,
    VoxelNetReading,
)
from farfield.detectors.onnx.sparse_centre import SparseCentreReading
from farfield.detectors.onnx.wire import OnnxContent
from farfield.detectors.provenance import provenance_of
from farfield.detectors.score_bands import ScoreBands
from farfield.errors import FileFormatError, plain
from farfield.files.json_text import plain_json
from farfield.files.limits import MAX_NAME
from farfield.files.yaml_text import PlainSettings

FORMAT = "farfield-onnx-1"
RECORD, PROVENANCE = "farfield", "farfield.provenance"
"""Names of the metadata."""
_MAX_RECORD, _MAX_PROVENANCE = 1_000_000, 32_000_000
AXES = "x forward, y left, z up, metres, right-handed; yaw counter-clockwise from +x, radians"
BOXES = "x, y, z of the centre, length, width, height (metres), yaw (radians)"
UNITS = {
    "x_m": "metres forward",
    "y_m": "metres to the left",
    "z_m": "metres up, 0 at the sensor",
    "intensity": "return strength, 0 to 1",
    "lag_s": "age of the point's sweep, seconds",
    "power": "power of the radar's cell over 1e13",
    "doppler_m_s": "radial velocity, metres a second",
    "has_doppler": "1 where the Doppler is known, else 0",
    "has_height": "1 where the height is known, else 0",
}
"""Units of the columns of points."""


def _kind_of(reading: Any) -> str:
    """Which reading a record holds: ``Field(discriminator=)`` does not go with the validators of plain settings."""
    return str(reading.get("kind") if isinstance(reading, dict) else getattr(reading, "kind", ""))[:40]


AnyReading = Annotated[
    Annotated[PillarReading, Tag("pillars")]
    | Annotated[SecondReading, Tag("second")]
    | Annotated[VoxelNetReading, Tag("voxelnet")]
    | Annotated[RadarMapReading, Tag("radar-map")]
    | Annotated[RadarCellReading, Tag("radar-cells")]
    | Annotated[SparseCentreReading, Tag("sparsecentre")]
    | Annotated[PointReading, Tag("points")],
    Discriminator(_kind_of),
]
Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME)]


class OnnxRecord(PlainSettings):
    """All that a deployer must know of an exported detector, and what the library needs to run it."""

    format: str = FORMAT
    farfield: str = Field(max_length=100)
    name: Name
    detector: Name
    network: Name
    classes: tuple[Name, ...] = Field(min_length=1, max_length=64)
    axes: str = AXES
    boxes: str = BOXES
    units: dict[str, str] = Field(max_length=64)
    reference: str | None = None
    reach_m: float = Field(gt=0, le=2000)
    score_threshold: float = Field(ge=0, le=1)
    nms_iou: float = Field(ge=0, le=1)
    max_boxes: int = Field(ge=1, le=100_000)
    score_bands: ScoreBands | None = None
    weights_sha256: str = Field(pattern="^[0-9a-f]{64}$")
    licence: str = Field("", max_length=1000)
    opset: int = Field(ge=18, le=24)
    made_with: dict[str, str] = Field(default_factory=dict, max_length=16)
    reading: AnyReading

    @model_validator(mode="after")
    def _ours(self) -> "OnnxRecord":
        if self.format != FORMAT:
            raise ValueError(f"expected format {FORMAT}, got {self.format[:60]}")
        return self


def record_of(path: Path, content: OnnxContent) -> tuple[OnnxRecord, dict[str, Any]]:
    """The record and the provenance of a file, in agreement with its inputs.

    Args:
        path: Where it is from, for messages.
        content: What was read of it.

    Raises:
        FileFormatError: If there is no record, it is damaged, or the network reads something else than it says.
    """
    text, history = content.metadata.get(RECORD), content.metadata.get(PROVENANCE, "{}")
    fix = "Export the detector anew: farfield export DETECTOR OUT.onnx"
    if text is None:
        got = ", ".join(sorted(content.metadata))[:200] or "none"
        expected = f"those that farfield export writes, {RECORD}: axes, units and thresholds of other files are unknown"
        raise FileFormatError(path, where="metadata", expected=expected, got=got, fix=fix)
    if len(text) > _MAX_RECORD or len(history) > _MAX_PROVENANCE:
        raise FileFormatError(
            path, where="metadata", expected="a short record", got=f"{len(text):,} characters", fix=fix
        )
    try:
        record = OnnxRecord.model_validate(plain_json(text))
    except (ValidationError, ValueError, TypeError, RecursionError) as error:
        raise FileFormatError(
            path, where="metadata", expected="a record of an export", got=plain(error)[:300], fix=fix
        ) from error
    _check_inputs(path, record.reading, content)
    return record, provenance_of(path, history)


def _check_inputs(path: Path, reading: Reading, content: OnnxContent) -> None:
    """See that the network takes what the reading prepares."""
    prepared = reading.blank()
    for name, spec in content.inputs.items():
        sample = prepared.get(name)
        if sample is None:
            raise FileFormatError(path, where="inputs", expected=", ".join(prepared), got=name[:80])
        dtype, sides = sample
        fixed = spec.shape[1:]
        if (
            spec.dtype != dtype
            or len(spec.shape) != len(sides) + 1
            or spec.shape[0] is not None
            or any(
                side is not None and other is not None and side != other
                for side, other in zip(fixed, sides, strict=True)
            )
        ):
            expected = f"{dtype} of {('n', *sides)}"
            raise FileFormatError(path, where=f"input {name}", expected=expected, got=f"{spec.dtype} of {spec.shape}")
    missing = [name for name in reading.results if name not in content.outputs]
    if missing:
        raise FileFormatError(path, where="outputs", expected=", ".join(reading.results), got=f"no {missing[0]}")
