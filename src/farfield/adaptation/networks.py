"""The networks of an adaptation: one that starts from weights, and one that shares its weights with a first.

What two domains have in common is shared, and each has a head or batch statistics of its own.
"""

import copy
from pathlib import Path

from torch import nn

from farfield.detectors.network import Network
from farfield.detectors.weights import load_weights, resolve_weights
from farfield.errors import ConfigError


def start_from(network: Network, weights: Path | str, method: str) -> None:
    """Give a network the weights of a trained detector.

    Args:
        network: The network, changed in place.
        weights: A bundled detector's name, a run's folder or a weights file.
        method: Name of the method, for messages.

    Raises:
        ConfigError: If they are those of a network of another shape.
        FarfieldError: If there are none.
    """
    trained, _ = load_weights(resolve_weights(weights))
    own_state, trained_state = network.state_dict(), trained.state_dict()
    different = sorted(
        name
        for name in own_state.keys() | trained_state.keys()
        if name not in own_state or name not in trained_state or own_state[name].shape != trained_state[name].shape
    )
    if different:
        raise ConfigError(
            f"method {method}: expected the weights {weights} to be those of the experiment's detector "
            f"({network.config.name}); {len(different)} tensors differ, first {different[0]}. Copy the detector's "
            "settings from the run that made them."
        )
    network.load_state_dict(trained_state)


def with_own_head(network: Network) -> Network:
    """A network with the trunk of another, its statistics included, and a head of its own that begins alike.

    Raises:
        ConfigError: If the network's head is no module.
    """
    twin = copy.copy(network)
    twin._modules = dict(network._modules)
    twin.head = copy.deepcopy(_head(network))
    return twin


def with_own_statistics(network: Network, *, own_head: bool) -> Network:
    """A network with another's parameters, but batch statistics of its own and, with ``own_head``, its own head.

    Statistics by domain, in training and at inference, are DSNorm's (ST3D++, arXiv 2108.06682); scale and shift are
    shared.

    Raises:
        ConfigError: If ``own_head`` is set and the network's head is no module.
    """
    own = {id(parameter) for parameter in _head(network).parameters()} if own_head else set()
    shared = {id(parameter): parameter for parameter in network.parameters() if id(parameter) not in own}
    return copy.deepcopy(network, dict(shared))


def _head(network: Network) -> nn.Module:
    if not isinstance(network.head, nn.Module):
        raise ConfigError(
            f"method: expected a detector whose head is a module, for a head of each domain; that of "
            f"{network.config.name} is not. Take a detector with a map, such as pointpillars or sparsecentre."
        )
    return network.head
