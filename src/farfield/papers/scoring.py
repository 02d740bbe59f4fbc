"""What a trained run scores: figures by part, and the numbers that claims compare under draws of the roads."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.detectors.runtime import Detector
from farfield.evaluation import detect
from farfield.frame import Annotation, Boxes, Key
from farfield.metrics import PROTOCOLS, Bootstrap, Detections
from farfield.metrics.deciding import Scalar, ScoreSample, samples
from farfield.papers.claims import Claim, Claims, ClaimSide
from farfield.papers.grid import ExperimentGrid, Score, Tree
from farfield.papers.jobs import TrainingJob, cloud_of, code_digest
from farfield.papers.locations import DataLocation
from farfield.papers.running import GridScoring

_DECIMALS = 7
_NO_INTERVALS = Bootstrap(replicates=0)
_LARGE = ("curves", "intervals")
"""Parts of a result that are large and not needed of every seed."""


@dataclass(frozen=True, kw_only=True)
class RequiredScore:
    """A number of a run that claims compare.

    Args:
        run: The run.
        cloud: The cloud that it is scored on.
        table: The table whose ranges hold; empty where there are none.
        scalar: The number.
        matched: The two parts whose frames are made alike in their numbers of objects; none: all frames count.
    """

    run: str
    cloud: str
    table: str
    scalar: Scalar
    matched: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Its key among a run's samples of a cloud."""
        matched = f"; matched {', '.join(self.matched)}" if self.matched else ""
        return f"{self.table}: {self.scalar}{matched}"


def needs_of(claims: Claims, grid: ExperimentGrid, score: Score) -> list[RequiredScore]:
    """All numbers that claims compare in a protocol's figures, without repetition."""
    needs = (
        need_of(row, claim, metric, claims, grid, score)
        for claim in claims
        for metric in claim.metrics
        if claims.metrics[metric].protocol
        for pair in claim.pairs
        for row in (pair.a, pair.b)
        if row.run in grid.runs
    )
    return list(dict.fromkeys(needs))


def need_of(
    row: ClaimSide, claim: Claim, metric: str, claims: Claims, grid: ExperimentGrid, score: Score
) -> RequiredScore:
    """The number that a row of a claim compares.

    Args:
        row: The row.
        claim: Its claim.
        metric: The metric, unless the row has one of its own.
        claims: All claims.
        grid: The grid.
        score: How runs are scored.
    """
    table = score.table(claim.table)
    return RequiredScore(
        run=row.run,
        cloud=cloud_of(row, grid),
        table=table,
        scalar=row.scalar(claims.metrics[row.metric or metric], score.parts(table)),
        matched=row.parts if row.matched else (),
    )


@dataclass(frozen=True, kw_only=True)
class ScoringTask(GridScoring):
    """How runs are scored.

    Args:
        score: Protocol, settings, ranges by table.
        locations: The sets on whose frames runs are scored; frames of all count together.
        fingerprints: Fingerprint of the frames of each set.
        needs: The numbers that claims compare.
        replicates: Draws of the sequences.
        device: What detects: ``"auto"``, ``"cpu"`` or ``"cuda"``.
    """

    score: Score
    locations: Mapping[str, DataLocation]
    fingerprints: Mapping[str, str]
    needs: tuple[RequiredScore, ...]
    replicates: int
    device: str = "auto"

    @property
    def digest(self) -> str:
        """Hash of all that decides the scores besides the weights."""
        tree = [
            self.score.model_dump(mode="json"),
            dict(self.fingerprints),
            sorted(f"{need.run} {need.cloud} {need.name}" for need in self.needs),
            self.replicates,
            code_digest(),
        ]
        return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()

    def of_job(self, job: TrainingJob, weights: Path) -> Tree:
        """The scores of a job as JSON values."""
        clouds: Tree = {}
        for cloud in job.clouds:
            detections = self.detections(weights, cloud)
            clouds[cloud] = {
                "results": self._results(detections, with_curves=job.seed == 0),
                "samples": self._samples(detections, job, cloud),
            }
        return {"runs": list(job.runs), "seed": job.seed, "key": job.key, "clouds": clouds}

    def detections(self, weights: Path, cloud: str) -> Detections:
        """Detections of a run in all frames; a journal beside the weights keeps them for the next time."""
        detector = Detector.load(weights, device=self.device)
        by_set = {
            name: detect(
                detector,
                location.open(),
                cloud=cloud,
                annotated_only=True,
                journal=weights.parent / f"found-{name}-{cloud}.jsonl",
            )
            for name, location in self.locations.items()
        }
        return merge_sets(by_set) if len(by_set) > 1 else next(iter(by_set.values()))

    def _results(self, detections: Detections, *, with_curves: bool) -> Tree:
        """The result by table."""
        results: Tree = {}
        for table in self.score.tables:
            settings = {**self.score.settings_of(table), "bootstrap": _NO_INTERVALS}
            result = detections.score(self.score.protocol, **settings).to_json()
            results[table] = {name: value for name, value in result.items() if with_curves or name not in _LARGE}
        return results

    def _samples(self, detections: Detections, job: TrainingJob, cloud: str) -> Tree:
        """The numbers that claims compare of a job, by name: those of one table and match are drawn together."""
        groups: dict[tuple[str, tuple[str, ...]], list[RequiredScore]] = defaultdict(list)
        for need in self.needs:
            if need.run in job.runs and need.cloud == cloud:
                groups[need.table, need.matched].append(need)
        trees: Tree = {}
        for (table, matched), needs in groups.items():
            drawn = self._draw_samples(detections, table, matched, needs)
            trees |= {name: json_of_sample(sample) for name, sample in drawn.items()}
        return dict(sorted(trees.items()))

    def _draw_samples(
        self, detections: Detections, table: str, matched: tuple[str, ...], needs: Sequence[RequiredScore]
    ) -> dict[str, ScoreSample]:
        settings = self.score.settings_of(table) | _figures_needed(self.score.protocol, needs)
        frames = matched_frames(detections, matched) if matched else None
        some = detections if frames is None else _of_frames(detections, frames)
        protocol = PROTOCOLS[self.score.protocol]
        parts = protocol.weighted(some.counted(), protocol.settings(some.counted(), **settings)).parts if some else {}
        scalars = {need.name: need.scalar for need in needs if set(need.scalar.parts) <= set(parts)}
        if not scalars:
            return {}
        return samples(detections, scalars, protocol=protocol, replicates=self.replicates, frames=frames, **settings)


def _figures_needed(protocol: str, needs: Sequence[RequiredScore]) -> Tree:
    """Settings that leave out figures which no number needs: draws take their time."""
    if protocol != "dds":
        return {}
    names = {name for need in needs for _, name, _ in need.scalar.terms}
    return {"epsilons": tuple(sorted({float(name.split("/")[1]) for name in names}))}


def merge_sets(by_set: Mapping[str, Detections]) -> Detections:
    """Detections in several sets as those in one, whose sequences are named by set."""
    first = next(iter(by_set.values()))
    boxes: dict[Key, Boxes] = {}
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    drives = []
    for name, detections in by_set.items():
        boxes |= {_in_set(name, key): value for key, value in detections.boxes.items()}
        annotations |= {_in_set(name, key): value for key, value in detections.annotations.items()}
        conditions |= {_in_set(name, key): value for key, value in detections.conditions.items()}
        drives += [
            replace(drive, name=f"{name}: {drive.name}", keys=tuple(_in_set(name, key) for key in drive.keys))
            for drive in detections.drives
        ]
    return replace(
        first, boxes=boxes, annotations=annotations, conditions=conditions, drives=tuple(drives), prediction_details={}
    )


def _in_set(name: str, key: Key) -> Key:
    return f"{name}: {key[0]}", key[1]


def matched_frames(detections: Detections, parts: Sequence[str]) -> set[Key]:
    """Frames of two conditions, as many of each with every number of annotated objects, chosen by a hash of their keys.

    Args:
        detections: Detections, with the conditions of their frames.
        parts: The two parts, such as ``"weather/overcast"`` and ``"weather/normal"``.
    """
    by_count: dict[int, dict[str, list[Key]]] = defaultdict(lambda: {part: [] for part in parts})
    for key in sorted(detections.annotations, key=_hash_of):
        for part in parts:
            kind, _, value = part.partition("/")
            if detections.conditions.get(key, {}).get(kind) == value:
                by_count[len(detections.annotations[key].boxes)][part].append(key)
    matched: set[Key] = set()
    for frames in by_count.values():
        fewest = min(map(len, frames.values()))
        matched |= {key for keys in frames.values() for key in keys[:fewest]}
    return matched


def _hash_of(key: Key) -> bytes:
    return hashlib.sha256("\0".join(key).encode()).digest()


def _of_frames(detections: Detections, frames: set[Key]) -> Detections | None:
    annotations = {key: value for key, value in detections.annotations.items() if key in frames}
    if not annotations:
        return None
    boxes = {key: value for key, value in detections.boxes.items() if key in frames}
    return replace(detections, annotations=annotations, boxes=boxes)


def json_of_sample(sample: ScoreSample) -> Tree:
    """A sample as JSON values; :func:`sample_of` reads it."""
    draws = [None if not np.isfinite(value) else round(float(value), _DECIMALS) for value in sample.draws]
    return {
        "value": sample.value,
        "draws": draws,
        "drawn": sample.drawn,
        "grouped_by": sample.grouped_by,
        "groups": sample.groups,
    }


def sample_of(tree: Mapping[str, Any]) -> ScoreSample:
    """Read a sample of JSON values."""
    draws = np.array([np.nan if value is None else value for value in tree["draws"]], dtype=np.float64)
    return ScoreSample(
        value=tree["value"],
        draws=draws,
        drawn=str(tree["drawn"]),
        grouped_by=str(tree["grouped_by"]),
        groups=int(tree["groups"]),
    )
