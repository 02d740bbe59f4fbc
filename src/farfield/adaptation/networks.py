"""A second network that shares weights with a first: what two domains have in common, and what each has of its own."""

import copy

from torch import nn

from farfield.detectors.network import Network
from farfield.errors import ConfigError


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
    """A network with the parameters of another, but batch statistics of its own, and, if asked for, its own head.

    Statistics by domain, in training and at inference, are DSNorm's (ST3D++, arXiv 2108.06682); scale and shift are
    shared.

    Raises:
        ConfigError: If its own head is asked for and the network's head is no module.
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
