"""Weights, checkpoints and what a run leaves beside them, for fuzz_readers.py."""

import io
import json
import warnings
from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from _fuzz_formats import Parts

PROVENANCE = {
    "experiment": {
        "name": "own",
        "data": {"path": "/data/own", "clouds": ["lidar"], "simulate": {"preset": "cirrus-sim", "seed": 3}},
        "method": {"name": "teacher"},
        "training": {"steps": 5, "batch_size": 2, "seed": 0},
    },
    "data_fingerprint": "0" * 64,
    "frames": 17,
    "streams": {"labelled": {"frames": 17, "recipe": {"format": "own", "options": {}, "maps": []}}},
    "start": {"weights": "pointpillars-cirrus-sim", "sha256": "0", "share": 0.5, "frame_digests": "0123456789ab ?"},
    "adapted": {"start": "x", "start_frame_digests": None},
    "environment": {"commit": "0123456"},
}
LOG = b"".join(b'{"step": %d, "learning_rate": 0.001, "loss": %.3f, "time": 1.5}\n' % (n, 9 / n) for n in range(1, 9))


def weights_targets(folder: Path) -> Mapping[str, Parts]:
    """Suffix, reader, good files, what a valid result is, and files that must be refused, by the reader's name."""
    if not find_spec("torch"):
        return {}
    from farfield.training.checkpoints import BestScore

    import_module("farfield.experiments.plan")  # now: no file pays for the import with its time
    BestScore(137, 0.5217).write(folder)
    best, earlier = (folder / "best.json").read_bytes(), b'{"step": 137, "validation": 0.5217}\n'
    weights, older = _weights(folder)
    checkpoint, older_checkpoint = _checkpoint(folder)
    provenance = json.dumps(PROVENANCE).encode()
    return {
        "weights": (".safetensors", read_weights, (weights,), unchanged, ()),
        "older weights": (".safetensors", read_weights, (older,), sound, ()),
        "weights' record": (".json", read_record, (provenance,), is_text, (b'{"a":' * 50_000,)),
        "checkpoint": (".pt", read_checkpoint, (checkpoint,), is_seed, (checkpoint[:-80] + checkpoint[-40:],)),
        "older checkpoint": (".pt", read_checkpoint, (older_checkpoint,), is_seed, (older_checkpoint[:-1],)),
        "best score": (".json", read_best, (best, earlier), is_score, (b'{"step": 1e999, "validation": 1}',)),
        "training log": (".jsonl", read_log, (LOG,), are_rows, (b'{"step": 1e999}\n' + LOG, b"[]\n" + LOG)),
    }


def _config() -> Any:
    from farfield.detectors import DETECTORS

    grid = {"range_m": 16.0, "half_width_m": 8.0, "cell_m": 0.5}
    narrow = {"pillar_channels": 4, "widths": [4, 4], "depths": [1, 1], "strides": [2, 2], "neck_width": 4}
    return DETECTORS["pointpillars"].config_class(grid=grid, **narrow)


@lru_cache(maxsize=1)
def _state() -> Any:
    """The state of a small network, of a seed."""
    from farfield.detectors import build_detector

    return build_detector(_config(), seed=0).state_dict()


def _weights(folder: Path) -> tuple[bytes, bytes]:
    """A file of weights, and one as earlier versions wrote it, without a digest."""
    from safetensors.torch import save

    from farfield.detectors.weights import save_weights

    path = folder / "made.safetensors"
    save_weights(path, _state(), config=_config(), provenance=PROVENANCE, half=True)
    texts = {"format": "farfield-detector-1", "config": _config().model_dump_json(), "provenance": "{}"}
    return path.read_bytes(), save({name: value.contiguous() for name, value in _state().items()}, metadata=texts)


def _checkpoint(folder: Path) -> tuple[bytes, bytes]:
    """A checkpoint, and one as earlier versions wrote it, without a digest."""
    import torch

    from farfield.training.checkpoints import save_checkpoint

    state = {"step": 2, "average": {"detector.a": torch.arange(200.0)}, "provenance": json.dumps(PROVENANCE)}
    save_checkpoint(folder / "made.pt", state)
    older = io.BytesIO()
    torch.save(state, older)
    return (folder / "made.pt").read_bytes(), older.getvalue()


def read_weights(path: Path) -> Any:
    from farfield.detectors.weights import load_weights

    with warnings.catch_warnings(action="ignore"):  # of earlier versions, which carry no digest
        return load_weights(path)


def read_record(path: Path) -> str:
    """What is said of weights whose provenance is this text."""
    from safetensors.torch import save

    from farfield.detectors.runtime import Detector
    from farfield.detectors.weights import load_weights
    from farfield.evaluation.evaluating import training_text
    from farfield.evaluation.leakage import digests_text
    from farfield.files.safetensors import with_digest

    text = path.read_bytes().decode("utf-8", "surrogateescape").encode("utf-8", "replace").decode()
    texts = {"format": "farfield-detector-1", "config": _config().model_dump_json(), "provenance": text}
    path = path.with_suffix(".safetensors")
    path.write_bytes(with_digest(save({name: value.contiguous() for name, value in _state().items()}, metadata=texts)))
    with warnings.catch_warnings(action="ignore"):  # of what is left out
        network, provenance = load_weights(path)
    info = Detector(network, provenance=provenance, device="cpu", precision="fp32").info
    return f"{info.name} {info.reference} {training_text(provenance)} {digests_text(provenance)}"


def read_checkpoint(path: Path) -> Any:
    from farfield.training.checkpoints import load_checkpoint

    return load_checkpoint(path)


def read_best(path: Path) -> Any:
    from farfield.training.checkpoints import BestScore

    path.rename(path.with_name("best.json"))
    return BestScore.read(path.parent)


def read_log(path: Path) -> Any:
    from farfield.experiments.plan import logged

    path.rename(path.with_name("log.jsonl"))
    return logged(path.parent)


def unchanged(result: Any) -> bool:
    """What carries a digest is read as it was written, or not at all."""
    import torch

    network, provenance = result
    state = {name: value.half().float() if value.ndim > 1 else value for name, value in _state().items()}
    return provenance == PROVENANCE and all(torch.equal(state[name], own) for name, own in network.state_dict().items())


def sound(result: Any) -> bool:
    """Finite numbers, of a size that a training leaves."""
    from farfield.detectors.soundness import unsound

    return unsound(result[0].state_dict()) is None


def is_text(result: Any) -> bool:
    return isinstance(result, str)


def is_seed(result: Any) -> bool:
    import torch

    same = result["step"] == 2 and json.loads(result["provenance"]) == PROVENANCE
    return same and torch.equal(result["average"]["detector.a"], torch.arange(200.0))


def is_score(result: Any) -> bool:
    return isinstance(result.step, int) and 0 <= result.score <= 1


def are_rows(result: Any) -> bool:
    return all(
        isinstance(row["step"], int) and isinstance(value, int | float) for row in result for value in row.values()
    )
