"""RTNH's layers as K-Radar's kit names and shapes them (github.com/kaist-avelab/K-Radar, code under Apache-2.0).

Facts read from its source at commit 97fe0a6, each cited beside its row; nothing of its code stands here. No real
checkpoint was at hand. A shape is (outputs, inputs, kernel over z, y, x or y, x), in numbers or words of
:class:`KitForm`; how spconv stores it is another matter (:func:`farfield.detectors.checkpoints.stored_shape`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from farfield.detectors.checkpoints import NORM_PARTS, Layout, stored_shape

Sides = tuple[int | str, ...]


@dataclass(frozen=True)
class KitLayer:
    """A layer of the kit with its batch normalisation.

    A batch normalisation is torch's, with eps 1e-5; its counter of batches is not needed.

    Attributes:
        theirs: Its name, with ``{i}`` for the number of a stage.
        ours: The layer of ours.
        kind: ``linear``; ``point``, spconv's convolution of one cell; ``sparse``; ``transposed``; ``head``, a 1 x 1
            convolution.
        sides: Outputs, inputs, and the kernel's sides, as numbers or words.
        norm: Its batch normalisation's names, theirs and ours; empty without one.
        biased: Whether it has a bias.
    """

    theirs: str
    ours: str
    kind: Literal["linear", "point", "sparse", "transposed", "head"]
    sides: Sides
    norm: tuple[str, str] | None = None
    biased: bool = True


# models/pre_processor/rdr_sparse_processor.py: a linear layer without bias, from INPUT_DIM (4; 5 with Doppler) to
# SIMPLIFIED_POINTNET.OUT_CHANNEL, 32 in configs/cfg_RTNH_wide.yml and configs/v1_0/cfg_RTNH.yml
POINTNET = KitLayer(
    "pre_processor.simplified_pointnet", "encoder.linear", "linear", ("cell", "input"), norm=None, biased=False
)

# models/backbone_3d/rdr_sp_pw.py: kernel 1, from INPUT_DIM (configs/cfg_RTNH.yml: 4), or the 32 above, to
# ENCODING.CHANNEL[0] (all three configurations: 64); spconv's layers have a bias unless told otherwise (conv.py there)
INPUT = KitLayer("backbone.input_conv", "encoder.linear", "point", ("first", "cell or input", 1, 1, 1))

# models/backbone_3d/rdr_sp_pw.py, once a stage; ENCODING.CHANNEL 64, 128, 256 is "width", "before" the one before it;
# z extent over 2^i is "depth" (DATASET.RDR_SP_CUBE.ROI and roi.xyz: 20 or 24 layers of 0.4 m); TO_BEV.CHANNEL 256 is
# "neck", TO_BEV.KERNEL_SIZE 3, 6, 12 is "patch"; PADDING 1, STRIDE 1, 2, 2 and TO_BEV.STRIDE 1, 2, 4 are our network's
STAGE: tuple[KitLayer, ...] = (
    KitLayer(
        "backbone.spconv{i}",
        "backbone.stages.{i}.0.conv",
        "sparse",
        ("width", "before", 3, 3, 3),
        norm=("backbone.bn{i}", "backbone.stages.{i}.0.norm"),
    ),
    KitLayer(
        "backbone.subm{i}a",
        "backbone.stages.{i}.1.conv",
        "sparse",
        ("width", "width", 3, 3, 3),
        norm=("backbone.bn{i}a", "backbone.stages.{i}.1.norm"),
    ),
    KitLayer(
        "backbone.subm{i}b",
        "backbone.stages.{i}.2.conv",
        "sparse",
        ("width", "width", 3, 3, 3),
        norm=("backbone.bn{i}b", "backbone.stages.{i}.2.norm"),
    ),
    KitLayer(
        "backbone.toBEV{i}",
        "backbone.to_bev.{i}.conv",
        "sparse",
        ("width", "width", "depth", 1, 1),
        norm=("backbone.bnBEV{i}", "backbone.to_bev.{i}.norm"),
    ),
    KitLayer(
        "backbone.convtrans2d{i}",
        "backbone.neck.layers.{i}.0.conv",
        "transposed",
        ("width", "neck", "patch", "patch"),  # a transposed convolution's inputs come first
        norm=("backbone.bnt{i}", "backbone.neck.layers.{i}.1"),
    ),
)

HEADS: dict[str, tuple[KitLayer, ...]] = {
    # models/head/rdr_spcube_head.py: HEAD.DIM 768 is "map"; a background and two anchors a class; BOX_CODE of 8 numbers
    "softmax": (
        KitLayer("head.conv_cls", "head.classes", "head", ("background and anchors", "map", 1, 1)),
        KitLayer("head.conv_reg", "head.boxes_of_anchors", "head", ("eight numbers an anchor", "map", 1, 1)),
    ),
    # models/head/anchor_head.py: HEAD.INPUT_CHANNELS 768; a logit of each class, 7 numbers, NUM_DIR_BINS 2 an anchor;
    # ours is one convolution
    "anchors": (
        KitLayer("head.conv_cls", "head", "head", ("logits of anchors", "map", 1, 1)),
        KitLayer("head.conv_box", "head", "head", ("seven numbers an anchor", "map", 1, 1)),
        KitLayer("head.conv_dir_cls", "head", "head", ("two directions an anchor", "map", 1, 1)),
    ),
}


@dataclass(frozen=True)
class KitForm:
    """The sizes of one checkpoint.

    Attributes:
        input: Numbers of each point: 4, or 5 with Doppler.
        cell: Outputs of the simplified PointNet; 0 without one.
        first: Outputs of ``input_conv``.
        widths: Of the stages.
        neck: Channels of each stage in the bird's-eye map.
        depth: Layers of cells along z.
        head: The head's form.
        classes: With two anchors each.
        layout: The version of spconv that stored the kernels.
    """

    input: int
    cell: int
    first: int
    widths: tuple[int, ...]
    neck: int
    depth: int
    head: Literal["softmax", "anchors"]
    classes: int
    layout: Layout

    def layers(self) -> Iterator[tuple[KitLayer, Mapping[str, int], int]]:
        """Every layer, in words with its stage's numbers in them, the sizes that its words stand for, and its stage."""
        anchors, map_channels = 2 * self.classes, self.neck * len(self.widths)
        shared = {"input": self.input, "cell": self.cell, "first": self.first, "cell or input": self.cell or self.input}
        head = {
            "map": map_channels,
            "background and anchors": 1 + anchors,
            "eight numbers an anchor": 8 * anchors,
            "logits of anchors": self.classes * anchors,
            "seven numbers an anchor": 7 * anchors,
            "two directions an anchor": 2 * anchors,
        }
        if self.cell:
            yield POINTNET, shared, 0
        yield INPUT, shared, 0
        depth, before = self.depth, self.first
        for i, width in enumerate(self.widths):
            depth = depth if i == 0 else (depth - 1) // 2 + 1
            sizes = {"width": width, "before": before, "depth": depth, "neck": self.neck, "patch": 3 * 2**i}
            for layer in STAGE:
                yield _of_stage(layer, i), sizes, i
            before = width
        for layer in HEADS[self.head]:
            yield layer, head, 0

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of every tensor that a checkpoint of this form has, as its version of spconv stores it."""
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, sizes, _ in self.layers():
            first, second, *kernel = (sizes[side] if isinstance(side, str) else side for side in layer.sides)
            shape: tuple[int, ...] = (first, second, *kernel)
            if layer.kind in ("sparse", "point"):
                z, y, x = kernel
                shape = stored_shape(self.layout, (z, y, x), second, first)
            width = second if layer.kind == "transposed" else first
            shapes[f"{layer.theirs}.weight"] = shape
            if layer.biased:
                shapes[f"{layer.theirs}.bias"] = (width,)
            if layer.norm is not None:
                shapes |= {f"{layer.norm[0]}.{part}": (width,) for part in NORM_PARTS}
        return shapes


def _of_stage(layer: KitLayer, number: int) -> KitLayer:
    norm = None if layer.norm is None else (layer.norm[0].format(i=number), layer.norm[1].format(i=number))
    theirs, ours = layer.theirs.format(i=number), layer.ours.format(i=number)
    return KitLayer(theirs, ours, layer.kind, layer.sides, norm, layer.biased)
