"""The record of a machine's rates: what was measured on what, as JSON that is read back without trust."""

import statistics
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from farfield.errors import FileFormatError, fault_of
from farfield.files.json_text import read_json

MAX_RATES_BYTES = 4_000_000
"""Of a file of rates, which has some dozen rows."""

Seconds = Annotated[float, Field(gt=0, le=1e6)]
Bytes = Annotated[float, Field(ge=0, le=1e15)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Part = Literal["cloud", "clouds", "camera", "cameras", "labels", "cells", "tesseract"]
Frames = Literal["cirrus", "kradar"]


class _RateRecord(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class MeasuredRate(_RateRecord):
    """How long a verb or a detector takes for a frame.

    Args:
        name: The verb with its flag, such as ``convert --to kitti``, or the detector's weights.
        kind: Which of the two it is.
        frames_of: The data set whose simulated frames it was measured on.
        precision: Number type of the network; empty where there is none.
        on: Where the time goes: one core, or the GPU.
        reads: The parts of a frame that it reads, twice where it reads them twice.
        seconds: Seconds a frame of each repeat, by one process with one thread.
        bytes_out: Bytes a frame that it writes.
    """

    name: Name
    kind: Literal["verb", "detector"]
    frames_of: Frames
    precision: Literal["", "fp32", "bf16", "fp16"] = ""
    on: Literal["core", "GPU"] = "core"
    reads: Annotated[tuple[Part, ...], Field(max_length=20)] = ()
    seconds: Annotated[tuple[Seconds, ...], Field(min_length=1, max_length=1000)]
    bytes_out: Bytes = 0.0

    @property
    def median_s(self) -> float:
        """Seconds a frame: the median of the repeats."""
        return statistics.median(self.seconds)

    @property
    def spread(self) -> float:
        """Slowest repeat less the fastest, as a share of the median."""
        return (max(self.seconds) - min(self.seconds)) / self.median_s


class MachineRates(_RateRecord):
    """What a machine does.

    Args:
        farfield_rates: Version of this record.
        version: Farfield's.
        commit: Of the sources; empty where they are no checkout.
        date: When it was measured, UTC.
        processor: Its name.
        cores: Cores that this process may use.
        memory_bytes: Of the machine.
        gpu: Name of the GPU that detectors ran on; empty where they ran on the processor.
        load: Processes that wanted a core as it began (one minute's mean); far above 0 the rates are too low.
        two_at_once: What two workers do side by side, as a share of twice what one does alone; None where one core is
            all there is.
        inflate_mb_s: Megabytes a second, unpacked, of inflating doubles.
        disk_read_mb_s: Megabytes a second of reading a file that is not in memory, from the folder for temporary files.
        disk_write_mb_s: The same of writing one until it is on the disk.
        sizes: Bytes of the parts of a simulated frame, by data set.
        rates: What was measured.
        left_out: What was not, and why.
    """

    farfield_rates: Literal[1] = 1
    version: Name
    commit: Annotated[str, Field(max_length=100)] = ""
    date: Name
    processor: Name
    cores: Annotated[int, Field(ge=1, le=100_000)]
    memory_bytes: Bytes = 0.0
    gpu: Annotated[str, Field(max_length=200)] = ""
    load: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    two_at_once: Annotated[float, Field(gt=0, le=1)] | None = None
    inflate_mb_s: Annotated[float, Field(gt=0, le=1e6)] | None = None
    disk_read_mb_s: Annotated[float, Field(gt=0, le=1e7)] | None = None
    disk_write_mb_s: Annotated[float, Field(gt=0, le=1e7)] | None = None
    sizes: dict[Frames, dict[Part, Bytes]] = {}
    rates: Annotated[tuple[MeasuredRate, ...], Field(max_length=1000)]
    left_out: Annotated[dict[Name, Annotated[str, Field(max_length=1000)]], Field(max_length=1000)] = {}

    def bytes_in(self, rate: MeasuredRate) -> float:
        """Bytes a simulated frame that a verb or detector reads."""
        sizes = self.sizes.get(rate.frames_of, {})
        return sum(sizes.get(part, 0.0) for part in rate.reads)


def read_rates(path: Path) -> MachineRates:
    """Read the rates of a machine back, from the file that ``farfield bench --json`` wrote, with a plan or without.

    Raises:
        FileFormatError: If it is larger than :data:`MAX_RATES_BYTES`, no JSON, or no such record.
        OSError: If it cannot be opened.
    """
    tree = read_json(path, max_bytes=MAX_RATES_BYTES)
    tree = tree["rates"] if isinstance(tree, dict) and isinstance(tree.get("rates"), dict) else tree
    try:
        return MachineRates.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"]) or "the file"
        raise FileFormatError(
            path,
            where=where[:200],
            expected="the rates that farfield bench --json writes",
            got=fault_of(first)[:200],
            fix="Measure again: farfield bench --json FILE.",
        ) from error
