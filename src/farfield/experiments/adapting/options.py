"""What decides the outcome of an adaptation: what was chosen, and what was measured once and then kept."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError, field_validator, model_validator

from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import write_text
from farfield.files.json_text import read_json
from farfield.files.yaml_text import PlainSettings

THRESHOLDS = "adaptation.json"
_FIXED = ("method.start", "method.positive", "method.negative", "training.steps", "training.devices", "training.seed")
_OPEN = ("method.", "training.", "augmentation.")
_LIMIT_BYTES = 1 << 24


class AdaptationOptions(PlainSettings):
    """How to adapt; the defaults are ours, from what ST3D++ and mean teachers use."""

    clouds: tuple[str, ...] = Field((), description="clouds of the target; by default the first that suits")
    frames: int = Field(400, ge=0, description="target frames at most, spread evenly; 0 takes all")
    source_frames: int = Field(240, ge=1, description="source frames at most, spread evenly")
    rounds: int = Field(2, ge=1, le=50, description="times that the pseudo labels' teacher is renewed")
    steps: int = Field(
        0, ge=0, description="of all rounds; 0: a quarter of the steps that made the weights, up to 1,000"
    )
    minutes: float = Field(0.0, ge=0, description="fewer steps where these would take longer; 0 sets no limit")
    overrides: tuple[str, ...] = Field(
        (), description="settings of method, training, augmentation, such as method.decay=0.99"
    )
    whole_bodies: bool = Field(
        False,
        description="learn boxes of whole bodies from the source's labels, where the detector's show visible parts",
    )
    donors: int = Field(
        0,
        ge=0,
        le=1000,
        description="copies of each sweep, at most 40,000 in all, in which simulated road users stand and teach",
    )
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _enough_rounds(self) -> "AdaptationOptions":
        if self.whole_bodies and self.rounds < 2:
            raise ValueError(
                "expected 2 rounds or more with whole_bodies: in the first the source's labels teach alone"
            )
        return self

    @field_validator("overrides")
    @classmethod
    def _free(cls, overrides: tuple[str, ...]) -> tuple[str, ...]:
        for override in overrides:
            name = override.partition("=")[0]
            if name in _FIXED or not name.startswith(_OPEN):
                raise ValueError(
                    f"expected a setting of method, training or augmentation other than {', '.join(_FIXED)}; got "
                    f"{override!r}"
                )
        return overrides


def options_of(choices: Mapping[str, Any]) -> AdaptationOptions:
    """Check what was chosen.

    Raises:
        ConfigError: If a setting is unknown or does not fit.
    """
    try:
        return AdaptationOptions.model_validate(dict(choices))
    except ValidationError as error:
        raise ConfigError(f"adapt: {plain(error)}. It has: {', '.join(AdaptationOptions.model_fields)}.") from error


class CalibratedThresholds(PlainSettings):
    """What was measured before the first round, and holds for all of them."""

    settings: dict[str, Any] = Field(description="detector, data and choices that it belongs to")
    positive: dict[str, float]
    negative: dict[str, float]
    measured: tuple[str, ...] = Field(description="classes whose thresholds come from the source's scores")
    source_rate: float = Field(description="confident boxes a sweep of the source")
    steps: int = Field(ge=1, description="of a round")
    step_s: float | None = Field(None, description="time of a step, where it was measured")


def load_thresholds(folder: Path, settings: Mapping[str, Any]) -> CalibratedThresholds | None:
    """Read the thresholds that were measured in a folder; None where there are none.

    Args:
        folder: That of the adaptation.
        settings: What it has to belong to.

    Raises:
        FileFormatError: If the file is damaged.
        ConfigError: If it belongs to another detector, to other data or to other choices.
    """
    path = folder / THRESHOLDS
    if not path.is_file():
        return None
    try:
        thresholds = CalibratedThresholds.model_validate(read_json(path, max_bytes=_LIMIT_BYTES))
    except ValidationError as error:
        raise FileFormatError(
            path,
            where="the file",
            expected="the thresholds of farfield adapt",
            got=plain(error),
            fix="Begin anew with --overwrite.",
        ) from error
    current = json.loads(json.dumps(dict(settings)))
    before = thresholds.settings
    differ = sorted(name for name in {*current, *before} if current.get(name) != before.get(name))
    if differ:
        raise ConfigError(
            f"{folder}: expected what was begun there, found another adaptation: it differs in {', '.join(differ)}. "
            "Name another folder with --out, or begin anew with --overwrite."
        )
    return thresholds


def save_thresholds(folder: Path, thresholds: CalibratedThresholds) -> None:
    """Write the thresholds, whole or not at all."""
    write_text(folder / THRESHOLDS, thresholds.model_dump_json(indent=1) + "\n")
