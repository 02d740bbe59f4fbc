"""Captures of turning LiDARs of Velodyne and Hesai: ``NAME.pcap``, each sensor in it a drive of sweeps."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from farfield.datasets.base import Dataset, Indices
from farfield.datasets.turns import LEAST_SHARE, SensorTurns, Traffic, find_streams, stream_name
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.firings import TurningLidar
from farfield.files.hesai import Hesai
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import pattern_in_any_case
from farfield.frame import Frame, Lazy, Sensor

CLOUD = "lidar"
_PATTERNS = ("*.pcap", "*.pcapng")
_LOOKED_AT, _MOST_RECORDS = 2_000, 20_000  # datagrams of a capture, and records about them, to recognise a sensor


def captures_of(root: Path) -> list[Path]:
    """The captures of a folder."""
    return sorted(path for pattern in _PATTERNS for path in root.glob(pattern_in_any_case(pattern)))


def holds_sensor(root: Path) -> bool:
    """Whether one of a folder's captures has packets of a Velodyne or a Hesai among its first, be they read or not."""
    for path in captures_of(root):
        try:
            traffic = find_streams(path, _LOOKED_AT, _MOST_RECORDS)
        except FileFormatError:
            continue
        if traffic.streams or traffic.refused:
            return True
    return False


class Captures(Dataset):
    """Captures of Velodyne's and Hesai's sensors: one cloud ``"lidar"`` a frame (x ahead, y left, z up).

    Ahead is the sensor's direction 0. The cloud has ``ring`` (0 on top), ``offset_ns``, ``reflectivity`` (the intensity
    is it over 255) and ``return``: its place in ``frame.metadata["returns"]``, such as ``("last", "strongest")``; of
    two returns at one range the first is kept. A Hesai's angles are those of ``NAME.csv`` beside the capture.

    Read are the Velodyne VLP-16, Puck Hi-Res, VLP-32C, HDL-32E and VLS-128, and the Hesai Pandar40P, Pandar64,
    PandarQT64, QT128 (with two returns), PandarXT-16, XT-32 and XT-32M; others are refused by name. A drive is called
    after its capture; where several sensors are in one, after their address and port too: ``NAME-192.168.1.201-2368``.

    Args:
        root: Folder of ``NAME.pcap`` or ``NAME.pcapng``, with ``NAME.csv`` of a Hesai.
        cut_deg: Where a sweep begins and ends: degrees counter-clockwise from ahead.
        sensor: Only that sensor: ``192.168.1.201-2368``, as several in one capture are called.
        least_share: Sweeps of a smaller share of the usual number of packets are left out.

    Raises:
        ConfigError: If ``cut_deg`` is no direction or ``least_share`` no share.
        DatasetError: If no capture has a sensor that is read, or the one that is asked for, or a Hesai's angles are
            missing.
        FileFormatError: If a capture or a file of angles is damaged.
    """

    name = "captures"

    def __init__(
        self,
        root: Path | str,
        *,
        cut_deg: float = 180.0,
        sensor: str | None = None,
        least_share: float = LEAST_SHARE,
    ) -> None:
        self.root = as_path(root)
        if not -360 <= cut_deg <= 360:
            raise ConfigError(f"captures: expected cut_deg from -360 to 360 degrees, got {cut_deg:g}")
        if not 0 <= least_share <= 1:
            raise ConfigError(f"captures: expected least_share from 0 to 1, got {least_share:g}")
        self.cut_deg, self.sensor, self.least_share = float(cut_deg), sensor, float(least_share)
        self.options = {"cut_deg": self.cut_deg, "sensor": sensor, "least_share": self.least_share}
        self.turnings: dict[str, SensorTurns] = {}
        self.angle_files: dict[str, Path] = {}
        self._assumptions: list[str] = []
        paths = captures_of(self.root)
        for path in paths:
            self._add(path, find_streams(path), alone=len(paths) == 1)
        if not self.turnings:
            raise DatasetError(self._nothing())
        sizes = {name: len(turning.turns) for name, turning in self.turnings.items()}
        self.sequences = tuple(name for name, size in sizes.items() for _ in range(size))
        self.frame_ids = tuple(f"{number:06d}" for size in sizes.values() for number in range(size))
        if not self.sequences:
            raise DatasetError(f"{root}: no capture holds a whole turn. {' '.join(self._assumptions)}")

    def _nothing(self) -> str:
        """What to say where no sensor is read."""
        if self.sensor is not None:
            return f"{self.root}: expected a sensor {self.sensor!r}. {' '.join(self._assumptions)}"
        reasons = " ".join(self._assumptions) or "There are no *.pcap with packets of one."
        return f"{self.root}: expected captures of a Velodyne or a Hesai that is read. {reasons}"

    def _add(self, path: Path, traffic: Traffic, *, alone: bool) -> None:
        """Read the sensors of a capture, and say what is not read."""
        several = len(traffic.streams) + len(traffic.refused) > 1
        self._assumptions += [f"{path.name}: {note}" for note in traffic.losses.notes]
        for key, reason in sorted(traffic.refused.items()):
            self._assumptions.append(f"{path.name}: {stream_name(key)} is {reason}: it is not read.")
        for key, stream in sorted(traffic.streams.items()):
            own = stream_name(key)
            name = f"{path.stem}-{own}" if several else path.stem
            if self.sensor not in (None, own):
                self._assumptions.append(f"{path.name}: {own} is a {stream.lidar.name}.")
                continue
            hesais = sum(isinstance(other.lidar, Hesai) for other in traffic.streams.values())
            lidar = self._with_angles(path, name, stream.lidar, only=hesais == 1, alone=alone)
            if name in self.turnings:
                raise DatasetError(f"{self.root}: two captures are called {name}; rename one.")
            turning = self.turnings[name] = SensorTurns.of(path, stream, lidar, -self.cut_deg % 360, self.least_share)
            self._assumptions += [f"{name}: {note}" for note in turning.notes]

    def _with_angles(self, path: Path, name: str, lidar: TurningLidar, *, only: bool, alone: bool) -> TurningLidar:
        """The sensor with its unit's angles, where its packets do not imply them."""
        if not isinstance(lidar, Hesai):
            return lidar
        names = [name, path.stem] if only else [name]
        files = {file.stem: file for file in sorted(self.root.glob(pattern_in_any_case("*.csv")))}
        chosen = next((files[stem] for stem in names if stem in files), None)
        if chosen is None and only and alone and len(files) == 1:
            chosen = next(iter(files.values()))
        if chosen is None:
            raise DatasetError(
                f"{path}: expected the angles of its {lidar.name}'s beams beside it as {name}.csv, found "
                f"{', '.join(sorted(file.name for file in files.values())[:4]) or 'no CSV'}. The sensor's web page or "
                "the maker's viewer gives its unit's correction file."
            )
        self.angle_files[name] = chosen
        return lidar.with_angles(chosen)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is missing of each capture, which clock times are of, and what is not read."""
        return tuple(self._assumptions)

    def files(self, index: int) -> Sequence[Path]:
        """The capture, and the angles of a Hesai."""
        name = self.sequences[index]
        angles = self.angle_files.get(name)
        return [self.turnings[name].path] if angles is None else [self.turnings[name].path, angles]

    def _times_of(self, indices: Indices) -> Indices | None:
        turns = self.turnings[self.sequences[int(indices[0])]].turns
        return np.array([turns[int(self.frame_ids[index])].time_ns for index in indices], dtype=np.int64)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        turning, number = self.turnings[self.sequences[index]], int(self.frame_ids[index])
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=turning.turns[number].time_ns,
            clouds=Lazy({CLOUD: partial(turning.cloud, number)}),
            sensors={CLOUD: Sensor(kind="lidar", frame_T_sensor=np.eye(4))},
            reference=CLOUD,
            metadata={
                "files": [str(path) for path in self.files(index)],
                "model": turning.lidar.name,
                "returns": list(turning.lidar.returns),
            },
        )
