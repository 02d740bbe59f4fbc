"""From a trained detector and a user's unlabelled sweeps to weights for these sweeps: self-training in rounds."""

from farfield.experiments.adapting.job import AdaptationResult, adapt, dry_run
from farfield.experiments.adapting.options import AdaptationOptions

__all__ = ["AdaptationOptions", "AdaptationResult", "adapt", "dry_run"]
