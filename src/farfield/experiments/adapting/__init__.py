"""From a trained detector and a user's unlabelled sweeps to weights for these sweeps: self-training in rounds."""

from farfield.experiments.adapting.adapting import Adapted, adapt
from farfield.experiments.adapting.settings import Choices

__all__ = ["Adapted", "Choices", "adapt"]
