"""Two networks that find number plates: one that proposes boxes, and one that judges each of them.

The first takes points as objects (Zhou et al., 2019, arXiv 1904.07850), 0.3 M parameters: a stem at stride 2, levels at
strides 4, 8 and 16, added again on the way up to stride 4, where each cell holds the score, the logarithms of width and
height in cells, and where in it the centre lies.

The second, 0.2 M parameters, looks at each proposed box and its surroundings, drawn at one size whatever the plate's:
whether there is a plate, and where its edges are (a cascade: Cai & Vasconcelos, 2018, arXiv 1712.00726).
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
PATCH_PX = (40, 80)  # rows and columns of what the judge looks at
_AROUND = 1.8  # how many times as wide as a plate the patch is, or as twice its height
_JUDGE_WIDTHS = (16, 24, 40, 56)
_JUDGE, _FINDER = "judge.", "finder."


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


class PlateJudge(nn.Module):
    """Patches from :func:`cut_patches`, shape (n, 3, 40, 80), to shape (n, 5).

    The columns are the logit of a plate, the shift of the box's centre over its width and height, and the logarithms of
    how many times as wide and high the plate is.
    """

    def __init__(self) -> None:
        super().__init__()
        one, two, three, four = _JUDGE_WIDTHS
        self.features = nn.Sequential(
            _Layer(3, one),
            *(_Layer(one, two, stride=2), _Block(two)),
            *(_Layer(two, three, stride=2), _Block(three)),
            *(_Layer(three, four, stride=2), _Block(four)),
            _Layer(four, 16, size=1),
        )
        rows, columns = (side // 8 for side in PATCH_PX)
        self.head = nn.Sequential(nn.Flatten(), nn.Linear(16 * rows * columns, 48), nn.ReLU(), nn.Linear(48, 5))

    def forward(self, patches: Tensor) -> Tensor:
        """See the class."""
        return torch.as_tensor(self.head(self.features(patches * 4 - 2)))


def halved(pixels: Tensor, times: int) -> list[Tensor]:
    """Pictures of shape (b, 3, h, w) at their own size, half of it, and so on."""
    sizes = [pixels]
    for _ in range(times):
        sizes.append(functional.avg_pool2d(sizes[-1], 2, ceil_mode=True))
    return sizes


def cut_patches(sizes: list[Tensor], picture: Tensor, box_px: Tensor) -> Tensor:
    """What stands in and around boxes, each drawn at the same size.

    Args:
        sizes: From :func:`halved`.
        picture: Number of each box's picture, shape (n,), int.
        box_px: Left, top, right, bottom in pixels of the first size, shape (n, 4).

    Returns:
        Patches, shape (n, 3, 40, 80).
    """
    rows, columns = PATCH_PX
    centre, side = (box_px[:, :2] + box_px[:, 2:]) / 2, box_px[:, 2:] - box_px[:, :2]
    across = torch.maximum(side[:, 0], 2 * side[:, 1]).clamp(min=4.0) * _AROUND
    level = torch.log2(across / columns).round().clamp(0, len(sizes) - 1).long()
    steps_x = (torch.arange(columns, device=box_px.device) + 0.5) / columns - 0.5
    steps_y = ((torch.arange(rows, device=box_px.device) + 0.5) / rows - 0.5) * rows / columns
    patches = box_px.new_zeros((len(box_px), 3, rows, columns))
    for number, pixels in enumerate(sizes):
        mine = torch.nonzero(level == number)[:, 0]
        if not len(mine):
            continue
        height, width = (length * 2**number for length in pixels.shape[2:])
        x = (centre[mine, :1] + across[mine, None] * steps_x) / width * 2 - 1
        y = (centre[mine, 1:] + across[mine, None] * steps_y) / height * 2 - 1
        shape = (len(mine), rows, columns)
        grid = torch.stack([x[:, None, :].expand(shape), y[:, :, None].expand(shape)], dim=-1)
        if len(pixels) == 1:  # all from one picture: as one tall patch
            tall = grid.reshape(1, -1, columns, 2)
            drawn = functional.grid_sample(pixels, tall, padding_mode="border", align_corners=False)
            patches[mine] = drawn[0].reshape(3, *shape).transpose(0, 1)
        else:
            source = pixels[picture[mine]]
            patches[mine] = functional.grid_sample(source, grid, padding_mode="border", align_corners=False)
    return patches


def judged_boxes(box_px: Tensor, judged: Tensor) -> Tensor:
    """Boxes with the edges that the judge says, shape (n, 4)."""
    centre, side = (box_px[:, :2] + box_px[:, 2:]) / 2, box_px[:, 2:] - box_px[:, :2]
    centre = centre + judged[:, 1:3].clamp(-1, 1) * side
    half = side * judged[:, 3:5].clamp(-1.5, 1.5).exp() / 2
    return torch.cat([centre - half, centre + half], dim=1)


def _doubled(values: Tensor) -> Tensor:
    return functional.interpolate(values, scale_factor=2.0, mode="nearest")


def save_networks(path: Path, finder: PlateNetwork, judge: PlateJudge) -> None:
    """Write the weights of both networks in half precision, with the digest of their file.

    Args:
        path: A ``.safetensors`` file.
        finder: Proposes boxes.
        judge: Judges them.
    """
    state = {_FINDER + name: value for name, value in finder.state_dict().items()}
    state |= {_JUDGE + name: value for name, value in judge.state_dict().items()}
    tensors = {name: value.detach().cpu().half().contiguous() for name, value in state.items()}
    written = {name: value for name, value in tensors.items() if not name.endswith(_COUNTER)}
    write_bytes(path, with_digest(save(written)))


def load_networks(path: Path) -> tuple[PlateNetwork, PlateJudge, str]:
    """Both networks in evaluation mode, and the SHA-256 of their file.

    Raises:
        FileFormatError: If the file is too large, no safetensors file, changed since it was written, or holds other
            tensors than the networks have, or numbers that no training leaves.
    """
    data = read_bytes(path, max_bytes=MAX_BYTES)
    try:
        tensors = load(data)
    except SafetensorError as error:
        raise FileFormatError(path, where="header", expected="safetensors", got=str(error)) from error
    check_digest(path, data)
    finder, judge = PlateNetwork(), PlateJudge()
    networks: tuple[tuple[str, nn.Module], ...] = ((_FINDER, finder), (_JUDGE, judge))
    state = {prefix + name: value for prefix, network in networks for name, value in network.state_dict().items()}
    expected = {name: tuple(value.shape) for name, value in state.items() if not name.endswith(_COUNTER)}
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if expected != shapes:
        odd = sorted(set(expected.items()) ^ set(shapes.items()))[0][0]
        raise FileFormatError(path, where=odd, expected=str(expected.get(odd)), got=str(shapes.get(odd)))
    if (fault := unsound(tensors)) is not None:
        raise FileFormatError(path, where=fault[0], expected="numbers as a training leaves them", got=fault[1])
    state |= {name: tensor.float() for name, tensor in tensors.items()}
    for prefix, network in networks:
        own = {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
        network.load_state_dict(own)
    return finder.eval(), judge.eval(), hashlib.sha256(data).hexdigest()
