"""The registry of detectors: the paper of each, and where its configuration and network stand. Needs no torch."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, TypeVar

from farfield.errors import ConfigError, MissingExtraError
from farfield.registry import PluginError, Registry

NetworkClass = TypeVar("NetworkClass", bound=type)


@dataclass(frozen=True, kw_only=True)
class DetectorSpec:
    """One kind of detector; nothing of it is imported before first use.

    Args:
        name: Its name in an experiment's ``detector.name`` and in weights files.
        paper: Where it comes from.
        config: Its configuration, a :class:`~farfield.detectors.config.DetectorConfig`: ``"module:Class"``, or the
            class itself.
        network: Its :class:`~farfield.detectors.network.Network`, likewise.
    """

    name: str
    paper: str
    config: "str | type"
    network: "str | type"

    @property
    def config_class(self) -> Any:
        """The configuration's class, a subclass of ``farfield.detectors.config.DetectorConfig``.

        Raises:
            MissingExtraError: If torch is not installed.
        """
        return _loaded(self.config)

    @property
    def network_class(self) -> Any:
        """The network's class, a subclass of ``farfield.detectors.network.Network``.

        Raises:
            MissingExtraError: If torch is not installed.
        """
        return _loaded(self.network)


def _loaded(target: "str | type") -> Any:
    if not isinstance(target, str):
        return target
    module, _, attribute = target.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except ModuleNotFoundError as error:
        if error.name == "torch":
            raise MissingExtraError("torch", "detect", "Detecting objects") from error
        raise


class Detectors(Registry[DetectorSpec]):
    """Detectors by name."""

    def __getitem__(self, name: str) -> DetectorSpec:
        spec = super().__getitem__(name)
        if not isinstance(spec, DetectorSpec) or spec.name != name:
            raise PluginError(
                f"detector {name!r} of the package {self.origin(name)} cannot be used: expected a "
                f"farfield.detectors.DetectorSpec with name={name!r}, got {spec!r}"
            )
        return spec


DETECTORS = Detectors(
    "farfield.detectors",
    "detector",
    {
        "pointpillars": "farfield.detectors.pointpillars:KIND",
        "pointrcnn": "farfield.detectors.pointrcnn:KIND",
        "rtn": "farfield.detectors.kradar:RTN",
        "rtnh": "farfield.detectors.kradar:RTNH",
        "second": "farfield.detectors.second:KIND",
        "sparsecentre": "farfield.detectors.sparsecentre:KIND",
        "voxelnet": "farfield.detectors.voxelnet:KIND",
    },
)
"""Every detector by name: ours, those that :func:`detector` registered, and those of other packages."""


def detector(name: str, *, config: type, paper: str = "") -> Callable[[NetworkClass], NetworkClass]:
    """A decorator that registers a network in this process, as a notebook does; run again, it replaces it.

    Args:
        name: Its name, the default of its configuration's field ``name``.
        config: Its configuration's class.
        paper: Where it comes from.

    Raises:
        ConfigError: If the name is a built-in one, or not that of the configuration.
    """
    fields = getattr(config, "model_fields", {})
    if "name" not in fields or fields["name"].default != name:
        raise ConfigError(f'detector {name!r}: expected {config.__name__} with the field name: str = "{name}".')
    DETECTORS.register(name)  # refuses the names of built-in detectors
    return partial(_registered, name=name, config=config, paper=paper)


def _registered(network: NetworkClass, *, name: str, config: type, paper: str) -> NetworkClass:
    DETECTORS.register(name)(DetectorSpec(name=name, paper=paper, config=config, network=network))
    return network
