"""RTNH of K-Radar's kit: checkpoints of its layout with random numbers, and what its layers compute, densely.

Written from the kit's source (models/pre_processor/rdr_sparse_processor.py, models/backbone_3d/rdr_sp_pw.py,
models/head/rdr_spcube_head.py and anchor_head.py, configs/cfg_RTNH.yml and cfg_RTNH_wide.yml) as an oracle: nothing
here uses the detectors under test. Maps run over z, y, x.
"""

import math

import numpy as np
import torch
from torch.nn import functional

ORDERS = {"1.x": (2, 3, 4, 1, 0), "2.x": (0, 2, 3, 4, 1), "2.x native": (2, 3, 4, 0, 1)}
HEADS = {  # outputs of each convolution by the number of classes
    "published": {"conv_cls": lambda k: 1 + 2 * k, "conv_reg": lambda k: 16 * k},
    "wide": {"conv_cls": lambda k: 2 * k * k, "conv_box": lambda k: 14 * k, "conv_dir_cls": lambda k: 4 * k},
}
SEDAN, BUS = (4.2, 2.1, 2.0), (9.5, 3.2, 3.7)


class KitRTNH:
    """Weights in the layout of conv3d, and the forward pass that they stand for.

    Args:
        form: ``published`` (cfg_RTNH.yml) or ``wide`` (cfg_RTNH_wide.yml).
        layers: Cells along z; 20 and 24 in the kit's regions.
        widths: Of the stages.
        neck: Channels of each in the bird's-eye map.
        classes: Of the head.
        input: Numbers of each point.
        seed: Of the numbers.
    """

    def __init__(self, form, *, layers, widths=(64, 128, 256), neck=256, cell=32, classes=None, input=4, seed=0):
        self.form, self.layers, self.widths, self.input = form, layers, widths, input
        self.classes = classes or (1 if form == "published" else 2)
        self.generator = torch.Generator().manual_seed(seed)
        self.state, inputs = {}, input
        if form == "wide":
            self._draw("pre_processor.simplified_pointnet.weight", cell, input)
            inputs = cell
        self._conv("backbone.input_conv", widths[0], inputs, 1, 1, 1)
        before, depth = widths[0], layers
        for i, width in enumerate(widths):
            self._conv(f"backbone.spconv{i}", width, before, 3, 3, 3)
            self._norm(f"backbone.bn{i}", width)
            for letter in "ab":
                self._conv(f"backbone.subm{i}{letter}", width, width, 3, 3, 3)
                self._norm(f"backbone.bn{i}{letter}", width)
            self._conv(f"backbone.toBEV{i}", width, width, depth >> i, 1, 1)
            self._norm(f"backbone.bnBEV{i}", width)
            self._draw(f"backbone.convtrans2d{i}.weight", width, neck, 3 * 2**i, 3 * 2**i, fan=9 * width)
            self._draw(f"backbone.convtrans2d{i}.bias", neck)
            self._norm(f"backbone.bnt{i}", neck)
            before = width
        for name, outputs in HEADS[form].items():
            self._draw(f"head.{name}.weight", outputs(self.classes), neck * len(widths), 1, 1)
            self._draw(f"head.{name}.bias", outputs(self.classes), fan=100)

    def _draw(self, name, *shape, fan=None):
        fan = fan or (math.prod(shape[1:]) if len(shape) > 1 else 10)
        self.state[name] = torch.randn(shape, generator=self.generator) * fan**-0.5

    def _conv(self, name, c_out, c_in, *kernel):
        self._draw(f"{name}.weight", c_out, c_in, *kernel)
        self._draw(f"{name}.bias", c_out)

    def _norm(self, name, width):
        for part in ("weight", "running_var"):
            self.state[f"{name}.{part}"] = torch.rand(width, generator=self.generator) + 0.5
        for part in ("bias", "running_mean"):
            self._draw(f"{name}.{part}", width)
        self.state[f"{name}.num_batches_tracked"] = torch.tensor(7)

    def saved(self, layout="2.x"):
        """The state dict as a version of spconv keeps it: ``torch.save(network.state_dict(), ...)``."""
        order = ORDERS[layout]
        kept = {k: v.permute(order).contiguous() if v.ndim == 5 else v for k, v in self.state.items()}
        point = self.state["backbone.input_conv.weight"]
        kept["backbone.input_conv.weight"] = self.matrix().reshape(tuple(point.shape[axis] for axis in order))
        return kept

    def matrix(self):
        """What the convolution of one cell multiplies features by, (inputs, outputs).

        spconv sees its stored numbers as a matrix of this shape, whichever axis comes first in its layout.
        """
        weight = self.state["backbone.input_conv.weight"]
        return weight.flatten().view(weight.shape[1], weight.shape[0])

    def cells(self, points, low_m, shape):
        """Features of the cells and which are occupied, (1, c, z, y, x) and (1, 1, z, y, x), in the kit's numbering."""
        share = (points[:, 2::-1].astype(np.float64) - np.array(low_m)[::-1]) / 0.4
        index = np.ceil(share).astype(int) if self.form == "published" else np.floor(share).astype(int)
        features, occupied = torch.zeros(1, 0, *shape), torch.zeros(1, 1, *shape)
        groups = {}
        for cell, point in zip(index, points[:, : self.input], strict=True):
            if (cell >= 0).all() and (cell < shape).all():
                groups.setdefault(tuple(cell), []).append(torch.from_numpy(point).double())
        learned = {cell: self._cell(group) for cell, group in groups.items()}
        features = torch.zeros(1, len(next(iter(learned.values()))), *shape, dtype=torch.float64)
        for cell, values in learned.items():
            features[(0, slice(None), *cell)] = values
            occupied[(0, 0, *cell)] = 1
        return features, occupied.double()

    def _cell(self, group):
        if self.form == "published":
            (row,) = group
        else:
            rows = torch.zeros(4, self.input, dtype=torch.float64)
            rows[: len(group[:4])] = torch.stack(group[:4])
            row = (rows @ self.state["pre_processor.simplified_pointnet.weight"].double().T).amax(0)
        return row @ self.matrix().double() + self.state["backbone.input_conv.bias"].double()

    def outputs(self, points, low_m, shape):
        """What each layer gives, by its name, in float64: behind normalisation and ReLU where it has them."""
        value, occupied = self.cells(points, low_m, shape)
        out, maps = {"input_conv": value}, []
        for i in range(len(self.widths)):
            value, occupied = self._sparse(f"spconv{i}", f"bn{i}", value, occupied, stride=min(i + 1, 2), padding=1)
            out[f"spconv{i}"] = value
            for letter in "ab":
                value, _ = self._sparse(f"subm{i}{letter}", f"bn{i}{letter}", value, occupied, padding=1, kept=True)
                out[f"subm{i}{letter}"] = value
            column, _ = self._sparse(f"toBEV{i}", f"bnBEV{i}", value, occupied)
            out[f"toBEV{i}"] = column
            name, stride = f"backbone.convtrans2d{i}", 2**i
            weight, bias = self._both(name)
            up = functional.conv_transpose2d(column.squeeze(2), weight, bias, stride=stride, padding=stride)
            out[f"convtrans2d{i}"] = self._normed(f"bnt{i}", up)
            maps.append(out[f"convtrans2d{i}"])
        for name in HEADS[self.form]:
            out[name] = functional.conv2d(torch.cat(maps, 1), *self._both(f"head.{name}"))
        return out

    def _both(self, name):
        return self.state[f"{name}.weight"].double(), self.state[f"{name}.bias"].double()

    def _sparse(self, name, norm, value, occupied, *, stride=1, padding=0, kept=False):
        weight, bias = self._both(f"backbone.{name}")
        value = functional.conv3d(value, weight, bias, stride=stride, padding=padding)
        if not kept:
            ones = torch.ones(1, 1, *weight.shape[2:], dtype=torch.float64)
            occupied = (functional.conv3d(occupied, ones, stride=stride, padding=padding) > 0).double()
        return self._normed(norm, value) * occupied, occupied

    def _normed(self, name, value):
        shape = [-1 if axis == 1 else 1 for axis in range(value.ndim)]
        weight, bias, mean, var = (
            self.state[f"backbone.{name}.{part}"].double().view(shape)
            for part in ("weight", "bias", "running_mean", "running_var")
        )
        return torch.relu((value - mean) / torch.sqrt(var + 1e-5) * weight + bias)


def published_boxes(reg, low_m):
    """Boxes x, y, z, l, w, h, yaw of each anchor of the published head, (ny, nx, 2, 7), from ``conv_reg``'s output."""
    _, _, ny, nx = reg.shape
    numbers = reg[0].view(2, 8, ny, nx).permute(2, 3, 0, 1).numpy()
    anchors = np.zeros((ny, nx, 2, 8))
    anchors[..., 0] = (low_m[0] + 0.4 * np.arange(nx) - 0.2)[None, :, None]
    anchors[..., 1] = (low_m[1] + 0.4 * np.arange(ny) - 0.2)[:, None, None]
    anchors[..., 3:6] = SEDAN
    anchors[..., 6:] = [(np.cos(angle), np.sin(angle)) for angle in (0, 1.5708)]
    boxes = anchors + numbers
    return np.concatenate([boxes[..., :6], np.arctan2(boxes[..., 7:], boxes[..., 6:7])], -1)


def wide_boxes(out, low_m, high_m):
    """Boxes of each anchor of OpenPCDet's head as the kit sets it, (ny, nx, 4, 7): Sedan, then Bus or Truck."""
    _, _, ny, nx = out["conv_box"].shape
    codes = out["conv_box"][0].permute(1, 2, 0).reshape(ny, nx, 4, 7).numpy()
    direction = out["conv_dir_cls"][0].permute(1, 2, 0).reshape(ny, nx, 4, 2).argmax(-1).numpy()
    size = np.array([SEDAN, SEDAN, BUS, BUS])
    diagonal = np.hypot(size[:, 0], size[:, 1])
    boxes = np.empty((ny, nx, 4, 7))
    boxes[..., 0] = codes[..., 0] * diagonal + np.linspace(low_m[0], high_m[0], nx)[None, :, None]
    boxes[..., 1] = codes[..., 1] * diagonal + np.linspace(low_m[1], high_m[1], ny)[:, None, None]
    boxes[..., 2] = codes[..., 2] * size[:, 2] - 1.08 + size[:, 2] / 2
    boxes[..., 3:6] = np.exp(codes[..., 3:6]) * size
    turn = codes[..., 6] + np.array([0, 1.57, 0, 1.57]) - 0.78539
    boxes[..., 6] = turn - np.floor(turn / np.pi) * np.pi + 0.78539 + np.pi * direction
    return boxes
