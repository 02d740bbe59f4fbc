"""Settings, records and journals changed in their structure, for fuzz_readers.py: what bytes changed at random miss.

A value becomes another kind of value, a key goes, comes twice or is called otherwise, a group is doubled or buried; the
checksums are right, so that the readers behind them are reached.
"""

import copy
import json
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from _fuzz_weights import PROVENANCE

from farfield.datasets.calibration import read_calibration_file, write_calibration
from farfield.datasets.cirrus.layout import read_mapping
from farfield.datasets.class_mapping import read_class_mapping
from farfield.datasets.edits.journal import CellEdit, Record, check_values, encode, read_journal
from farfield.files.nuscenes import read_results
from farfield.geometry.cameras import Camera
from farfield.jobs.journal import JobJournal
from farfield.metrics import comparing
from farfield.metrics.box_files import read_predictions

ODD: tuple[Any, ...] = (
    *(None, True, 0, -1, 1, 3, 1000, 1.5, 1e-300, 1e300, 2**31, 2**63, 2**64, 10**400, float("nan"), float("inf")),
    *("", "x", "1:30:00", "010", "no", "2026-99-99", "a\x00b", "a\nb", "\ud800", "[/]", "../x", "x" * 20_000),
    *([], [None], ["x"], [[1.0, 2.0]], [0] * 50, [1e308] * 16, {}, {"x": 1}, {"": None}, {"0": {"x": []}}),
)
LAUGHS = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    b"%c: &%c [%s]\n" % (name, name, b",".join([b"*%c" % before] * 9))
    for before, name in zip(b"abcdefgh", b"bcdefghi", strict=True)
)
YAML_LINES = (
    *(b"<<: *a", b"a: &a [*a]", b"? [a]\n: b", b"a: !!python/object:x {}", b"seed: 0o7", b"x: .inf", b"a: 1\na: 2"),
    *(b"- " * 200, b"%YAML 1.1", b"---", b"x: !!int x", b"x: !!timestamp y", b"\t- x", b"x: '", b"x: |\n y"),
)
EXPERIMENT = (
    b"name: own\ndata: {path: data, clouds: [lidar]}\ndetector: {name: pointpillars, grid: {range_m: 32.0}, "
    b"widths: [8, 8], depths: [1, 1], strides: [2, 2], out_stride: 2}\nmethod: {name: supervised}\n"
    b"training: {steps: 5, batch_size: 2, seed: 0}\n"
)
MAPPING = b"labels: {root: labels}\nsegments: {gap_s: 0.5}\nxyz: {}\nframe: {}\n"


@dataclass(frozen=True)
class Form:
    """A form of file: its suffix, reader, sound trees, how a tree is written, and texts that are refused."""

    suffix: str
    read: Callable[[Path], Any]
    trees: tuple[Any, ...]
    write: Callable[[Any], bytes]
    hostile: tuple[bytes, ...] = ()

    @property
    def seeds(self) -> tuple[bytes, ...]:
        """The sound trees as files."""
        return tuple(map(self.write, self.trees))

    def grown(self, rng: np.random.Generator) -> bytes:
        """One of the trees changed in one to three places, as a file."""
        tree = copy.deepcopy(self.trees[rng.integers(len(self.trees))])
        for _ in range(int(rng.integers(1, 4))):
            change(tree, rng)
        return self.write(tree)


def forms(folder: Path) -> Mapping[str, Form]:
    """Every configuration form by its name."""
    camera = Camera(matrix=np.array([[60.0, 0, 60], [0, 60, 40], [0, 0, 1]]), width_px=120, height_px=80)
    write_calibration(folder / "calibration.json", {"camera": camera})
    calibration = json.loads((folder / "calibration.json").read_bytes())
    yaml_hostile = (LAUGHS, b"[" * 5000, b"a: 1\na: 2\n", b"a: &a [*a]\n")
    json_hostile = (b"[" * 100_000, b'{"a": 1, "a": 2}', b"[1e999]")
    made = {
        "yaml class mapping": Form(
            ".yaml", read_class_mapping, ({"classes": {"Auto": "vehicle", "No": "x"}},), as_yaml, yaml_hostile
        ),
        "yaml cirrus mapping": Form(".yaml", read_mapping, (_tree_of(MAPPING),), as_yaml, yaml_hostile),
        "yaml calibration": Form(".yaml", read_calibration_file, (calibration,), as_yaml, yaml_hostile),
        "json calibration": Form(".json", read_calibration_file, (calibration,), as_json, json_hostile),
        "json nuscenes": Form(".json", read_results, (_nuscenes(),), as_json, json_hostile),
        "json results": Form(".json", _read_compared, (_result(),), as_json, json_hostile),
        "json evaluation": Form(".json", _read_evaluation, (_result(),), as_json, json_hostile),
        "json mmdetection3d": Form(".json", _read_instances, (_instances(),), as_json, json_hostile),
        "kit's texts": Form(".txt", _read_kit, (_kit_rows(),), as_rows),
        "edits": Form(".jsonl", partial(read_journal, take=check_values), (_edits(),), as_edits),
        "job journal": Form(".jsonl", _read_jobs, (_jobs(),), as_lines),
    }
    if find_spec("torch"):
        made |= {
            "yaml experiment": Form(".yaml", _read_experiment, (_tree_of(EXPERIMENT),), as_yaml, yaml_hostile),
            "weights' settings": Form(".safetensors", _read_weights, _settings(), as_weights),
            "checkpoint's tensors": Form(".pth", _read_torch, (_tensors(),), as_checkpoint),
        }
    return made


def change(tree: Any, rng: np.random.Generator) -> None:
    """Change one place: replaced, left out, called otherwise, repeated, buried, or another place's value."""
    slots = list(_slots(tree))
    if not slots:
        return
    holder, key = slots[int(rng.integers(len(slots)))]
    kind, value = int(rng.integers(7)), holder[key]
    if kind <= 2:
        holder[key] = copy.deepcopy(ODD[int(rng.integers(len(ODD)))])
    elif kind == 3:
        del holder[key]
    elif kind == 4:
        other, other_key = slots[int(rng.integers(len(slots)))]
        holder[key] = copy.deepcopy(other[other_key])
    elif kind == 5 and isinstance(holder, dict):
        holder[f"{key}x"] = holder.pop(key)
    elif isinstance(value, list):
        holder[key] = value * int(rng.choice([0, 2, 10, 300]))
    else:
        for _ in range(int(rng.choice([1, 5, 80]))):
            value = [value]
        holder[key] = value


def _slots(node: Any, depth: int = 0) -> Iterator[tuple[Any, Any]]:
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in list(pairs) if depth < 12 else ():
        yield node, key
        yield from _slots(value, depth + 1)


def as_json(tree: Any) -> bytes:
    """JSON, whatever Python makes of NaN."""
    return json.dumps(tree).encode()


def as_yaml(tree: Any) -> bytes:
    """JSON as YAML, with a line that YAML has besides where its text asks for one by its length."""
    text = json.dumps(tree, ensure_ascii=False).encode("utf-8", "surrogatepass")
    number = zlib.crc32(text)
    lines = YAML_LINES[number % len(YAML_LINES)] if number % 3 == 0 and tree not in _SOUND else b""
    return b"\n".join(filter(None, [_block(tree) if isinstance(tree, dict) else text, lines])) + b"\n"


def _block(tree: Mapping[str, Any]) -> bytes:
    rows = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in tree.items())
    return "\n".join(rows).replace("NaN", ".nan").replace("Infinity", ".inf").encode()


def as_rows(rows: Any) -> bytes:
    """A line a row, its words with blanks between."""
    rows = rows if isinstance(rows, list) else [rows]
    lines = (" ".join(map(str, row)) if isinstance(row, list) else str(row) for row in rows)
    return "\n".join(lines).encode("utf-8", "surrogatepass") + b"\n"


def _read_instances(path: Path) -> Any:
    return read_predictions(path, format="mmdetection3d", class_names=("Pedestrian", "Cyclist", "Car")).boxes


def _instances() -> Any:
    box = [[20.0, 2.0, -1.7, 4.2, 1.8, 1.5, 0.3], [8.0, -1.0, -1.6, 0.8, 0.6, 1.7, -1.0]]
    return {"labels_3d": [2, 0], "scores_3d": [0.9, 0.4], "bboxes_3d": box, "box_type_3d": "LiDAR"}


def _read_kit(path: Path) -> Any:
    return read_predictions(path, format="kradar").boxes


def _kit_rows() -> Any:
    head = ["sed", -1, -1, 0, 50, 50, 150, 150]
    return [[*head, 1.6, 1.9, 4.4, 3.0 * row - 15, -0.2, 20.0 + row, 0.05, 0.75] for row in range(12)]


def as_lines(rows: Any) -> bytes:
    """One JSON a line; a value stands behind a tab."""
    rows = rows if isinstance(rows, list) else [rows]
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def as_edits(rows: Any) -> bytes:
    """Edits behind right checksums."""
    texts = (json.dumps(row, separators=(",", ":")).encode() for row in (rows if isinstance(rows, list) else [rows]))
    return b"".join(b"%08x %s\n" % (zlib.crc32(text), text) for text in texts)


def as_weights(tree: Any) -> bytes:
    """Weights of a digest that is right, whose configuration is this tree."""
    from _fuzz_weights import _state
    from safetensors.torch import save

    from farfield.files.safetensors import with_digest

    texts = {"format": "farfield-detector-1", "config": json.dumps(tree), "provenance": json.dumps(PROVENANCE)}
    return with_digest(save({name: value.contiguous() for name, value in _state().items()}, metadata=texts))


def as_checkpoint(tree: Any) -> bytes:
    """What torch saves of a tree in which ``["tensor", kind, shape]`` stands for a tensor."""
    import io

    import torch

    buffer = io.BytesIO()
    with warnings.catch_warnings(action="ignore"):
        torch.save(_with_tensors(tree), buffer)
    return buffer.getvalue()


_KINDS = ("float32", "float16", "int64", "bool", "complex64", "uint64", "float8_e4m3fn", "meta", "sparse", "expanded")


def _with_tensors(node: Any) -> Any:
    import torch

    if isinstance(node, list) and len(node) == 3 and node[0] == "tensor" and node[1] in _KINDS:
        shape = [side for side in node[2] if type(side) is int and 0 <= side < 64] if isinstance(node[2], list) else [2]
        shape = shape[:5] if np.prod([1, *shape[:5]]) < 1e6 else [3]
        if node[1] == "meta":
            return torch.empty(shape, device="meta")
        if node[1] == "sparse":
            return torch.ones(shape).to_sparse()
        if node[1] == "expanded":
            return torch.ones(1).expand(10**9, 4)
        return torch.ones(shape).to(getattr(torch, node[1]))
    if isinstance(node, dict):
        return {key: _with_tensors(value) for key, value in node.items()}
    return [_with_tensors(value) for value in node] if isinstance(node, list) else node


def _tensors() -> Any:
    shapes = {"vfe.pfn_layers.0.linear.weight": [4, 10], **_norms("vfe.pfn_layers.0.norm", 4)}
    for block, stride in enumerate((1, 2, 4)):
        source = f"backbone_2d.blocks.{block}"
        shapes |= {f"{source}.1.weight": [4, 4, 3, 3], **_norms(f"{source}.2", 4)}
        shapes |= {f"backbone_2d.deblocks.{block}.0.weight": [4, 4, stride, stride]}
        shapes |= _norms(f"backbone_2d.deblocks.{block}.1", 4)
    for name, count in (("conv_cls", 18), ("conv_box", 42), ("conv_dir_cls", 12)):
        shapes |= {f"dense_head.{name}.weight": [count, 12, 1, 1], f"dense_head.{name}.bias": [count]}
    return {"model_state": {name: ["tensor", "float32", shape] for name, shape in shapes.items()}, "epoch": 80}


def _norms(name: str, width: int) -> dict[str, list[int]]:
    return {f"{name}.{part}": [width] for part in ("weight", "bias", "running_mean", "running_var")}


@lru_cache(maxsize=1)
def _settings() -> tuple[Any, ...]:
    from _fuzz_weights import _config

    return (json.loads(_config().model_dump_json()),)


def _tree_of(text: bytes) -> Any:
    from farfield.files.yaml_text import plain_yaml

    return plain_yaml(text)


_SOUND = (_tree_of(EXPERIMENT), _tree_of(MAPPING), {"classes": {"Auto": "vehicle", "No": "x"}})


def _nuscenes() -> Any:
    box = {
        "sample_token": "a",
        "translation": [1.0, 2.0, 0.5],
        "size": [1.9, 4.5, 1.6],
        "rotation": [1.0, 0.0, 0.0, 0.0],
        "velocity": [0.0, 0.0],
        "detection_name": "car",
        "detection_score": 0.5,
        "attribute_name": "",
    }
    return {"meta": {"reference": "lidar"}, "results": {"a": [box, box], "b": []}}


@lru_cache(maxsize=1)
def _result() -> Any:
    from farfield.geometry.boxes import Boxes
    from farfield.metrics.centre.dds import evaluate_dds

    rng = np.random.default_rng(0)
    boxes = Boxes(
        centre_m=rng.uniform(5, 60, (6, 3)) * [1, 0.3, 0],
        size_m=np.tile([4.5, 1.9, 1.6], (6, 1)),
        yaw_rad=rng.uniform(-3, 3, 6),
        label="vehicle",
    )
    scored = boxes.replace(score=rng.uniform(0.1, 1, 6))
    result = evaluate_dds({("a", "0"): scored}, {("a", "0"): boxes})
    return json.loads(json.dumps(result.to_json()))


def _edits() -> Any:
    box = {"label": "vehicle", "box": [1.0, 2.0, 3.0, 4.0, 2.0, 1.5, 0.3]}
    more = {**box, "track": "7", "attributes": {"a": "b"}, "score": 0.5, "proposal": [1.0] * 7}
    cell = ("box", "a", "0001", "4")
    records = (
        Record(1, "w-1", 5, "ann", "w", "box.set", (CellEdit(cell, 0, None, box),)),
        Record(2, "w-2", 6, "ann", "w", "box.set", (CellEdit(cell, 1, box, more),), "g"),
        Record(3, "w-3", 7, "ann", "w", "track.set", (CellEdit(("track", "a", "7"), 0, None, {"locked": True}),)),
        Record(
            4, "w-4", 8, "ann", "w", "undo", (CellEdit(("track", "a", "7"), 3, {"locked": True}, None),), None, (3,)
        ),
        Record(5, "w-5", 9, "ann", "w", "save", data={"files": {"a.json": "0f"}}),
    )
    return [json.loads(encode(record)[9:]) for record in records]


def _jobs() -> Any:
    return [{"unit": f"a/{n}", "source": "0f", "files": {f"out/{n}.npy": [10, 5], "b": [1, 2]}} for n in range(4)]


def _read_jobs(path: Path) -> Any:
    return range(len(JobJournal(path, files=False)))


def _read_compared(path: Path) -> Any:
    return comparing.compare(comparing.read_results([path]))


def _read_evaluation(path: Path) -> Any:
    from farfield.evaluation.record import Evaluation

    return Evaluation.load(path).to_json() if hasattr(Evaluation, "to_json") else [Evaluation.load(path).title]


def _read_experiment(path: Path) -> Any:
    import torch

    from farfield.detectors import build_detector
    from farfield.experiments.schema import dump_experiment, load_experiment

    experiment = load_experiment(path)
    with torch.device("meta"):
        build_detector(experiment.detector)
    return dump_experiment(experiment)


def _read_weights(path: Path) -> Any:
    from farfield.detectors.weights import load_weights

    return load_weights(path)


def _read_torch(path: Path) -> Any:
    from farfield.detectors.openpcdet import import_openpcdet

    return import_openpcdet(path)
