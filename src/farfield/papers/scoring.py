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
from farfield.metrics.deciding import ScoreSample, samples
from farfield.papers.grid import Score, Tree
from farfield.papers.jobs import TrainingJob, code_digest
from farfield.papers.needs import RequiredScore
from farfield.papers.places import DataLocation

_DECIMALS = 7
_NO_INTERVALS = Bootstrap(replicates=0)
_UNKEPT = ("curves", "intervals")
"""Parts of a result that are large and not needed of every seed."""


@dataclass(frozen=True, kw_only=True)
class ScoringTask:
    """How runs are scored.

    Args:
        score: Protocol, settings, ranges by table.
        places: The sets on whose frames runs are scored; frames of all count together.
        fingerprints: What tells their frames.
        needs: The numbers that claims compare.
        replicates: Draws of the sequences.
    """

    score: Score
    places: Mapping[str, DataLocation]
    fingerprints: Mapping[str, str]
    needs: tuple[RequiredScore, ...]
    replicates: int

    @property
    def digest(self) -> str:
        """Hash of all that decides the scores besides the weights."""
        said = [
            self.score.model_dump(mode="json"),
            dict(self.fingerprints),
            sorted(f"{need.run} {need.cloud} {need.name}" for need in self.needs),
            self.replicates,
            code_digest(),
        ]
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def of_job(self, job: TrainingJob, weights: Path) -> Tree:
        """The scores of a job as JSON values."""
        found = dict[str, Any]()
        for cloud in job.clouds:
            seen = self.detections(weights, cloud)
            found[cloud] = {
                "results": self._results(seen, whole=job.seed == 0),
                "samples": self._samples(seen, job, cloud),
            }
        return {"runs": list(job.runs), "seed": job.seed, "key": job.key, "clouds": found}

    def detections(self, weights: Path, cloud: str) -> Detections:
        """What a run's detector finds in all frames; it is kept beside the weights, and not searched for again."""
        detector, several = Detector.load(weights), len(self.places) > 1
        parts = {
            name: detect(
                detector,
                place.opened(),
                cloud=cloud,
                annotated_only=True,
                journal=weights.parent / f"found-{name}-{cloud}.jsonl",
            )
            for name, place in self.places.items()
        }
        return together(parts) if several else next(iter(parts.values()))

    def _results(self, found: Detections, *, whole: bool) -> Tree:
        """The result by table; that of the first seed with its curves."""
        results: Tree = {}
        for table in self.score.tables:
            settings = {**self.score.settings_of(table), "bootstrap": _NO_INTERVALS}
            result = found.score(self.score.protocol, **settings).to_json()
            results[table] = {name: value for name, value in result.items() if whole or name not in _UNKEPT}
        return results

    def _samples(self, found: Detections, job: TrainingJob, cloud: str) -> Tree:
        wanted = [need for need in self.needs if need.run in job.runs and need.cloud == cloud]
        alike: dict[tuple[str, tuple[str, ...]], list[RequiredScore]] = defaultdict(list)
        for need in wanted:
            alike[need.table, need.matched].append(need)
        kept: Tree = {}
        for (table, matched), needs in alike.items():
            drawn = self._drawn(found, table, matched, needs)
            kept |= {name: json_of_sample(sample) for name, sample in drawn.items()}
        return dict(sorted(kept.items()))

    def _drawn(
        self, found: Detections, table: str, matched: tuple[str, ...], needs: Sequence[RequiredScore]
    ) -> dict[str, ScoreSample]:
        settings = self.score.settings_of(table) | _only(self.score.protocol, needs)
        frames = matched_frames(found, matched) if matched else None
        some = found if frames is None else _of_frames(found, frames)
        protocol = PROTOCOLS[self.score.protocol]
        there = protocol.weighted(some.counted(), protocol.settings(some.counted(), **settings)).parts if some else {}
        scalars = {need.name: need.scalar for need in needs if set(need.scalar.parts) <= set(there)}
        if not scalars:
            return {}
        return samples(found, scalars, protocol=protocol, replicates=self.replicates, frames=frames, **settings)


def _only(protocol: str, needs: Sequence[RequiredScore]) -> Tree:
    """Settings that leave out figures which no number needs: draws take their time."""
    if protocol != "dds":
        return {}
    names = {name for need in needs for _, name, _ in need.scalar.terms}
    return {"epsilons": tuple(sorted({float(name.split("/")[1]) for name in names}))}


def together(parts: Mapping[str, Detections]) -> Detections:
    """Detections in several sets as those in one, whose sequences are named by set."""
    first = next(iter(parts.values()))
    boxes: dict[Key, Boxes] = {}
    annotations: dict[Key, Annotation] = {}
    conditions: dict[Key, Mapping[str, str]] = {}
    drives = []
    for name, part in parts.items():
        boxes |= {_named(name, key): each for key, each in part.boxes.items()}
        annotations |= {_named(name, key): each for key, each in part.annotations.items()}
        conditions |= {_named(name, key): each for key, each in part.conditions.items()}
        drives += [
            replace(drive, name=f"{name}: {drive.name}", keys=tuple(_named(name, key) for key in drive.keys))
            for drive in part.drives
        ]
    return replace(
        first, boxes=boxes, annotations=annotations, conditions=conditions, drives=tuple(drives), prediction_details={}
    )


def _named(name: str, key: Key) -> Key:
    return f"{name}: {key[0]}", key[1]


def matched_frames(found: Detections, parts: Sequence[str]) -> set[Key]:
    """Frames of two conditions, as many of each with every number of annotated objects.

    Args:
        found: Detections, with the conditions of their frames.
        parts: The two parts, such as ``"weather/overcast"`` and ``"weather/normal"``.
    """
    by_count: dict[int, dict[str, list[Key]]] = defaultdict(lambda: {part: [] for part in parts})
    for key in sorted(found.annotations, key=_by_hash):
        for part in parts:
            kind, _, value = part.partition("/")
            if found.conditions.get(key, {}).get(kind) == value:
                by_count[len(found.annotations[key].boxes)][part].append(key)
    kept: set[Key] = set()
    for frames in by_count.values():
        fewest = min(map(len, frames.values()))
        kept |= {key for keys in frames.values() for key in keys[:fewest]}
    return kept


def _by_hash(key: Key) -> bytes:
    return hashlib.sha256("\0".join(key).encode()).digest()


def _of_frames(found: Detections, frames: set[Key]) -> Detections | None:
    kept = {key: each for key, each in found.annotations.items() if key in frames}
    if not kept:
        return None
    return replace(found, annotations=kept, boxes={key: each for key, each in found.boxes.items() if key in frames})


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


def sample_of(kept: Mapping[str, Any]) -> ScoreSample:
    """Read a sample that was kept as JSON."""
    draws = np.array([np.nan if value is None else value for value in kept["draws"]], dtype=np.float64)
    return ScoreSample(
        value=kept["value"],
        draws=draws,
        drawn=str(kept["drawn"]),
        grouped_by=str(kept["grouped_by"]),
        groups=int(kept["groups"]),
    )
