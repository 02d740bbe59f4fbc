"""ROS bags as frames: one a message of the reference cloud, with the nearest of each other topic."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Int64, Shaped, UInt8

from farfield.datasets.bags.transforms import Transforms
from farfield.datasets.base import Dataset, Indices, Poses, all_poses
from farfield.errors import ConfigError, DatasetError, FarfieldError, FileFormatError
from farfield.files.bags import FILE_SUFFIXES, Bag, Topic, guarded, is_bag
from farfield.files.intensities import intensity_scale_of, scaled_intensity
from farfield.files.point_times import PointTimeColumn, PointTimes, check_point_times, point_time_column
from farfield.files.remote_paths import as_path
from farfield.files.sensor_messages import read_points, read_ros_compressed, read_ros_image
from farfield.frame import Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud import CloudSettings, with_offsets
from farfield.frame.cloud_columns import named_columns, returned
from farfield.vocabulary.counts import count_of

CLOUD, IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"
COMPRESSED, IMU = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Imu"
_KINDS = (CLOUD, IMAGE, COMPRESSED)
_LOOKED_AT, _BAGS_LOOKED_AT = 5, 8
_ONE_CLOCK_S = 0.5  # a message is recorded that much sooner or later than others of its bag by one clock
Columns = dict[str, Shaped[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Messages:
    """One topic's messages in the order of their stamps.

    Args:
        topic: The topic.
        times_ns: Stamps, by header or by time of recording, shape (n,).
        log_ns: When each was recorded, shape (n,).
        repeat: Which of those recorded at the same moment each is, shape (n,).
        frame_id: Name of its coordinates, by its first message.
        radar: Whether it is a radar's cloud.
        settings: How its clouds are read.
    """

    topic: Topic
    times_ns: Int64[np.ndarray, " n"]
    log_ns: Int64[np.ndarray, " n"]
    repeat: Int64[np.ndarray, " n"]
    frame_id: str
    radar: bool
    settings: CloudSettings

    def nearest(self, time_ns: int, tolerance_ns: int) -> int | None:
        """Place of the message nearest in time, the earlier of two; None beyond the tolerance."""
        after = int(np.searchsorted(self.times_ns, time_ns))
        near = [row for row in (after - 1, after) if 0 <= row < len(self.times_ns)]
        best = min(near, key=lambda row: abs(int(self.times_ns[row]) - time_ns), default=None)
        return best if best is not None and abs(int(self.times_ns[best]) - time_ns) <= tolerance_ns else None


class IndexedBag:
    """One bag, indexed at the first use: that reads it once.

    Args:
        path: The bag.
        stamp: Which stamps count.
        intensity_scale: Value that stands for full reflectance; None decides by some clouds of each topic.
        point_times: Unit of the points' times.
        radars: Topics of radars; None decides by names and columns.
    """

    def __init__(
        self,
        path: Path,
        stamp: str,
        intensity_scale: float | int | None,
        point_times: PointTimes,
        radars: Sequence[str] | None = None,
    ) -> None:
        self.bag, self.stamp, self.radars = Bag(path), stamp, radars
        self.intensity_scale, self.point_times = intensity_scale, point_times
        self.transforms = Transforms(self.bag)

    @property
    def clouds(self) -> list[Topic]:
        """Topics of point clouds that hold any."""
        return [topic for topic in self.bag.topics if topic.kind == CLOUD and topic.size]

    @cached_property
    def topics(self) -> dict[str, Messages]:
        """Clouds and images by our names, which are the topics' with ``_`` for ``/``."""
        topics = [topic for topic in self.bag.topics if topic.kind in _KINDS and topic.size]
        stamps = self.bag.stamps([topic.name for topic in topics]) if topics else {}
        return {our_name(topic.name): self._indexed(topic, stamps[topic.name]) for topic in topics}

    def _indexed(self, topic: Topic, stamps: Any) -> Messages:
        log = stamps.log_ns
        times = log if self.stamp == "log" or stamps.header_ns is None else stamps.header_ns
        first_of_equal = np.searchsorted(log, log, side="left")
        order = np.argsort(times, kind="stable")
        message = self.bag.at(topic.name, int(log[0]))
        repeat = np.arange(len(log)) - first_of_equal
        looked_at = np.unique(np.linspace(0, len(log) - 1, _LOOKED_AT).astype(int)).tolist()
        rows: list[int] = looked_at if topic.kind == CLOUD else []
        samples: list[Columns] = []
        for row in rows:
            with suppress(FarfieldError):  # a damaged one is reported when it is read
                samples.append(self._columns(topic, int(log[row]), int(repeat[row])))
        steps = np.diff(times[order])
        with guarded(self.bag.path, f"the header of {topic.name}"):
            frame_id = str(message.header.frame_id)
        return Messages(
            topic=topic,
            times_ns=times[order],
            log_ns=log[order],
            repeat=repeat[order],
            frame_id=frame_id,
            radar=self._is_radar(topic, samples[0] if samples else {}),
            settings=self._settings(samples, float(np.median(steps[steps > 0])) if (steps > 0).any() else None),
        )

    def _columns(self, topic: Topic, log_ns: int, repeat: int) -> Columns:
        return named_columns(self.bag.path, read_points(self.bag.at(topic.name, log_ns, repeat), self.bag.path))

    def _settings(self, samples: Sequence[Columns], period_ns: float | None) -> CloudSettings:
        """One full scale and one unit of times for all clouds of a topic."""
        scale, unit = self.intensity_scale, None
        if scale is None:
            strengths = [columns["intensity"][_has_place(columns)] for columns in samples if "intensity" in columns]
            scale = intensity_scale_of(strengths)
        for columns in samples if self.point_times == "auto" else ():
            name = point_time_column(columns)
            if unit is None and name is not None:
                with suppress(FileFormatError):  # reported when the cloud is read
                    times = columns[name][_has_place(columns)]
                    unit = PointTimeColumn(name, times, self.bag.path, None, period_ns).unit()
        return CloudSettings(intensity_scale=scale, point_times=self.point_times, usual_unit=unit, period_ns=period_ns)

    def _is_radar(self, topic: Topic, columns: Columns) -> bool:
        """Whether a cloud is a radar's: as is said, else by the topic's name, else by its columns."""
        if self.radars is not None:
            return bool({topic.name, our_name(topic.name)} & set(self.radars))
        name = topic.name.lower()
        if ("radar" in name) != ("lidar" in name):
            return "radar" in name
        return is_radar(columns)


def _other_clocks(recorded: IndexedBag, reference: str) -> list[str]:
    """A sentence on each topic whose stamps lie elsewhere, against the times of recording, than the reference's."""
    late_s = {name: float(np.median(row.times_ns - row.log_ns)) * 1e-9 for name, row in recorded.topics.items()}
    sentences = []
    for name, late in late_s.items():
        apart_s = late - late_s[reference]
        if abs(apart_s) > _ONE_CLOCK_S:
            sentences.append(
                f"{recorded.bag.path}: the stamps of {recorded.topics[name].topic.name} are {abs(apart_s):.3g} s "
                f"{'ahead of' if apart_s > 0 else 'behind'} those of {recorded.topics[reference].topic.name}, by the "
                "times of recording: their clocks differ, and what belongs together is not paired. stamp=log pairs by "
                "the times of recording"
            )
    return sentences


def our_name(topic: str) -> str:
    """A topic's name without slashes: ``/os/points`` is ``os_points``."""
    return topic.strip("/").replace("/", "_")


_NO_LIDARS = ("depth", "camera", "stereo", "registered", "map", "global", "accumulated")


def _rank(topic: Topic) -> tuple[bool, bool, int]:
    """Whether a cloud is no radar's; whether it is no depth camera's and no map, by name; how many there are."""
    name = topic.name.lower()
    return "radar" not in name, not any(word in name for word in _NO_LIDARS), topic.size


class Bags(Dataset):
    """Bags of ROS 2 (SQLite, MCAP) or ROS 1: a frame a message of the reference cloud, in its sensor's coordinates.

    Other clouds and images come with the frame whose stamp is nearest, within the tolerance; a message may come with
    two. Clouds whose place is known by fixed transforms stand in the frame's coordinates, others keep their own axes
    (``in_frame=False``). Poses come from ``/tf`` where moving edges lie above the reference, or, of a frame
    that no transform moves, from the one topic of ``nav_msgs/msg/Odometry`` that does. The first access reads a
    bag once for its stamps; ``farfield.files.bags`` has what else is in it, such as IMU messages (:meth:`imu`).

    Args:
        root: A bag's folder, or a folder of bags or of lone ``.mcap``, ``.db3`` and ``.bag`` files.
        cloud: Topic of the reference cloud (default: the lidar with the most messages), which is then said.
        stamp: ``"header"``, the sensors' own stamps, or ``"log"``, when messages were recorded.
        tolerance_ms: Largest distance of what comes with a frame.
        intensity_scale: Value that stands for full reflectance; None decides by some clouds of each topic.
        intensity_max: The old name of intensity_scale.
        point_times: Unit of the points' times: ``s``, ``ms``, ``us``, ``ns``, or ``none`` to leave the column as it is;
            ``auto`` decides by the sweeps' period.
        radars: Topics of radars, ``("none",)`` for none (default: topics' names and columns decide).

    Raises:
        DatasetError: If there is no bag with clouds.
        FileFormatError: If a bag is damaged or cut.
        ConfigError: If no bag has the topic.
    """

    name = "bags"

    def __init__(
        self,
        root: Path | str,
        *,
        cloud: str | None = None,
        stamp: Literal["header", "log"] = "header",
        tolerance_ms: float = 50.0,
        intensity_scale: float | int | None = None,
        intensity_max: float | int | None = None,
        point_times: PointTimes = "auto",
        radars: Sequence[str] | None = None,
    ) -> None:
        check_point_times(point_times)
        scale = intensity_max if intensity_scale is None else intensity_scale
        if scale is not None and not 0 < scale < np.inf:
            raise ConfigError(f"intensity_scale: expected a positive number, got {scale!r}")
        self.root, self.tolerance_ns, self.chosen_cloud = as_path(root), round(tolerance_ms * 1e6), cloud
        paths = find_bags(self.root)
        self._bags = {path.stem if path.is_file() else path.resolve().name: path for path in paths}
        if len(self._bags) < len(paths):
            raise DatasetError(f"{root}: expected bags of different names")
        self._recorded = {
            name: IndexedBag(path, stamp, scale, point_times, radars) for name, path in self._bags.items()
        }
        self._clouds = {name: self._reference(name, cloud) for name in self._bags}
        _check_radars(radars, [topic for bag in self._recorded.values() for topic in bag.clouds])
        counts = {name: 0 if topic is None else topic.size for name, topic in self._clouds.items()}
        if not sum(counts.values()):
            raise self._no_clouds(cloud)
        self.sequences = tuple(name for name, count in counts.items() for _ in range(count))
        self.frame_ids = tuple(f"{number:06d}" for count in counts.values() for number in range(count))

    def _no_clouds(self, cloud: str | None) -> DatasetError | ConfigError:
        """What the bags hold instead of the clouds that were looked for."""
        held = sorted({topic.name for bag in self._recorded.values() for topic in bag.clouds})
        if cloud is not None:
            return ConfigError(f"{self.root}: expected bags with clouds of {cloud}, found {', '.join(held) or 'none'}")
        topics = {topic.name: topic for bag in self._recorded.values() for topic in bag.bag.topics}
        shown = [f"{topic.name} ({topic.kind}, {count_of(topic.size, 'message')})" for topic in topics.values()]
        listed = ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "")
        return DatasetError(
            f"{self.root}: expected a topic of {CLOUD} with messages, found {listed or 'no topic at all'}. A driver's "
            "own type is not read: record the topic that its converter publishes, such as velodyne_pointcloud's "
            "/velodyne_points or Livox' driver with xfer_format 0, or write the clouds as .pcd into a folder."
        )

    def _reference(self, name: str, cloud: str | None) -> Topic | None:
        """The reference cloud of a bag; without a name the one of most messages.

        Clouds of lidars come before those of depth cameras and of maps, and these before radars, by their names.
        """
        topics = self._recorded[name].clouds
        if cloud is not None:
            return next((topic for topic in topics if cloud in (topic.name, our_name(topic.name))), None)
        return max(topics, key=_rank, default=None)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Which of several clouds frames go by, where that was not said."""
        if self.chosen_cloud is not None:
            return ()
        sentences: dict[str, None] = {}
        for name, topic in self._clouds.items():
            others = [other.name for other in self._recorded[name].clouds if other is not topic and _rank(other)[0]]
            if topic is not None and others:
                sentences[f"frames go by the cloud {topic.name}, not by {', '.join(others)}; cloud= says another"] = (
                    None
                )
        return tuple(sentences)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Transforms that are passed over, and topics of another clock than the reference's, of the first bags."""
        sentences = []
        for name in list(dict.fromkeys(self.sequences))[:_BAGS_LOOKED_AT]:
            with suppress(FarfieldError):  # a damaged bag is reported when it is read
                recorded, reference, _ = self._of(name)
                sentences += [*recorded.transforms.notes, *_other_clocks(recorded, reference)]
        return tuple(sentences)

    def _of(self, sequence: str) -> tuple[IndexedBag, str, Messages]:
        topic = self._clouds[sequence]
        if topic is None:
            raise DatasetError(f"{self.root}: {sequence} has no clouds")
        recorded = self._recorded[sequence]
        return recorded, our_name(topic.name), recorded.topics[our_name(topic.name)]

    def files(self, index: int) -> Sequence[Path]:
        """The bag's files: a frame's messages may stand in any of them."""
        path = self._bags[self.sequences[index]]
        return [path] if path.is_file() else sorted(part for part in path.iterdir() if part.is_file())

    def _times_of(self, indices: Indices) -> Indices | None:
        _, _, messages = self._of(self.sequences[int(indices[0])])
        return messages.times_ns[[int(self.frame_ids[index]) for index in indices]]

    def _poses_of(self, indices: Indices) -> Poses | None:
        return all_poses(self._pose(int(index)) for index in indices)

    def _pose(self, index: int) -> Any:
        recorded, _, messages = self._of(self.sequences[index])
        time_ns = int(messages.times_ns[int(self.frame_ids[index])])
        return recorded.transforms.world(messages.frame_id, time_ns, self.tolerance_ns)

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        recorded, reference, own = self._of(self.sequences[index])
        time_ns = int(own.times_ns[int(self.frame_ids[index])])
        sensors, clouds, images = {}, {}, {}
        for name, messages in recorded.topics.items():
            row = int(self.frame_ids[index]) if name == reference else messages.nearest(time_ns, self.tolerance_ns)
            if row is None:
                continue
            where = (recorded.bag, messages.topic.name, int(messages.log_ns[row]), int(messages.repeat[row]))
            taken_ns = int(messages.times_ns[row])
            if messages.topic.kind == CLOUD:
                ours = np.eye(4) if name == reference else recorded.transforms.fixed(own.frame_id, messages.frame_id)
                move = None if name == reference else ours
                settings = messages.settings
                clouds[name] = partial(
                    load_cloud, *where, settings=settings, target_T_sensor=move, radar=messages.radar
                )
                kind: Literal["radar", "lidar"] = "radar" if messages.radar else "lidar"
                has_pose = ours is not None
                sensors[name] = Sensor(kind=kind, frame_T_sensor=ours, in_frame=has_pose, time_ns=taken_ns)
            else:
                images[name] = partial(load_image, *where)
                sensors[name] = camera_sensor(None, taken_ns)
        first = {reference: clouds.pop(reference)}
        return Frame(
            sequence=self.sequences[index],
            frame_id=self.frame_ids[index],
            time_ns=time_ns,
            reference=reference,
            sensors=sensors,
            clouds=Lazy(first | clouds),
            images=Lazy(images),
            world_T_frame=self._pose(index),
            metadata={"files": [str(path) for path in self.files(index)]},
        )

    def imu(self, sequence: str, topic: str | None = None) -> dict[str, np.ndarray]:
        """What an IMU of a bag measured, in its own axes, by the names of columns.

        ``time_ns`` (n,) int64; ``angular_rad_s`` and ``acceleration_m_s2`` (n, 3); ``frame_id`` (n,).

        Raises:
            ConfigError: If the bag has no such topic.
        """
        bag = self._recorded[sequence].bag
        imu_topic = next((t for t in bag.topics if t.kind == IMU and topic in (None, t.name)), None)
        if imu_topic is None:
            raise ConfigError(f"{sequence}: expected an IMU, got {[t.name for t in bag.topics if t.kind == IMU]}")
        messages = [bag.decode(imu_topic, raw) for _, _, raw in bag.messages([imu_topic.name])]
        with guarded(bag.path, f"messages of {imu_topic.name}"):
            return _imu_table(messages)


def _imu_table(messages: Sequence[Any]) -> dict[str, np.ndarray]:
    stamps = [(int(m.header.stamp.sec), int(m.header.stamp.nanosec)) for m in messages]
    turn = [(m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z) for m in messages]
    push = [(m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z) for m in messages]
    return {
        "time_ns": np.array([s * 1_000_000_000 + ns for s, ns in stamps], dtype=np.int64),
        "angular_rad_s": np.array(turn, dtype=np.float64).reshape(-1, 3),
        "acceleration_m_s2": np.array(push, dtype=np.float64).reshape(-1, 3),
        "frame_id": np.array([str(m.header.frame_id) for m in messages]),
    }


def find_bags(root: Path) -> list[Path]:
    """The bag that a folder is, or those in it: folders with metadata, and lone files."""
    if is_bag(root):
        return [root]
    lone = [path for path in root.iterdir() if path.suffix.lower() in FILE_SUFFIXES and path.is_file()]
    return sorted([*lone, *(path for path in root.iterdir() if path.is_dir() and is_bag(path))])


def load_image(bag: Bag, topic: str, log_ns: int, index: int) -> UInt8[np.ndarray, "height width 3"]:
    """Read one image of a bag as RGB."""
    message = bag.at(topic, log_ns, index)
    compressed = hasattr(message, "format")
    return read_ros_compressed(message, bag.path) if compressed else read_ros_image(message, bag.path)


# Point clouds of messages.

SPEEDS = ("doppler", "velocity", "range_rate", "radial_speed", "v_r")
CROSS_SECTIONS = ("rcs", "power", "snr")
LIDAR = ("intensity", "reflectivity", "ring", "line", "channel", "laser", "ambient", "near_ir", "return")
_MOST_RADAR_POINTS = 5_000
"""More points a sweep than radars' point clouds have, with measures of a LiDAR beside the speed: an FMCW LiDAR."""


def is_radar(columns: Columns) -> bool:
    """Whether a cloud's columns are a radar's: a cross-section, or a speed that no FMCW LiDAR measured.

    Such a LiDAR (Aeva, Aurora, Scantinel) measures speeds too, in many more points and with an intensity or a line.
    """
    if not (_has_column(columns, SPEEDS) or _has_column(columns, CROSS_SECTIONS)):
        return False
    points = max(map(len, columns.values()), default=0)
    return not (points > _MOST_RADAR_POINTS and _has_column(columns, LIDAR))


def _has_column(columns: Columns, terms: Sequence[str]) -> bool:
    return any(term in str(name).lower() for name in columns for term in terms)


def _check_radars(radars: Sequence[str] | None, topics: Sequence[Topic]) -> None:
    """Refuse names of radars that no cloud of the bags has."""
    names = {name for topic in topics for name in (topic.name, our_name(topic.name))}
    unknown = [name for name in radars or () if name not in names and name != "none"]
    if unknown and names:
        listed = ", ".join(dict.fromkeys(topic.name for topic in topics))
        raise ConfigError(f"radars: expected topics of clouds ({listed}) or none, got {unknown[0]!r}")


def _has_place(columns: Columns) -> Bool[np.ndarray, " n"]:
    """Which points are none that mark a direction without return; all where there is no place at all."""
    if not all(axis in columns for axis in "xyz"):
        return np.full(len(next(iter(columns.values()))), True)
    places = np.column_stack([columns[axis] for axis in "xyz"])
    return np.isfinite(places).all(axis=1) & (places != 0).any(axis=1)


def load_cloud(
    bag: Bag,
    topic: str,
    log_ns: int,
    index: int,
    *,
    settings: CloudSettings,
    target_T_sensor: np.ndarray | None = None,
    radar: bool = False,
) -> Cloud:
    """Read one cloud of a bag; rows without a place (not finite, or 0, 0, 0: no return) are left out and counted.

    Args:
        bag: The bag.
        topic: The cloud's topic.
        log_ns: When it was recorded.
        index: Which of those recorded then.
        settings: Full scale, unit of times and period.
        target_T_sensor: Moves the points into other coordinates.
        radar: Whether it is a radar's.
    """
    message = bag.at(topic, log_ns, index)
    columns = read_points(message, bag.path)
    with guarded(bag.path, "a cloud's header"):
        stamp_ns = int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)
    cloud = cloud_of(columns, bag.path, settings.at(stamp_ns), radar=radar)
    return cloud if target_T_sensor is None else cloud.transform(target_T_sensor)


def cloud_of(
    columns: Mapping[str, Shaped[np.ndarray, "..."]], path: Path | str, settings: CloudSettings, *, radar: bool = False
) -> Cloud:
    """A cloud of the columns of a message; a radar's intensity is a further column, in its own unit (decibels).

    Raises:
        FileFormatError: If there is no x, y, z, one of them or the intensity holds several numbers, an intensity lies
            beyond its scale, or the points' times cannot be told.
        DatasetError: If the points lie beyond what sensors see.
    """
    columns = named_columns(path, columns)
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise FileFormatError(path, where="a point cloud", expected="fields x, y, z", got=", ".join(columns) or "none")
    points = np.column_stack([columns[name] for name in "xyz"]).astype(np.float32)
    points[np.isinf(points).any(axis=1)] = np.nan
    valid = returned(path, points)
    rest = {name: values[valid] for name, values in columns.items() if name not in "xyz"}
    strength = None if radar else rest.pop("intensity", None)
    if strength is not None:
        scale = intensity_scale_of([strength]) if settings.intensity_scale is None else settings.intensity_scale
        strength = scaled_intensity(path, strength, scale)
    return Cloud(points[valid], strength, with_offsets(path, rest, settings), int((~valid).sum()))
