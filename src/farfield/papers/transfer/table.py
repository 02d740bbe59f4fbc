"""The declared table of transfer: worlds, rows, comparisons, and the trainings that they come to."""

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from farfield.errors import ConfigError
from farfield.experiments.schema import experiment_of
from farfield.papers.claims.schema import DeclaredModel, read_declared
from farfield.papers.grid import Score, SimulatedSet, Tree
from farfield.papers.jobs import TrainingJob

FILE = Path(__file__).parent / "kradar.yaml"
CLOUD = "radar"
_Share = Annotated[float, Field(gt=0, le=1)]


class World(DeclaredModel):
    """A radar on its roads: the sets to train and score on, and the form in which its clouds come."""

    words: str
    train: SimulatedSet
    val: SimulatedSet
    of: str = Field("", description="the world whose data it reads in a form of its own, else its own data")
    options: Tree = Field(default_factory=dict, description="options of the reader")
    floor_options: Tree = Field(default_factory=dict, description="the same where the floor is taken: all cells")
    form: Tree = Field(description="settings of common_radar; the floor is taken of the training set unless given")


class AblationRow(DeclaredModel):
    """A row of the table: a training in a world for each share of its frames, once a seed."""

    words: str
    world: str
    start: str = Field("", description="the row, of the same seed and with all frames, whose weights it starts from")
    shares: tuple[_Share, ...] | None = Field(None, description="all of the table's unless given")
    flip: float = Field(0.5, ge=0, le=1)
    drop_doppler: float = Field(0.0, ge=0, le=1)
    reestimate_batches: int = Field(0, ge=0, description="estimate the batch statistics anew before the first step")
    freeze: tuple[str, ...] = Field((), description="parts of the network that stay as they came")
    steps: int | None = Field(None, ge=0, description="all of the table's unless given; 0: scored as it came")


class TransferComparison(DeclaredModel):
    """Two rows, of which the first is claimed to lie above the second, at every share that both have."""

    id: str
    words: str
    a: str
    b: str


class TransferTable(DeclaredModel):
    """The whole file."""

    words: str
    seeds: int = Field(ge=1)
    shares: tuple[_Share, ...] = Field(min_length=1)
    metric: str
    score: Score
    replicates: int = Field(ge=2)
    floor_frames: int = Field(ge=1, description="frames of the training set that the floor is taken of")
    network: Tree
    training: Tree
    augmentation: Tree = Field(default_factory=dict)
    worlds: dict[str, World]
    rows: dict[str, AblationRow]
    comparisons: tuple[TransferComparison, ...]

    @model_validator(mode="after")
    def _check_names(self) -> "TransferTable":
        for name, row in self.rows.items():
            source = self.rows.get(row.start)
            if row.world not in self.worlds:
                raise ValueError(f"{name}: expected a world among {', '.join(self.worlds)}; got {row.world!r}")
            if row.start and (source is None or source.start or 1.0 not in self.shares_of(row.start)):
                raise ValueError(f"{name}: expected to start from a row of all frames that starts from none")
            if row.steps == 0 and not row.start:
                raise ValueError(f"{name}: expected a row without steps to start from another")
        for name, world in self.worlds.items():
            other = self.worlds.get(world.of, world)
            if (world.of and world.of not in self.worlds) or (world.train, world.val) != (other.train, other.val):
                raise ValueError(f"{name}: expected the data of another world, train and val alike; got {world.of!r}")
        for comparison in self.comparisons:
            unknown = [name for name in (comparison.a, comparison.b) if name not in self.rows]
            if unknown:
                raise ValueError(
                    f"{comparison.id}: expected rows among {', '.join(self.rows)}; got {', '.join(unknown)}"
                )
        return self

    def shares_of(self, row: str) -> tuple[float, ...]:
        """The shares of the target's frames that a row has."""
        return self.rows[row].shares or self.shares

    @property
    def row_shares(self) -> list[tuple[str, float]]:
        """All rows at all their shares: the runs of a seed."""
        return [(row, share) for row in self.rows for share in self.shares_of(row)]

    @property
    def every_share(self) -> tuple[float, ...]:
        """All shares that some row has, in order."""
        return tuple(sorted({share for row in self.rows for share in self.shares_of(row)}))

    def frames_of(self, row: str, share: float) -> int:
        """Number of frames of its world that a row reads at a share of it, complete sequences."""
        declared = self.rows[row]
        train = self.worlds[declared.world].train
        frames = math.floor(share * train.sequences + 0.5) * train.frames
        return frames if declared.steps != 0 else min(frames, declared.reestimate_batches * self.training["batch_size"])

    def row_words(self, row: str) -> str:
        """A row and its world, in words."""
        return f"{self.rows[row].words} ({self.worlds[self.rows[row].world].words})"

    def set_name(self, world: str, part: str) -> str:
        """Folder of a world's ``"train"`` or ``"val"`` set."""
        return f"{self.worlds[world].of or world}-{part}"

    @property
    def digest(self) -> str:
        """Hash of everything that is declared."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


def transfer_jobs(
    table: TransferTable, data: Path, runs: Path, seeds: tuple[int, ...] | None = None
) -> list[TrainingJob]:
    """The trainings of the table, seed by seed; a job's key is its share of its world's sequences, in percent.

    Args:
        table: The table.
        data: Folder of the worlds' sets.
        runs: Folder of all jobs' folders.
        seeds: Those of the table unless given.
    """
    return [
        _job(table, row, share, seed, data, runs)
        for seed in (range(table.seeds) if seeds is None else seeds)
        for row, share in table.row_shares
    ]


def _job(table: TransferTable, name: str, share: float, seed: int, data: Path, runs: Path) -> TrainingJob:
    row = table.rows[name]
    folder, start = f"s{seed}-{name}-{_percent(share)}", f"s{seed}-{row.start}-{_percent(1.0)}" if row.start else ""
    training: Tree = {**table.training, "seed": seed}
    if row.steps is not None:
        training["steps"] = row.steps
    if start:
        training["start"] = {"weights": str(runs / start / "weights.safetensors")}
        if row.reestimate_batches:
            training["start"]["statistics"] = {"reestimate_batches": row.reestimate_batches}
        if row.freeze:
            training["start"]["freeze"] = row.freeze
    tree = {
        "name": folder,
        "data": {
            "path": str(data / table.set_name(row.world, "train")),
            "clouds": [CLOUD],
            "part": (0.0, share),
            "options": table.worlds[row.world].options,
        },
        "detector": table.network,
        "augmentation": {**table.augmentation, "flip_probability": row.flip},
        "training": training,
    }
    return TrainingJob(
        runs=(name,),
        seed=seed,
        experiment=experiment_of(tree, where=folder),
        key=_percent(share),
        clouds=(CLOUD,),
        start=start,
        network=table.worlds[row.world].of or row.world,
    )


def _percent(share: float) -> str:
    return f"{round(100 * share):03d}"


def share_of(job: TrainingJob) -> float:
    """Share of its world's sequences that a job learns from."""
    data = job.experiment.data
    assert not isinstance(data, dict), "a row learns from one set"
    return data.part[1]


def load_table(path: Path = FILE, changes: Mapping[str, Any] | None = None) -> TransferTable:
    """Read the declared table.

    Args:
        path: The file.
        changes: Keys of the file that are replaced.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it declares something that is not there.
    """
    if not path.is_file():
        raise ConfigError(f"transfer: expected a declared table, found no file {path}")
    return read_declared(path, TransferTable, "a declared table", changes)[0]
