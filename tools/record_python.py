"""Use the public names of ``farfield`` and write down what they give.

    python record_python.py frames FOLDER [NAME=VALUE ...]

writes what a data set's first frames hold: ``frames.json`` and, for what is in arrays, ``frames.npz``. The other works
(arrays, detecting, refused) take no folder and print.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import farfield as ff

_PARTS: tuple[str, ...] = (
    "sequence",
    "frame_id",
    "time_ns",
    "reference",
    "conditions",
    "simulated",
    "metadata",
    "world_T_frame",
)
_PARTS += ("sensors", "cameras", "clouds", "images", "radar", "annotation")


def flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The arrays and the words in a value, each with the way to it."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        yield name, value
    elif isinstance(value, np.ndarray):
        yield name, [str(each) for each in value.reshape(-1)]
    elif isinstance(value, Mapping):
        for key in value:
            try:
                inside = value[key]
            except ff.FarfieldError as error:
                inside = f"{type(error).__name__}: {error}"
            yield from flat(f"{name}/{key}", inside)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from flat(f"{name}.{field.name}", getattr(value, field.name, None))
    elif isinstance(value, list | tuple):
        for number, each in enumerate(value):
            yield from flat(f"{name}/{number}", each)
    elif value is None or isinstance(value, str | int | float | bool | np.generic):
        yield name, value.item() if isinstance(value, np.generic) else value
    elif not callable(value):
        yield name, type(value).__name__


def frames(folder: str, *words: str) -> None:
    """What the first frames hold, and their coordinates from another sensor where there is one."""
    options = dict(word.split("=", 1) for word in words)
    data = ff.open_dataset(folder, **options)
    told: dict[str, Any] = {"name": data.name, "frames": len(data), "keys": [list(key) for key in data.keys][:50]}
    arrays: dict[str, np.ndarray] = {}
    for index in range(min(3, len(data))):
        frame = data[index]
        held = [frame]
        if len(frame.sensors) > 1:
            turned = np.eye(4)
            turned[:2] = [[0.0, -1.0, 0, 1.0], [1.0, 0.0, 0, 2.0]]
            held.append(ff.moved(frame, turned, reference="turned"))
        for each in held:
            for part in _PARTS:
                for name, value in flat(f"{index} {each.reference} {part}", getattr(each, part)):
                    if isinstance(value, np.ndarray):
                        arrays[name.replace("/", "|")] = value
                    else:
                        told[name] = value
        told[f"{index} repr"] = repr(frame)
    Path("frames.json").write_text(json.dumps(told, indent=1) + "\n")
    np.savez("frames.npz", **arrays)  # type: ignore[arg-type]


def _scene(number: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(number)
    ground = np.column_stack([rng.uniform(2, 60, 6000), rng.uniform(-15, 15, 6000), rng.normal(-1.7, 0.02, 6000)])
    car = rng.uniform(-1, 1, (500, 3)) * [2.2, 0.9, 0.75] + [18 + number, 3, -0.95]
    rows = [[18 + number, 3, -0.95, 4.4, 1.8, 1.5, 0.0], [40, -6, -0.9, 4.4, 1.8, 1.5, 1.2]]
    truth = ff.Boxes.from_numpy(np.array(rows), label="vehicle")
    frame = ff.Frame.of(ff.Cloud(np.concatenate([ground, car])), truth, sequence="mine", frame_id=f"{number:06d}")
    off_by = np.array([0.3, 0.1, 0.05, -0.1, 0, 0, 0.04])
    found = ff.Boxes.from_numpy(np.array(rows) + off_by, label="vehicle")
    return frame, dataclasses.replace(found, score=np.array([0.9 - 0.1 * number, 0.35]))


def arrays() -> None:
    """Own arrays: boxes to and from tables, scores of every protocol, tracks, a picture."""
    scenes = [_scene(number) for number in range(4)]
    kept = [frame for frame, _ in scenes]
    found = {frame.key: boxes for frame, boxes in scenes}
    frame, boxes = scenes[0]
    for each in (frame, frame.cloud(), boxes, boxes[boxes.score > 0.5]):
        print(repr(each))
    boxes.to_csv("found.csv", frame="000001")
    print(sorted(ff.Boxes.from_csv("found.csv").columns()))
    print([len(rows) for rows in frame.cloud().in_boxes(frame.boxes)], frame.boxes.range_m.tolist())
    choices: dict[str, dict[str, Any]] = {
        "dds": {"range_bins_m": (0, 30, 60)},
        "nuscenes": {},
        "kitti": {},
        "kradar": {},
    }
    for protocol, more in choices.items():
        try:
            result = ff.evaluate(found, kept, protocol=protocol, **more)
        except ff.FarfieldError as error:
            print(f"{protocol}: {error}")
            continue
        print(result)
        Path(f"{protocol}.json").write_text(json.dumps(result.to_json(), indent=1, default=str) + "\n")
    detections = ff.detect(lambda frame: found[frame.key], kept)  # type: ignore[union-attr]
    print(detections.score("dds"))
    tracked = ff.track(detections)
    for name, value in flat("tracked", {str(key): each.columns() for key, each in tracked.boxes.items()}):
        print(name, value.tolist() if isinstance(value, np.ndarray) else value)
    ff.show(frame, boxes).savefig("shown.png")
    ff.show(frame.cloud()).savefig("cloud.png")


def detecting() -> None:
    """A shipped detector in Python, with its limits, on frames in memory and on a data set; joined clouds."""
    data = ff.open_dataset("cirrus")
    for name in ("pointpillars-cirrus-sim", "sparsecentre-cirrus-sim"):
        detector = ff.load_detector(
            name, device="cpu", precision="fp32", score_threshold=0.2, classes={"vehicle": "car"}
        )
        print(repr(detector))
        found = detector(data[0])
        scores = np.asarray(found.score).tolist()
        rows = [[float(each) for each in row] for row in np.column_stack([found.centre_m, found.size_m, found.yaw_rad])]
        Path(f"{name}.json").write_text(json.dumps({"boxes": rows, "scores": scores}, indent=1) + "\n")
    detector = ff.load_detector("pointpillars-cirrus-sim", device="cpu", precision="fp32")
    print(ff.evaluate(detector, data, protocol="dds", cloud="uniform"))
    both = ff.joined(data[0], ["gaussian", "uniform"])
    print(repr(both), len(detector(both)), sorted(both.extra))


def refused() -> None:
    """What is said where something is wrong."""
    frame, boxes = _scene(0)
    wrong: tuple[Callable[[], Any], ...] = (
        lambda: ff.open_dataset("nowhere"),
        lambda: ff.open_dataset(".", format="none"),
        lambda: ff.load_detector("none"),
        lambda: ff.evaluate({frame.key: boxes}, [frame], protocol="none"),
        lambda: ff.evaluate({frame.key: boxes}, [frame], protocol="dds", no_such=1),
        lambda: ff.train("none"),
        lambda: ff.train("pointpillars-cirrus-sim", {"training.no_such": 1}),
        lambda: ff.train("pointpillars-cirrus-sim", {"detector.grid.cell_m": -1}),
        lambda: ff.adapt("none", "nowhere", out="out"),
        lambda: ff.joined(frame, ["none"]),
        lambda: ff.Boxes.from_csv("nowhere.csv"),
        lambda: ff.Cloud.from_file("nowhere.pcd"),
        lambda: ff.Cloud(np.zeros((2, 2))),
    )
    for number, each in enumerate(wrong):
        try:
            print(number, "nothing", each())
        except Exception as error:  # noqa: BLE001 - whatever a user meets
            print(number, type(error).__name__, error)


def main(words: Sequence[str]) -> None:
    """Do a work."""
    works: dict[str, Callable[..., None]] = {each.__name__: each for each in (frames, arrays, detecting, refused)}
    works[words[0]](*words[1:])


if __name__ == "__main__":
    main(sys.argv[1:])
