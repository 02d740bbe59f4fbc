"""PointRCNN (Shi, Wang and Li, CVPR 2019, arXiv 1812.04244) at long range.

Stage 1 (section 3.1 and 3.2): PointNet++ -> every point is foreground or not, and every foreground point proposes a
box in bins. Stage 2 (3.3 and 3.4): the points around each proposal, in its own frame -> confidence and refined box.

Differences from the paper, each for long range or for many classes: points and proposals are chosen by budgets for
bands of range and nothing is dropped beyond 80 m; one network tells all classes apart, so that a foreground score and
a mean size belong to each class; near centres count as well as overlap where proposals are matched; and the second
stage also reads the proposal's size.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple, cast

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn
from torch.nn import functional

from farfield.detectors.config import BoxWeights, Channels, DetectorConfig
from farfield.detectors.devices import constant
from farfield.detectors.features import PointFeatures, in_type_of
from farfield.detectors.inputs import POSITION, CloudInput
from farfield.detectors.losses import focal_loss, normaliser, sum_over_processes
from farfield.detectors.network import ClassRows, InputColumns, Network
from farfield.detectors.nms import boxes_after_nms
from farfield.detectors.pointrcnn.boxes import (
    UNSURE_POINT,
    BinCoder,
    BinConfig,
    MatchConfig,
    PointAssigner,
    PointTargets,
    ProposalConfig,
    centres_in,
    draw_proposals,
    first_candidates,
    join_targets,
    keep_proposals,
    match_proposals,
    owners_of,
    shaken_boxes,
)
from farfield.detectors.pointrcnn.pointnet import (
    BackboneConfig,
    FeaturePropagation,
    PointNet2,
    SetAbstraction,
    SetAbstractionConfig,
    SharedMlp,
    Widths,
    pool_group,
)
from farfield.detectors.pointrcnn.points import (
    BandConfig,
    Groups,
    WindowConfig,
    content_rank,
    farthest_points,
    frame_rows,
    in_roi_frames,
    points_in_rois,
    sample_bands,
)
from farfield.geometry.boxes import Boxes
from farfield.vocabulary.classes import CIRRUS_SIZES_M

# The second stage of PointRCNN (section 3.3 and 3.4): the points of a proposal to its confidence and a refined box.


class RefinementConfig(BaseModel):
    """The second stage."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    context_m: float = Field(1.0, ge=0, description="proposals grow by this at every face before they take points")
    points: int = Field(128, ge=1, le=4096, description="points of a proposal")
    local_widths: Widths = Field(
        (64, 64), description="channels of the layers that see a proposal's points in its own axes"
    )
    merged_width: Channels = Field(64, description="channels of both kinds of features joined")
    levels: tuple[SetAbstractionConfig, ...] = Field(
        (SetAbstractionConfig(centres=32, radii_m=(0.6,), limits=(16,), widths=((64, 96),)),),
        description="set abstractions within a proposal",
    )
    pooled_widths: Widths = Field((128, 192), description="channels of the layers that pool a proposal")
    head_widths: Widths = Field((128, 128), description="channels of the layers that give score and box")
    norm: bool = Field(True, description="batch normalisation; published without")
    bins: BinConfig = BinConfig(scope_m=1.5, bin_m=0.5, headings=9, heading_span_rad=float(np.pi / 2))
    match: MatchConfig = MatchConfig()


class Refinement(nn.Module):
    """Stage 2: from the points of each proposal to logits by class and a box in bins (section 3.4, figure 2 b).

    Args:
        c_in: Semantic features a point.
        classes: Number of classes.
        config: The stage.
    """

    def __init__(self, c_in: int, classes: int, config: RefinementConfig) -> None:
        super().__init__()
        self.config = config
        norm = config.norm
        # local x, y, z, the proposal's size, range, and the foreground score of each class
        self.local = SharedMlp((7 + classes, *config.local_widths), norm=norm)
        self.merge = SharedMlp((c_in + config.local_widths[-1], config.merged_width), norm=norm)
        channels, levels = config.merged_width, []
        for level in config.levels:
            levels.append(SetAbstraction(channels, level, norm=norm))
            channels = levels[-1].channels
        self.levels = nn.ModuleList(levels)
        self.pool = SharedMlp((3 + channels, *config.pooled_widths), norm=norm)
        widths = (config.pooled_widths[-1], *config.head_widths)
        self.confidence = nn.Sequential(SharedMlp(widths, norm=norm), nn.Linear(widths[-1], classes))
        self.box = nn.Sequential(SharedMlp(widths, norm=norm), nn.Linear(widths[-1], config.bins.numbers))

    def forward(self, local: Tensor, extra: Tensor, semantic: Tensor, lengths: list[int]) -> tuple[Tensor, Tensor]:
        """Logits (m, classes) and codes (m, numbers) of m proposals.

        Args:
            local: Points in the frames of their proposals, metres, shape (p, 3), proposal after proposal.
            extra: What else is known of each point, shape (p, 4 + classes).
            semantic: Its features of the first stage, shape (p, c_in).
            lengths: Points of each proposal; may be 0.
        """
        rows = self.local(torch.cat([local, extra], 1))
        rows = self.merge(torch.cat([semantic.to(rows.dtype), rows], 1))
        for level in self.levels:
            chosen, counts = farthest_points(local, lengths, cast(SetAbstraction, level).config.centres)
            centres = local[chosen]
            rows, local, lengths = level(local, rows, lengths, centres, counts), centres, counts
        owner = frame_rows(lengths, local.device)
        everything = Groups(owner, torch.arange(len(owner), device=local.device), len(lengths))
        pooled = pool_group(self.pool, everything, local, rows)
        return self.confidence(pooled), self.box(pooled)


_COLUMNS = {"intensity": "intensity", "lag": "lag_s"}
Metres = Annotated[float, Field(gt=0)]


def _level(centres: int, radii_m: tuple[float, ...], *widths: tuple[int, ...]) -> SetAbstractionConfig:
    limits = (16, 32)[: len(radii_m)]
    return SetAbstractionConfig(centres=centres, radii_m=radii_m, limits=limits, widths=widths)


def cirrus_backbone() -> BackboneConfig:
    """Four levels as published, with radii that follow the spacing of their centres over 250 m x 100 m."""
    levels = (
        _level(4096, (0.3, 1.0), (16, 16, 32), (32, 32, 64)),
        _level(1024, (1.0, 3.0), (64, 64, 96), (64, 64, 96)),
        _level(256, (3.0, 8.0), (96, 96, 128), (96, 96, 128)),
        _level(64, (8.0, 20.0), (128, 128, 192), (128, 128, 192)),
    )
    return BackboneConfig(levels=levels, propagation=((128, 128), (128, 128), (192, 192), (256, 256)))


class PointRCNNConfig(DetectorConfig):
    """Everything that decides the shape of the network and its boxes."""

    old_names: ClassVar[Mapping[str, str]] = {"window": "grid"}

    name: str = "pointrcnn"
    grid: WindowConfig = WindowConfig()
    sizes_m: dict[str, tuple[Metres, Metres, Metres]] = Field(
        default_factory=lambda: dict(CIRRUS_SIZES_M),
        min_length=1,
        description="mean length, width and height of each class",
    )
    points: int = Field(16384, ge=1, le=1 << 20, description="points of a frame that the network reads")
    bands: BandConfig = BandConfig()
    inputs: tuple[Literal["intensity", "lag", "height", "range"], ...] = Field(
        ("height", "range"), description="what is read of a point beside its place"
    )
    backbone: BackboneConfig = Field(default_factory=cirrus_backbone)
    head_width: Channels = Field(128, description="channels of the head")
    bins: BinConfig = BinConfig(scope_m=4.0, bin_m=0.5, headings=12)
    foreground_margin_m: float = Field(0.05, ge=0, description="boxes grow by this before they claim points")
    unsure_margin_m: float = Field(0.2, ge=0, description="points this far outside a box are ignored")
    balance: float = Field(0.5, ge=0, le=1, description="1: boxes weigh alike; 0: points do, as published")
    proposals: ProposalConfig = ProposalConfig()
    refinement: RefinementConfig = RefinementConfig()

    @property
    def class_names(self) -> tuple[str, ...]:
        """The classes that have a mean size."""
        return tuple(self.sizes_m)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the points that the network reads."""
        return (*POSITION, *(_COLUMNS[name] for name in self.inputs if name in _COLUMNS))

    @property
    def reach_m(self) -> float:
        """How far ahead the detector looks, metres."""
        return self.grid.range_m


_BY_CLASS = ("segmentation", "refinement.confidence")  # a perceptron and a linear layer with a row for each class


class Stages(NamedTuple):
    """Raw outputs of both stages; points and proposals are listed frame after frame.

    Args:
        lengths: Chosen points of each frame, shape (b,), on the host.
        rows: Row of each chosen point in its cloud, shape (n,).
        xyz: Its coordinates, shape (n, 3).
        logits: Foreground logits by class, shape (n, classes).
        codes: Proposed box of each point in bins, shape (n, numbers).
        proposal_lengths: Proposals of each frame, shape (b,), on the host.
        proposals: Proposals x, y, z, length, width, height, yaw, shape (m, 7).
        kinds: Their class numbers, shape (m,).
        confidences: Logits of the second stage by class, shape (m, classes).
        refinements: Refined boxes in bins, shape (m, numbers).
    """

    lengths: Tensor
    rows: Tensor
    xyz: Tensor
    logits: Tensor
    codes: Tensor
    proposal_lengths: Tensor
    proposals: Tensor
    kinds: Tensor
    confidences: Tensor
    refinements: Tensor


class PointRCNN(Network):
    """The network: its outputs are those of both stages."""

    low_precision: ClassVar[tuple[str, ...]] = ("backbone", "segmentation", "generation", "refinement")
    sizes_m: Tensor

    def __init__(self, config: PointRCNNConfig | None = None) -> None:
        config = config or PointRCNNConfig()
        super().__init__(config)
        self.inputs = {"points": CloudInput(columns=config.columns)}
        classes = len(config.sizes_m)
        self.coder, self.refiner = BinCoder(config.bins), BinCoder(config.refinement.bins)
        self.backbone = PointNet2(len(config.inputs), config.backbone)
        widths = (self.backbone.channels, config.head_width)
        self.segmentation = nn.Sequential(SharedMlp(widths), nn.Linear(config.head_width, classes))
        self.generation = nn.Sequential(SharedMlp(widths), nn.Linear(config.head_width, config.bins.numbers))
        self.refinement = Refinement(self.backbone.channels, classes, config.refinement)
        # Few points are foreground.
        nn.init.constant_(cast(nn.Linear, self.segmentation[-1]).bias, -float(np.log((1 - 0.01) / 0.01)))
        for head in (self.segmentation, self.generation, self.refinement.box):
            nn.init.normal_(cast(nn.Linear, head[-1]).weight, std=0.01)

        self.channels = self.backbone.channels
        self.assigner = PointAssigner(
            class_names=config.class_names,
            margin_m=config.foreground_margin_m,
            unsure_m=config.unsure_margin_m,
            weights=BoxWeights.of(config),
        )

    def class_rows(self) -> ClassRows:
        """The class of each foreground logit and confidence, and of the scores that the second stage reads."""
        names = self.config.class_names
        logits = {f"{part}.1.{kind}": (0, names) for part in _BY_CLASS for kind in ("weight", "bias")}
        return {**logits, "refinement.local.linears.0.weight": (1, (*range(7), *names))}

    def input_columns(self) -> InputColumns:
        """What the first level's perceptrons read, and the last propagation's, which meets the input again."""
        columns, last = tuple(self.config.inputs), len(self.backbone.propagations) - 1
        if not columns:
            return {}
        scales = len(cast(SetAbstraction, self.backbone.abstractions[0]).mlps)
        first = {
            f"backbone.abstractions.0.mlps.{number}.linears.0.weight": (1, ("dx", "dy", "dz", *columns))
            for number in range(scales)
        }
        propagation = cast(FeaturePropagation, self.backbone.propagations[last])
        coarse = tuple(f"coarse {number}" for number in range(propagation.c_coarse))
        return {**first, f"backbone.propagations.{last}.mlp.linears.0.weight": (1, (*coarse, *columns))}

    def encode(self, batch: Mapping[str, list[Tensor]]) -> PointFeatures:
        """Chosen points and their features (section 3.1); ``aux`` holds the row of each in its cloud."""
        clouds = batch["points"]
        rows = [self._choose(cloud) for cloud in clouds]
        points = torch.cat([cloud[row] for cloud, row in zip(clouds, rows, strict=True)])
        lengths, xyz = [len(row) for row in rows], points[:, :3].contiguous()
        features = self.backbone(xyz, self._inputs(points), lengths)
        return PointFeatures(values=features, xyz=xyz, lengths=lengths, aux={"rows": torch.cat(rows)})

    def head(self, features: PointFeatures, targets: Sequence[PointTargets] | None = None) -> Stages:
        """Both stages on the points' features.

        Args:
            features: As :meth:`encode` gives them.
            targets: While training, those of each frame: the second stage then sees proposals of all qualities.
        """
        xyz, lengths, values = features.xyz, list(features.lengths), in_type_of(self.segmentation, features.values)
        logits, codes = self.segmentation(values), self.generation(values)
        with torch.no_grad():
            proposals, kinds, counts = self._propose(xyz, logits.float(), codes, lengths, targets)
        confidences, refinements = self._refine(xyz, values, logits, lengths, proposals, counts)
        return Stages(
            torch.tensor(lengths), features.aux["rows"], xyz, logits, codes,
            torch.tensor(counts), proposals, kinds, confidences, refinements,
        )  # fmt: skip

    def _choose(self, cloud: Tensor) -> Tensor:
        """Rows of the points that the network reads: those in the window, by the budget of each band of range."""
        inside = self.config.grid.rows(cloud)
        return inside[sample_bands(cloud[inside], self.config.bands, self.config.points)]

    def _inputs(self, points: Tensor) -> Tensor | None:
        columns = self.config.columns
        values = {name: points[:, columns.index(column)] for name, column in _COLUMNS.items() if column in columns}
        values["height"] = points[:, 2] / self.config.grid.z_max_m
        values["range"] = torch.hypot(points[:, 0], points[:, 1]) / 100.0
        return torch.stack([values[name] for name in self.config.inputs], 1) if self.config.inputs else None

    def _propose(
        self, xyz: Tensor, logits: Tensor, codes: Tensor, lengths: list[int], targets: Sequence[PointTargets] | None
    ) -> tuple[Tensor, Tensor, list[int]]:
        """Boxes that the second stage looks at, their classes, and how many each frame has."""
        boxes, kinds = [], []
        frames = zip(xyz.split(lengths), torch.sigmoid(logits).split(lengths), codes.split(lengths), strict=True)
        for index, (points, scores, code) in enumerate(frames):
            score, kind = scores.max(1)
            row = first_candidates(points, score, self.config.proposals)
            box = self.coder.decode(code[row], self._reference(points[row], kind[row]))
            rows = keep_proposals(box, self.config.proposals, training=self.training)
            box, kind = box[rows], kind[row][rows]
            if self.training and targets is not None:
                box, kind = self._draw(points, box, kind, targets[index])
            boxes.append(box)
            kinds.append(kind)
        return torch.cat(boxes), torch.cat(kinds), [len(box) for box in boxes]

    def _reference(self, xyz: Tensor, kind: Tensor) -> Tensor:
        """What boxes of stage 1 are relative to: a point, the mean size of its class, no turn; shape (k, 7)."""
        return torch.cat([xyz, self._sizes_m(xyz)[kind], xyz.new_zeros(len(xyz), 1)], 1)

    def _sizes_m(self, like: Tensor) -> Tensor:
        """Mean size of each class, shape (classes, 3)."""
        return constant(tuple(self.config.sizes_m.values()), like.device, like.dtype)

    def _draw(self, xyz: Tensor, boxes: Tensor, kinds: Tensor, target: PointTargets) -> tuple[Tensor, Tensor]:
        """Proposals of a frame to train on, with shaken copies of its boxes; drawn by the content of its cloud."""
        config = self.config.refinement.match
        rng = np.random.default_rng(int(content_rank(xyz).sum()))
        rows = np.concatenate([boxes.cpu().numpy(), shaken_boxes(target.rows, config.shaken, rng)])
        kind = np.concatenate([kinds.cpu().numpy(), np.repeat(target.kind, config.shaken)])
        drawn = draw_proposals(match_proposals(rows, target.rows), config, rng)
        return torch.from_numpy(rows[drawn]).to(boxes), torch.from_numpy(kind[drawn]).to(kinds)

    def _refine(
        self, xyz: Tensor, features: Tensor, logits: Tensor, lengths: list[int], proposals: Tensor, counts: list[int]
    ) -> tuple[Tensor, Tensor]:
        """Pool the points of each proposal, turn them into its frame, and run the second stage (section 3.3)."""
        config = self.config.refinement
        inside = points_in_rois(xyz, lengths, proposals, counts, context_m=config.context_m, limit=config.points)
        proposal, point = proposals[inside.centre], xyz[inside.point]
        local = in_roi_frames(point, proposal)
        range_m = torch.linalg.norm(point, dim=1, keepdim=True)
        scores = torch.sigmoid(logits.detach().float())[inside.point]
        extra = torch.cat([proposal[:, 3:6], range_m / 100.0, scores], 1)
        members = torch.bincount(inside.centre, minlength=len(proposals)).tolist()
        confidences, refinements = self.refinement(local, extra, features.index_select(0, inside.point), members)
        return confidences, refinements

    def _proposal_reference(self, proposals: Tensor, kinds: Tensor) -> Tensor:
        """What boxes of stage 2 are relative to: a proposal's place and heading, the mean size of its class."""
        return torch.cat([proposals[:, :3], self._sizes_m(proposals)[kinds], proposals[:, 6:]], 1)

    def losses(self, outputs: Stages, targets: Sequence[PointTargets]) -> dict[str, Tensor]:
        """Focal loss and bin-based box loss of stage 1, cross-entropy and bin-based box loss of stage 2."""
        segmentation, proposal = self._first_loss(outputs, targets)
        confidence, refinement = self._second_loss(outputs, targets)
        return {"segmentation": segmentation, "proposal": proposal, "confidence": confidence, "refinement": refinement}

    def _first_loss(self, outputs: Stages, targets: Sequence[PointTargets]) -> tuple[Tensor, Tensor]:
        owner = owners_of(targets, outputs.rows, outputs.lengths.tolist())
        boxes, kind, weight = join_targets(targets, outputs.xyz.device)
        positive, unsure = torch.nonzero(owner >= 0)[:, 0], torch.nonzero(owner == UNSURE_POINT)[:, 0]
        box, classes = owner[positive], len(self.config.sizes_m)
        count = torch.bincount(box, minlength=len(boxes)).float()[box]
        mean = sum_over_processes(count.sum()) / sum_over_processes(count.new_tensor(float(len(count)))).clamp(min=1)
        point_weight = weight[box] * (mean / count) ** self.config.balance
        total = normaliser(point_weight.sum())
        ignored = (unsure[:, None] * classes + torch.arange(classes, device=unsure.device)).flatten()
        right = positive * classes + kind[box]
        expected = self.coder.encode(boxes[box], self._reference(outputs.xyz[positive], kind[box]))
        box_loss = self.coder.loss(outputs.codes[positive], expected)
        return focal_loss(outputs.logits, right, ignored, weight=point_weight) / total, (
            box_loss * point_weight
        ).sum() / total

    def _second_loss(self, outputs: Stages, targets: Sequence[PointTargets]) -> tuple[Tensor, Tensor]:
        config, device = self.config.refinement.match, outputs.xyz.device
        boxes, kind, weight = join_targets(targets, device)
        parts, first = [], 0
        for target, rows in zip(targets, outputs.proposals.split(outputs.proposal_lengths.tolist()), strict=True):
            boxes_of_frame = rows.cpu().numpy()
            match = match_proposals(boxes_of_frame, target.rows)
            wrong = match.wrong(config) & ~centres_in(boxes_of_frame, target.unsure)
            parts.append((match.box + first, match.right(config), wrong, match.refined(config)))
            first += len(target.rows)
        box, right, wrong, refined = (
            torch.from_numpy(np.concatenate(part)).to(device) for part in zip(*parts, strict=True)
        )
        sure = torch.nonzero(right | wrong)[:, 0]
        labels = torch.zeros(len(right), len(self.config.sizes_m), device=device)
        labels[right, kind[box[right]]] = 1.0
        proposal_weight = torch.ones(len(right), device=device)
        proposal_weight[right] = weight[box[right]]
        error = functional.binary_cross_entropy_with_logits(
            outputs.confidences[sure].float(), labels[sure], reduction="none"
        )
        row = torch.nonzero(refined)[:, 0]
        reference = self._proposal_reference(outputs.proposals[row], outputs.kinds[row])
        loss = self.refiner.loss(outputs.refinements[row], self.refiner.encode(boxes[box[row]], reference))
        share = weight[box[row]]
        return (
            (error.sum(1) * proposal_weight[sure]).sum() / normaliser(error.new_tensor(float(len(sure)))),
            (loss * share).sum() / normaliser(share.sum()),
        )

    def decode(self, outputs: Stages) -> list[Boxes]:
        """The refined boxes of each frame after suppression, best first."""
        boxes = self.refiner.decode(outputs.refinements, self._proposal_reference(outputs.proposals, outputs.kinds))
        counts = outputs.proposal_lengths.tolist()
        scores = torch.sigmoid(outputs.confidences.float())
        return [self._boxes(*frame) for frame in zip(boxes.split(counts), scores.split(counts), strict=True)]

    def _boxes(self, rows: Tensor, scores: Tensor) -> Boxes:
        config, (score, kind) = self.config, scores.max(1)
        score, order = torch.sort(score, descending=True, stable=True)
        best = order[: int((score >= config.score_threshold).sum())]
        return boxes_after_nms(
            rows[best].double(), score[: len(best)], kind[best], config.class_names,
            iou_threshold=config.nms_iou, limit=config.max_boxes,
        )  # fmt: skip
