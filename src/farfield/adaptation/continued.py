"""Go on from the weights of another training: pretraining, such as on another device's data, without any adaptation."""

from pydantic import Field

from farfield.adaptation.networks import start_from
from farfield.detectors.network import Network
from farfield.training.method import MethodSettings, Supervised, settings_of


class ContinuedSettings(MethodSettings):
    """Where the training starts."""

    start: str = Field(description="weights of a detector of the same settings: a name, a run's folder or a file")


class ContinuedTraining(Supervised):
    """Train a detector on annotated frames, from the weights of another.

    Args:
        network: The detector's network.
        **settings: See :class:`ContinuedSettings`.

    Raises:
        ConfigError: If the start is missing, or another network's.
    """

    def __init__(self, network: Network, **settings: object) -> None:
        chosen = settings_of(ContinuedSettings, "continued", settings)
        start_from(network, chosen.start, "continued")
        super().__init__(network)
