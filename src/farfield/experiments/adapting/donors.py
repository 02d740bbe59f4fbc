"""The user's own sweeps with simulated road users in them: exact labels before the background that is to be learnt."""

from typing import TYPE_CHECKING

import numpy as np

from farfield.datasets import Dataset
from farfield.errors import ConfigError, DatasetError
from farfield.experiments.schema import DataConfig
from farfield.simulation.donor_frames import DonorConfig, DonorFrames
from farfield.vocabulary.classes import UNSURE

if TYPE_CHECKING:
    from farfield.detectors.runtime import Detector

_MOST = 40_000  # frames
_COPIES_TRIED = 8
_COLUMNS = ("x_m", "y_m", "z_m", "intensity", "lag_s")  # of a pasted body; its lag is 0


def donor_frames(config: DataConfig, frames: Dataset, *, copies: int, seed: int) -> tuple[DataConfig, DonorFrames]:
    """Settings and frames of the stream; annotations of the sweeps are not looked at.

    Args:
        config: Settings of the sweeps' own stream.
        frames: The sweeps.
        copies: Frames made of each, 40,000 in all at most.
        seed: Another seed draws other road users and places.
    """
    donors = DonorConfig(copies=max(1, min(copies, _MOST // len(frames))), annotations=False, seed=seed)
    cloud = config.clouds[0] if isinstance(config.clouds, tuple) else next(iter(config.clouds.values()))[0]
    return config.model_copy(update={"clouds": (cloud,), "donors": donors}), DonorFrames(frames, donors, cloud)


def check_donors(donors: Dataset, detector: "Detector") -> None:
    """See that simulated road users can stand in the sweeps, and that the detector reads what comes of it.

    Raises:
        ConfigError: If the detector reads a column that pasted bodies do not have, or the sweeps are not in their
            sensor's axes.
        DatasetError: If no simulated road user has a point in the first sweep's first copies.
    """
    (columns,) = (cloud.columns for cloud in detector.network.inputs.values())
    if further := [name for name in columns if name not in _COLUMNS]:
        raise ConfigError(
            f"--donors: expected a detector that reads x, y, z, intensity and lag; it reads {', '.join(further)} too, "
            "which simulated road users in your sweeps do not have. Leave --donors out."
        )
    for copy in range(min(_COPIES_TRIED, len(donors))):
        annotation = donors.annotation(copy)
        if annotation is not None and (np.asarray(annotation.boxes.label) != UNSURE).any():
            return
    raise DatasetError(
        f"{donors.root}: expected ground on which simulated road users can stand, found no room for any in "
        f"{_COPIES_TRIED} trials. z has to point up and the sensor to stand at the origin; or leave --donors out."
    )
