"""The declared table of transfer: worlds, rows, comparisons, and the runs that they come to."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.papers.grid import Score, SimulatedSet, Tree

FILE = Path(__file__).parent / "kradar.yaml"
_MAX_BYTES = 1 << 20
_Share = Annotated[float, Field(gt=0, le=1)]


class _TransferModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class World(_TransferModel):
    """A radar on its roads: what is learnt from and scored on, and the form in which its clouds come."""

    words: str
    train: SimulatedSet
    val: SimulatedSet
    of: str = Field("", description="the world whose data it sees in a form of its own, else its own data")
    options: Tree = Field(default_factory=dict, description="options of the reader")
    floor_options: Tree = Field(default_factory=dict, description="the same where the floor is taken: all cells")
    form: Tree = Field(description="settings of common_radar; the floor is taken of the training set unless given")


class AblationRow(_TransferModel):
    """A row of the table: a training in a world for each share of its frames, once a seed."""

    words: str
    world: str
    start: str = Field("", description="the row, of the same seed and with all frames, whose weights it starts from")
    shares: tuple[_Share, ...] | None = Field(None, description="all of the table's unless given")
    flip: float = Field(0.5, ge=0, le=1)
    drop_doppler: float = Field(0.0, ge=0, le=1)
    reestimate_batches: int = Field(0, ge=0, description="take the batch statistics anew before the first step")
    freeze: tuple[str, ...] = Field((), description="parts of the network that stay as they came")
    steps: int | None = Field(None, ge=0, description="all of the table's unless given; 0: scored as it came")


class TransferComparison(_TransferModel):
    """Two rows, of which the first is claimed to lie above the second, at every share that both have."""

    id: str
    words: str
    a: str
    b: str


class TransferTable(_TransferModel):
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
    def _names_what_there_is(self) -> "TransferTable":
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
        for each in self.comparisons:
            unknown = [name for name in (each.a, each.b) if name not in self.rows]
            if unknown:
                raise ValueError(f"{each.id}: expected rows among {', '.join(self.rows)}; got {', '.join(unknown)}")
        return self

    def shares_of(self, row: str) -> tuple[float, ...]:
        """The shares of the target's frames that a row has."""
        return self.rows[row].shares or self.shares

    @property
    def every_share(self) -> tuple[float, ...]:
        """All shares that some row has, in order."""
        return tuple(sorted({share for row in self.rows for share in self.shares_of(row)}))

    def frames_of(self, row: str, share: float) -> int:
        """Number of frames of its world that a row sees at a share of it, whole sequences."""
        arm = self.rows[row]
        train = self.worlds[arm.world].train
        frames = math.floor(share * train.sequences + 0.5) * train.frames
        return frames if arm.steps != 0 else min(frames, arm.reestimate_batches * self.training["batch_size"])

    @property
    def digest(self) -> str:
        """Hash of everything that is declared."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class TransferRun:
    """One training.

    Args:
        row: The table's row.
        share: Share of the world's sequences that it learns from.
        seed: Its seed.
    """

    row: str
    share: float
    seed: int

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return f"s{self.seed}-{self.row}-{round(100 * self.share):03d}"


def runs_of(table: TransferTable, seeds: tuple[int, ...] | None = None) -> list[list[TransferRun]]:
    """The runs in two waves, those that others start from and the rest, each seed by seed."""
    chosen = range(table.seeds) if seeds is None else seeds
    sources = {row.start for row in table.rows.values() if row.start}
    every = [
        TransferRun(row=name, share=share, seed=seed)
        for seed in chosen
        for name in table.rows
        for share in table.shares_of(name)
    ]
    first = [run for run in every if run.row in sources and run.share == 1.0]
    return [first, [run for run in every if run not in first]]


def experiment_tree(table: TransferTable, run: TransferRun, *, data: Path, start: Path | None) -> dict[str, Any]:
    """The experiment of a run as its YAML would have it; its frames are given to the training as they are seen.

    Args:
        table: The table.
        run: The run.
        data: Folder of the world's training set.
        start: Weights to start from.
    """
    row, world = table.rows[run.row], table.worlds[table.rows[run.row].world]
    training: dict[str, Any] = {**table.training, "seed": run.seed}
    if row.steps is not None:
        training["steps"] = row.steps
    if start is not None:
        again = {"statistics": {"reestimate_batches": row.reestimate_batches}} if row.reestimate_batches else {}
        training["start"] = {"weights": str(start), **again, **({"freeze": row.freeze} if row.freeze else {})}
    return {
        "name": run.folder,
        "data": {"path": str(data), "clouds": ["radar"], "part": (0.0, run.share), "options": world.options},
        "detector": table.network,
        "augmentation": {**table.augmentation, "flip_probability": row.flip},
        "training": training,
    }


def load_table(path: Path = FILE, changes: Mapping[str, Any] | None = None) -> TransferTable:
    """Read the declared table.

    Args:
        path: The file.
        changes: What of it is replaced.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it declares something that is not there.
    """
    if not path.is_file():
        raise ConfigError(f"transfer: expected a declared table, found no file {path}")
    try:
        tree = yaml.safe_load(read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8"))
        return TransferTable.model_validate(json.loads(json.dumps({**tree, **(changes or {})})))
    except ValidationError as error:
        raise FileFormatError(path, where="the file", expected="a declared table", found=plain(error)) from None
