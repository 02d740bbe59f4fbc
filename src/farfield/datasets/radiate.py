"""RADIATE: a turning Navtech radar (360 degrees, no height, no Doppler), an HDL-32e lidar and a stereo camera.

Sheeny et al.: "RADIATE: A Radar Dataset for Automotive Perception in Bad Weather", ICRA 2021. What its documentation
leaves open was settled on the sample sequence of the authors' SDK: the sense of the boxes' turn by a car that turns
off, the radar's azimuth by the Cartesian picture, the lidar's place and the 0.25 s between the stamps by laying both
over each other.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from farfield.datasets.base import Dataset, Indices, all_known
from farfield.errors import ConfigError, DatasetError, FileFormatError
from farfield.files.ascii_table import whole_numbers
from farfield.files.images import read_image
from farfield.files.json_text import read_json
from farfield.files.limits import MAX_RINGS
from farfield.files.radiate import RadiateTracks, read_times, read_tracks
from farfield.files.remote_paths import as_path
from farfield.files.suffixes import any_case, existing
from farfield.files.xyz import read_xyz
from farfield.frame import Annotation, Boxes, Cloud, Frame, Lazy, Sensor, camera_sensor
from farfield.frame.cloud_columns import returned
from farfield.geometry.poses import pose
from farfield.radar.turning import CARTESIAN_SHAPE, CELL_M, CENTRE_PX, POLAR_SHAPE, TURN_S, strongest_cells
from farfield.vocabulary.classes import normalised_class
from farfield.vocabulary.counts import count_of

STAMP_LAG_S = TURN_S
"""A radar picture is stamped a whole turn after the moment that it fits in lidar and cameras (the SDK's ``sync``)."""
RADAR_T_LIDAR_M = (-0.120102, -0.6003, 0.250012)  # the SDK's calibration, in our axes: x forward, y left, z up
GROUND_Z_M = -1.8  # the SDK's height of the sensors

CLASSES = {
    "car": "vehicle",
    "van": "vehicle",
    "truck": "large_vehicle",
    "bus": "large_vehicle",
    "motorbike": "motorcycle",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
    "group_of_pedestrians": "pedestrian",
}
NOMINAL_HEIGHT_M = {"vehicle": 1.6, "large_vehicle": 3.2, "motorcycle": 1.6, "bicycle": 1.7, "pedestrian": 1.7}
_PNG = f"*{any_case('.png')}"
_PICTURES = {"polar": "Navtech_Polar", "cartesian": "Navtech_Cartesian"}
_SCENES = {"fog": "weather", "rain": "weather", "snow": "weather", "night": "time"}
_NEAREST_S = 0.06


class Radiate(Dataset):
    """RADIATE's sequences, one frame a turn of the radar, in the radar's coordinates: x forward, y left.

    What a frame has depends on the files that are there:

    - radar ``polar``, shape (576 ranges, 400 azimuths clockwise from forward), and ``cartesian``, shape (1152, 1152),
      forward up and right to the right, both float32 in [0, 1] of the files' 0 to 255, which are decibels without a
      known scale; cells of :data:`CELL_M`.
    - clouds ``radar`` (the strongest cells of the polar picture, z = 0) and ``lidar`` (with ``ring``), the sweep
      nearest to the moment that the radar's picture shows, see :data:`STAMP_LAG_S`.
    - images ``zed_left`` and ``zed_right``, not rectified. There are no cameras: the set has only Euler angles for
      them, in an order that its documentation does not give.
    - boxes with track ids. They were drawn on the radar's picture, so height and z are nominal
      (:data:`NOMINAL_HEIGHT_M`, on the ground at :data:`GROUND_Z_M`): score them from above only.

    Args:
        root: A folder of sequences such as ``fog_6_0``, or one sequence.
        radar_share: Share of the polar picture's cells that the cloud ``radar`` gets, in (0, 1].
        classes: ``"cirrus"`` translates class names, ``"radiate"`` keeps them.

    Raises:
        DatasetError: If there is no radar picture.
        ConfigError: If an option is out of range.
    """

    name = "radiate"

    def __init__(self, root: Path | str, *, radar_share: float | int = 0.02, classes: str = "cirrus") -> None:
        if not 0 < radar_share <= 1:
            raise ConfigError(f"radiate: expected radar_share in (0, 1], got {radar_share!r}")
        if classes not in ("cirrus", "radiate"):
            raise ConfigError(f"radiate: expected classes to be one of 'cirrus', 'radiate', got {classes!r}")
        self.root, self.radar_share, self.classes = as_path(root), float(radar_share), classes
        self.folders = {folder.name: folder for folder in find_sequences(self.root)}
        frames = [(name, number) for name, folder in self.folders.items() for number in radar_frames(folder)]
        if not frames:
            raise DatasetError(f"{self.root}: expected [<sequence>/]Navtech_Polar/*.png, found none")
        self.sequences = tuple(name for name, _ in frames)
        self.frame_ids = tuple(f"{number:06d}" for _, number in frames)
        self._times: dict[tuple[str, str], dict[int, int]] = {}
        self._tracks: dict[str, RadiateTracks | None] = {}

    def _listed(self, sequence: str, sensor: str) -> dict[int, int]:
        """Times by frame number of a sensor, read at the first access."""
        key = (sequence, sensor)
        if key not in self._times:
            path = self.folders[sequence] / f"{sensor}.txt"
            self._times[key] = read_times(path) if path.is_file() else {}
        return self._times[key]

    def _annotated(self, sequence: str) -> RadiateTracks | None:
        if sequence not in self._tracks:
            path = self.folders[sequence] / "annotations" / "annotations.json"
            self._tracks[sequence] = read_tracks(path) if path.is_file() else None
        return self._tracks[sequence]

    def _time_ns(self, index: int) -> int | None:
        number = int(self.frame_ids[index])
        times = (self._listed(self.sequences[index], sensor).get(number) for sensor in _PICTURES.values())
        return next((time_ns for time_ns in times if time_ns is not None), None)

    def _paths(self, index: int) -> dict[str, tuple[Path, int | None]]:
        """Files and times of frame ``index`` by product; a sensor without a sweep near enough is left out."""
        folder, stem, time_ns = self.folders[self.sequences[index]], self.frame_ids[index], self._time_ns(index)
        files = {name: (folder / subfolder / f"{stem}.png", time_ns) for name, subfolder in _PICTURES.items()}
        for sensor, suffix in (("velo_lidar", ".csv"), ("zed_left", ".png"), ("zed_right", ".png")):
            near = _nearest(self._listed(self.sequences[index], sensor), time_ns)
            if near is not None:
                files[sensor] = (folder / sensor / f"{near[0]:06d}{suffix}", near[1])
        there = {name: (existing(path), time) for name, (path, time) in files.items()}
        return {name: (path, time) for name, (path, time) in there.items() if path is not None}

    def _times_of(self, indices: Indices) -> Indices | None:
        return all_known(self._time_ns(int(index)) for index in indices)

    def files(self, index: int) -> Sequence[Path]:
        """List the files of frame ``index`` that are there."""
        folder = self.folders[self.sequences[index]]
        beside = [folder / "annotations" / "annotations.json", folder / "meta.json"]
        return [*(path for path, _ in self._paths(index).values()), *(path for path in beside if path.is_file())]

    def frame(self, index: int) -> Frame:
        """Build frame ``index``."""
        sequence, paths = self.sequences[index], self._paths(index)
        tracks, meta = self._annotated(sequence), read_meta(self.folders[sequence] / "meta.json")
        number = int(self.frame_ids[index])
        scene = meta.get("type", "")
        clouds: dict[str, Callable[[], Cloud]] = {}
        if "polar" in paths:
            clouds["radar"] = partial(radar_cloud, paths["polar"][0], self.radar_share)
        if "velo_lidar" in paths:
            clouds["lidar"] = partial(lidar_cloud, paths["velo_lidar"][0])
        images = {name: paths[name] for name in ("zed_left", "zed_right") if name in paths}
        return Frame(
            sequence=sequence,
            frame_id=self.frame_ids[index],
            time_ns=self._time_ns(index),
            clouds=Lazy(clouds),
            images=Lazy({name: partial(read_image, path) for name, (path, _) in images.items()}),
            sensors=_sensors(paths, self._time_ns(index)),
            load_annotation=None if tracks is None else partial(annotation_of, tracks.of_frame(number), self.classes),
            conditions={_SCENES.get(scene, "road"): scene} if scene else {},
            radar=Lazy({name: partial(read_picture, paths[name][0], name) for name in _PICTURES if name in paths}),
            reference="radar",
            metadata={
                "files": [str(path) for path in self.files(index)],
                "boxes": "height nominal: drawn from above",
                "meta": meta,
            },
        )


def _sensors(paths: Mapping[str, tuple[Path, int | None]], time_ns: int | None) -> dict[str, Sensor]:
    """Where each sensor stands in the radar's coordinates; of the cameras that is not known."""
    times = {name: time for name, (_, time) in paths.items()}
    sensors = {"radar": Sensor(kind="radar", frame_T_sensor=np.eye(4), time_ns=time_ns)}
    if "velo_lidar" in times:
        radar_T_lidar = pose(np.eye(3), np.array(RADAR_T_LIDAR_M))
        sensors["lidar"] = Sensor(kind="lidar", frame_T_sensor=radar_T_lidar, time_ns=times["velo_lidar"])
    for name in _PICTURES:
        if name in times:
            sensors[name] = Sensor(kind="radar", frame_T_sensor=np.eye(4), in_frame=False, time_ns=times[name])
    cameras = {name: camera_sensor(None, times[name]) for name in ("zed_left", "zed_right") if name in times}
    return sensors | cameras


def find_sequences(root: Path) -> list[Path]:
    """Folders with radar pictures: the root itself, or those in it, by name."""
    if _holds_pictures(root):
        return [root]
    return sorted(path for path in root.glob("*") if path.is_dir() and _holds_pictures(path))


def _holds_pictures(folder: Path) -> bool:
    return any(next(iter((folder / subfolder).glob(_PNG)), None) is not None for subfolder in _PICTURES.values())


def radar_frames(folder: Path) -> list[int]:
    """Numbers of the radar frames whose picture is there, in order."""
    stems = {path.stem for subfolder in _PICTURES.values() for path in (folder / subfolder).glob(_PNG)}
    return sorted(int(stem) for stem in stems if len(stem) == 6 and stem.isascii() and stem.isdigit())


def _nearest(times: Mapping[int, int], time_ns: int | None) -> tuple[int, int] | None:
    """Frame and time nearest to the moment that a radar picture shows, within :data:`_NEAREST_S`."""
    if time_ns is None or not times:
        return None
    wanted_ns = time_ns - round(STAMP_LAG_S * 1e9)
    number = min(times, key=lambda frame: abs(times[frame] - wanted_ns))
    return (number, times[number]) if abs(times[number] - wanted_ns) <= _NEAREST_S * 1e9 else None


def read_meta(path: Path) -> dict[str, str]:
    """Read ``meta.json``: ``name``, ``type``, ``set`` and so on; empty where there is none.

    Raises:
        FileFormatError: If it is no JSON object.
    """
    if not path.is_file():
        return {}
    meta = read_json(path, max_bytes=1 << 20)
    if not isinstance(meta, dict):
        raise FileFormatError(path, where="the file", expected="a JSON object", got=type(meta).__name__)
    return {str(key): str(value) for key, value in meta.items()}


def read_picture(path: Path, name: str) -> Float32[np.ndarray, "height width"]:
    """Read a radar picture, ``"polar"`` or ``"cartesian"``, as numbers in [0, 1].

    Raises:
        DatasetError: If it has another size.
    """
    shape = POLAR_SHAPE if name == "polar" else CARTESIAN_SHAPE
    image = read_image(path, max_pixels=CARTESIAN_SHAPE[0] * CARTESIAN_SHAPE[1])
    if image.shape[:2] != shape:
        raise DatasetError(
            f"{path}: expected a {name} picture of {count_of(shape[0], 'row')} "
            f"and {shape[1]} columns, got {image.shape}"
        )
    return image[:, :, 0].astype(np.float32) / np.float32(255)


def radar_cloud(path: Path, share: float) -> Cloud:
    """The strongest cells of a polar picture as points at z = 0: those above the rest, at most ``share`` of all.

    Their column ``strength`` is the picture's, 0 to 1: decibels without a known scale. Cell (i, j) lies ``i`` cells
    away, in the middle of the j-th of 400 sectors, counted clockwise from forward.
    """
    points, strength = strongest_cells(read_picture(path, "polar"), share)
    return Cloud(points, None, {"strength": strength})


def lidar_cloud(path: Path) -> Cloud:
    """Read a lidar sweep (x right, y forward, z up, intensity 0 to 255, ring) into the radar's frame."""
    rows = read_xyz(path, columns=5, delimiter=",", on_nan="keep")
    valid = returned(path, rows[:, :3])
    rows = rows[valid]
    points = np.column_stack([rows[:, 1], -rows[:, 0], rows[:, 2]]) + np.array(RADAR_T_LIDAR_M)
    if not ((rows[:, 3] >= 0) & (rows[:, 3] <= 255)).all():
        actual = f"{rows[:, 3].min():g} to {rows[:, 3].max():g}"
        raise FileFormatError(path, where="column 4, intensity", expected="values from 0 to 255", got=actual)
    intensity = (rows[:, 3] / 255).astype(np.float32)
    ring = whole_numbers(rows[:, 4], largest=MAX_RINGS - 1, path=path, where="column 5, the ring").astype(np.int16)
    return Cloud(points.astype(np.float32), intensity, {"ring": ring}, int((~valid).sum()))


def annotation_of(rows: RadiateTracks, classes: str = "cirrus") -> Annotation:
    """One frame's boxes with the file's own class names."""
    frame = int(rows.frame[0]) if len(rows.frame) else 0
    return Annotation(boxes=boxes_of(rows, frame, classes=classes), original_label=tuple(map(str, rows.class_name)))


def boxes_of(tracks: RadiateTracks, frame: int, *, classes: str = "cirrus") -> Boxes:
    """Convert the boxes of one radar frame, from pixels of the Cartesian picture to metres.

    Args:
        tracks: The sequence's boxes.
        frame: Number of the radar frame, from 1.
        classes: ``"cirrus"`` or ``"radiate"``.
    """
    here = np.flatnonzero(tracks.frame == frame)
    centre_px = (tracks.corner_px + tracks.size_px / 2)[here]
    names = [tracks.class_name[row] for row in here]
    ours = [normalised_class(name, CLASSES) for name in names]
    height_m = np.array([NOMINAL_HEIGHT_M.get(name, 1.7) for name in ours])
    forward_m, left_m = (CELL_M * (CENTRE_PX - centre_px[:, axis]) for axis in (1, 0))
    return Boxes(
        centre_m=np.column_stack([forward_m, left_m, GROUND_Z_M + height_m / 2]),
        size_m=np.column_stack([tracks.size_px[here, 1] * CELL_M, tracks.size_px[here, 0] * CELL_M, height_m]),
        yaw_rad=np.radians(tracks.rotation_deg[here]),
        label=ours if classes == "cirrus" else names,
        track_id=tracks.track_id[here],
    )


OURS = {
    "vehicle": "car",
    "large_vehicle": "truck",
    "trailer": "truck",
    "motorcycle": "motorbike",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
}
"""RADIATE's word for each of our classes that it draws."""


def tracks_of(boxes: Boxes, frame: int) -> RadiateTracks:
    """The other way: boxes in the radar's coordinates as pixels of the Cartesian picture; other classes are left out.

    Args:
        boxes: With track ids.
        frame: Number of the radar frame, from 1.
    """
    rows = [row for row, label in enumerate(boxes.label) if str(label) in OURS]
    chosen = boxes[np.array(rows, dtype=np.int64)]
    size_px = chosen.size_m[:, [1, 0]] / CELL_M
    centre_px = CENTRE_PX - chosen.centre_m[:, [1, 0]] / CELL_M
    ids = chosen.track_id if chosen.track_id is not None else np.arange(len(rows))
    return RadiateTracks(
        frame=np.full(len(rows), frame, dtype=np.int64),
        track_id=np.asarray(ids, dtype=np.int64),
        class_name=tuple(OURS[str(label)] for label in chosen.label),
        corner_px=centre_px - size_px / 2,
        size_px=size_px,
        rotation_deg=np.degrees(chosen.yaw_rad),
    )
