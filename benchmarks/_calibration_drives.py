"""Simulated K-Radar drives for calibrations: a minute each, of which runs of consecutive frames are kept."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from _report import progress

from farfield.datasets import open_dataset
from farfield.datasets.base import Dataset
from farfield.datasets.kradar.writer import KRadarWriter
from farfield.simulation import find_preset, simulate_frame
from farfield.simulation.presets import Preset
from farfield.simulation.rigs.drive import drive_of

ROADS = ("urban", "highway", "suburban")
LIGHTS = ("day", "night")
SEED = 6
SECONDS = 60.0
DEVELOPED = 6  # the first drives, on which the solver was developed: they are not reported
UNSEEN = 48  # the first of the drives on which the threshold of a claim was not chosen
FRESH = 68  # the first of those on which nothing was chosen or seen
RUNS = tuple(range(5, 560, 29))
LENGTH = 10


@dataclass(frozen=True, kw_only=True)
class SimulatedDrive:
    """One drive.

    Args:
        road: Name of a road.
        light: ``"day"`` or ``"night"``.
        number: Of the sequence: drives of other numbers have other worlds.
        seed: Of the data set.
    """

    road: str
    light: str
    number: int
    seed: int = SEED

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.road}-{self.light}-{self.number}"

    @property
    def preset(self) -> Preset:
        """What is simulated."""
        return find_preset("kradar-sim", road=self.road, time=self.light, weather="normal", duration_s=SECONDS)

    @property
    def late_s(self) -> float:
        """How much later its radar measures, in seconds."""
        return drive_of(self.preset, self.seed, self.number).mounting.radar_offset_s

    def opened(self, folder: Path, sensors: Sequence[str] = ("os2-64", "sparse")) -> Dataset:
        """Simulate the frames that are not there, and open the drive as a K-Radar."""
        writer = KRadarWriter(folder / self.name)
        there = {int(path.stem.split("_")[1]) - 1 for path in writer.root.glob("*/frame_record/*.json")}  # from 1
        wanted = [start + step for start in RUNS for step in range(LENGTH)]
        absent = [index for index in wanted if index not in there]
        for index in progress(absent, f"simulating {self.name}"):
            writer.write(
                simulate_frame(self.preset, seed=self.seed, sequence=self.number, index=index, sensors=tuple(sensors))
            )
        if absent:
            writer.finish()
        return open_dataset(writer.root, format="kradar")


KINDS = [(road, light) for light in LIGHTS for road in ROADS]


def drives(rounds: int, first: int = DEVELOPED) -> list[SimulatedDrive]:
    """Drives in the order in which they are made: each road by day and by night in every round."""
    return [_numbered(first + number) for number in range(len(KINDS) * rounds)]


def highways(count: int, first: int) -> list[SimulatedDrive]:
    """So many drives on highways from a number on: there the spread is greatest."""
    found = (_numbered(number) for number in range(first, first + len(KINDS) * count))
    return [each for each in found if each.road == "highway"][:count]


def unseen(count: int) -> list[SimulatedDrive]:
    """So many drives on which the threshold of a claim was not chosen, roads and lights in turn."""
    return [_numbered(UNSEEN + number) for number in range(count)]


def _numbered(number: int) -> SimulatedDrive:
    road, light = KINDS[number % len(KINDS)]
    return SimulatedDrive(road=road, light=light, number=number)
