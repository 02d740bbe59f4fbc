"""PointPillars and SECOND of OpenPCDet, written down plainly: dense operations over z, y, x, from its state dict.

An oracle for the import, so nothing here uses the detectors under test. Points are rows x, y, z, intensity.
"""

import numpy as np
import torch
from torch.nn import functional

SIZES = np.array([[3.9, 1.6, 1.56], [0.8, 0.6, 1.73], [1.76, 0.6, 1.73]])
BOTTOMS = np.array([-1.78, -0.6, -0.6])


class Weights(dict):
    """A state dict under construction: tensors of given shapes, drawn at random."""

    def __init__(self, seed):
        super().__init__()
        self.generator = torch.Generator().manual_seed(seed)

    def draw(self, name, *shape, scale=None):
        fan_in = np.prod(shape[1:]) if len(shape) > 1 else 1
        scale = np.sqrt(2 / fan_in) if scale is None else scale
        self[name] = torch.randn(shape, generator=self.generator) * scale

    def norm(self, name, width):
        self[f"{name}.weight"] = torch.rand(width, generator=self.generator) + 0.5
        self[f"{name}.bias"] = torch.randn(width, generator=self.generator) * 0.3
        self[f"{name}.running_mean"] = torch.randn(width, generator=self.generator) * 0.3
        self[f"{name}.running_var"] = torch.rand(width, generator=self.generator) + 0.5
        self[f"{name}.num_batches_tracked"] = torch.tensor(5)

    def bird_eye(self, c_in, widths, depths, upsampling, neck, *, spread):
        for i, (width, depth, up) in enumerate(zip(widths, depths, upsampling, strict=True)):
            for layer in range(depth + 1):
                self.draw(f"backbone_2d.blocks.{i}.{3 * layer + 1}.weight", width, c_in, 3, 3)
                self.norm(f"backbone_2d.blocks.{i}.{3 * layer + 2}", width)
                c_in = width
            self.draw(f"backbone_2d.deblocks.{i}.0.weight", width, neck, up, up, scale=width**-0.5)
            self.norm(f"backbone_2d.deblocks.{i}.1", neck)
        for name, numbers in (("conv_cls", 18), ("conv_box", 42), ("conv_dir_cls", 12)):
            scale = spread if name == "conv_box" else 4 * spread
            self.draw(f"dense_head.{name}.weight", numbers, neck * len(widths), 1, 1, scale=scale)
            self.draw(f"dense_head.{name}.bias", numbers, scale=0.1)
        self["dense_head.conv_cls.bias"] -= 3.5  # few boxes, as after a training


def pillar_weights(seed=0):
    state = Weights(seed)
    state["global_step"] = torch.tensor([12])
    state.draw("vfe.pfn_layers.0.linear.weight", 8, 10)
    state.norm("vfe.pfn_layers.0.norm", 8)
    state.bird_eye(8, (8, 12, 16), (1, 2, 1), (1, 2, 4), 10, spread=0.02)
    return dict(state)


STAGES = [  # name, inputs, outputs, kernel, stride, padding
    ("conv_input", 4, 6, (3, 3, 3), 1, 1),
    ("conv1.0", 6, 6, (3, 3, 3), 1, 1),
    *[(f"conv2.{i}", 8 if i else 6, 8, (3, 3, 3), 1 if i else 2, 1) for i in range(3)],
    *[(f"conv3.{i}", 10 if i else 8, 10, (3, 3, 3), 1 if i else 2, 1) for i in range(3)],
    *[(f"conv4.{i}", 12 if i else 10, 12, (3, 3, 3), 1 if i else 2, 1 if i else (0, 1, 1)) for i in range(3)],
    ("conv_out", 12, 14, (3, 1, 1), (2, 1, 1), 0),
]


def second_weights(seed=0):
    """Kernels as ``conv3d`` has them: (c_out, c_in, z, y, x); see :func:`with_layout`."""
    state = Weights(seed)
    for name, c_in, c_out, kernel, *_ in STAGES:
        state.draw(f"backbone_3d.{name}.0.weight", c_out, c_in, *kernel, scale=(6 / (c_in * np.prod(kernel))) ** 0.5)
        state.norm(f"backbone_3d.{name}.1", c_out)
    state.bird_eye(28, (16, 20), (2, 1), (1, 2), 12, spread=0.001)
    return dict(state)


def with_layout(state, layout):
    """The same weights as a version of spconv stores its kernels."""
    order = {"1.x": (2, 3, 4, 1, 0), "2.x": (0, 2, 3, 4, 1), "2.x native": (2, 3, 4, 0, 1)}[layout]
    return {k: v.permute(order).contiguous() if v.ndim == 5 else v for k, v in state.items()}


def normed(state, name, x, axis=1):
    """Batch normalisation in evaluation mode, and ReLU."""
    shape = [-1 if i == axis else 1 for i in range(x.ndim)]
    weight, bias, mean, var = (
        state[f"{name}.{p}"].view(shape) for p in ("weight", "bias", "running_mean", "running_var")
    )
    return torch.relu((x - mean) / torch.sqrt(var + 1e-3) * weight + bias)


def cells_of(points, low, size, shape):
    """Points by cell (z, y, x), in their order."""
    cells = {}
    for point in points:
        ix, iy, iz = np.floor((point[:3] - low) / size).astype(int)
        if 0 <= iz < shape[0] and 0 <= iy < shape[1] and 0 <= ix < shape[2]:
            cells.setdefault((iz, iy, ix), []).append(point)
    return cells


def pillar_image(state, points, low, size, shape):
    canvas = torch.zeros(1, 8, shape[1], shape[2])
    for (iz, iy, ix), inside in cells_of(points, low, size, shape).items():
        first = np.array(inside[:32])
        centre = low + (np.array([ix, iy, iz]) + 0.5) * size
        rows = np.zeros((32, 10))
        rows[: len(first)] = np.concatenate([first, first[:, :3] - first[:, :3].mean(0), first[:, :3] - centre], 1)
        out = torch.from_numpy(rows).float() @ state["vfe.pfn_layers.0.linear.weight"].T
        canvas[0, :, iy, ix] = normed(state, "vfe.pfn_layers.0.norm", out).max(0).values
    return canvas


def second_image(state, points, low, size, shape):
    value, occupied = torch.zeros(1, 4, *shape), torch.zeros(1, 1, *shape)
    for cell, inside in cells_of(points, low, size, shape).items():
        value[(0, slice(None), *cell)] = torch.from_numpy(np.array(inside[:5]).mean(0)).float()
        occupied[(0, 0, *cell)] = 1
    for name, _, _, kernel, stride, padding in STAGES:
        value = functional.conv3d(value, state[f"backbone_3d.{name}.0.weight"], stride=stride, padding=padding)
        if stride != 1:
            occupied = functional.conv3d(occupied, torch.ones(1, 1, *kernel), stride=stride, padding=padding)
            occupied = (occupied > 0).float()
        value = normed(state, f"backbone_3d.{name}.1", value) * occupied
    return value.flatten(1, 2)


def heads(state, image, strides):
    """Class, box and direction outputs of each anchor, shapes (ny, nx, 6, 3), (ny, nx, 6, 7), (ny, nx, 6, 2)."""
    ups = []
    for i, stride in enumerate(strides):
        layer = 0
        while f"backbone_2d.blocks.{i}.{3 * layer + 1}.weight" in state:
            weight = state[f"backbone_2d.blocks.{i}.{3 * layer + 1}.weight"]
            image = functional.conv2d(image, weight, stride=1 if layer else stride, padding=1)
            image = normed(state, f"backbone_2d.blocks.{i}.{3 * layer + 2}", image)
            layer += 1
        weight = state[f"backbone_2d.deblocks.{i}.0.weight"]
        up = functional.conv_transpose2d(image, weight, stride=weight.shape[2])
        ups.append(normed(state, f"backbone_2d.deblocks.{i}.1", up))
    image, outputs = torch.cat(ups, 1), []
    for name in ("conv_cls", "conv_box", "conv_dir_cls"):
        out = functional.conv2d(image, state[f"dense_head.{name}.weight"], state[f"dense_head.{name}.bias"])
        ny, nx = out.shape[2:]
        outputs.append(out[0].permute(1, 2, 0).reshape(ny, nx, 6, -1).double().numpy())
    return outputs


def boxes(codes, directions, range_m):
    """Boxes x, y, z, l, w, h, yaw of each anchor, shape (ny, nx, 6, 7); ``range_m`` is x0, y0, x1, y1."""
    ny, nx = codes.shape[:2]
    out = np.empty((ny, nx, 6, 7))
    xs, ys = np.linspace(range_m[0], range_m[2], nx), np.linspace(range_m[1], range_m[3], ny)
    for iy, ix, slot in np.ndindex(ny, nx, 6):
        length, width, height = SIZES[slot // 2]
        xt, yt, zt, lt, wt, ht, rt = codes[iy, ix, slot]
        diagonal = np.hypot(length, width)
        angle = rt + (0.0, 1.57)[slot % 2]
        turned = angle - 0.78539
        turned -= np.floor(turned / np.pi) * np.pi
        yaw = turned + 0.78539 + np.pi * directions[iy, ix, slot].argmax()
        z = zt * height + BOTTOMS[slot // 2] + height / 2
        size = length * np.exp(lt), width * np.exp(wt), height * np.exp(ht)
        out[iy, ix, slot] = (xt * diagonal + xs[ix], yt * diagonal + ys[iy], z, *size, yaw)
    return out
