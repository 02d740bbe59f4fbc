"""The network that finds number plates: points as objects (Zhou et al., 2019, arXiv 1904.07850), 0.3 M parameters.

A stem at stride 2, levels at strides 4, 8 and 16, added again on the way up to stride 4, where each cell holds the
score, the logarithms of width and height in cells, and where in it the centre lies.
"""

import hashlib
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.soundness import unsound
from farfield.errors import FileFormatError
from farfield.files.atomic import read_bytes, write_bytes
from farfield.files.safetensors import check_digest, with_digest

STRIDE, SIDE = 4, 16
MAX_BYTES = 1_000_000
_RARE = -4.6  # logit of a plate in a cell before training: one in a hundred
_COUNTER = "num_batches_tracked"  # of batch norms: not written
_WIDTHS = (16, 24, 48, 64)


class _Layer(nn.Sequential):
    """Convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, *, stride: int = 1, size: int = 3) -> None:
        conv = nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False)
        super().__init__(conv, nn.BatchNorm2d(outputs), nn.ReLU())


class _Block(nn.Module):
    """Two layers with a way around them."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.one, self.two = _Layer(width, width), _Layer(width, width)

    def forward(self, values: Tensor) -> Tensor:
        return values + self.two(self.one(values))


class PlateNetwork(nn.Module):
    """RGB from 0 to 1, shape (b, 3, h, w) with sides that are multiples of 16, to maps of shape (b, 5, h/4, w/4).

    The maps are the logit of a plate's centre, the logarithms of width and height in cells of four pixels, and the
    offset of column and row within the cell.
    """

    def __init__(self) -> None:
        super().__init__()
        stem, fine, middle, coarse = _WIDTHS
        self.stem = _Layer(3, stem, stride=2)
        self.fine = nn.Sequential(_Layer(stem, fine, stride=2), _Block(fine))
        self.middle = nn.Sequential(_Layer(fine, middle, stride=2), _Block(middle))
        self.coarse = nn.Sequential(_Layer(middle, coarse, stride=2), _Block(coarse), _Block(coarse))
        self.to_middle, self.to_fine = _Layer(coarse, middle, size=1), _Layer(middle, fine, size=1)
        self.mix_middle, self.mix_fine = _Layer(middle, middle), _Layer(fine, fine)
        hidden = _Layer(fine, 32)
        output = nn.Conv2d(32, 5, 1)
        output.bias = nn.Parameter(torch.tensor([_RARE, 0.0, 0.0, 0.0, 0.0]))
        self.head = nn.Sequential(hidden, output)

    def forward(self, image: Tensor) -> Tensor:
        """See the class."""
        fine = self.fine(self.stem(image * 4 - 2))
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        middle = self.mix_middle(middle + _doubled(self.to_middle(coarse)))
        fine = self.mix_fine(fine + _doubled(self.to_fine(middle)))
        return torch.as_tensor(self.head(fine))


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="nearest")


def save_network(path: Path, network: PlateNetwork) -> None:
    """Write a network's weights in half precision, with the digest of their file.

    Args:
        path: A ``.safetensors`` file.
        network: The network.
    """
    tensors = {name: value.detach().half().contiguous() for name, value in network.state_dict().items()}
    written = {name: value for name, value in tensors.items() if not name.endswith(_COUNTER)}
    write_bytes(path, with_digest(save(written)))


def load_network(path: Path) -> tuple[PlateNetwork, str]:
    """A network in evaluation mode, and the SHA-256 of its file.

    Raises:
        FileFormatError: If the file is too large, no safetensors file, changed since it was written, or holds other
            tensors than the network has, or numbers that no training leaves.
    """
    data = read_bytes(path, max_bytes=MAX_BYTES)
    try:
        tensors = load(data)
    except SafetensorError as error:
        raise FileFormatError(path, where="header", expected="safetensors", got=str(error)) from error
    check_digest(path, data)
    network = PlateNetwork()
    state = network.state_dict()
    expected = {name: tuple(value.shape) for name, value in state.items() if not name.endswith(_COUNTER)}
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if expected != shapes:
        odd = sorted(set(expected.items()) ^ set(shapes.items()))[0][0]
        raise FileFormatError(path, where=odd, expected=str(expected.get(odd)), got=str(shapes.get(odd)))
    if (fault := unsound(tensors)) is not None:
        raise FileFormatError(path, where=fault[0], expected="numbers as a training leaves them", got=fault[1])
    network.load_state_dict({**state, **{name: tensor.float() for name, tensor in tensors.items()}})
    return network.eval(), hashlib.sha256(data).hexdigest()
