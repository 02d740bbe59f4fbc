"""Checkpoints of a running training: whole or absent, never torn, never pickled code."""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from farfield.detectors import DETECTORS
from farfield.errors import ConfigError, FarfieldError, FileFormatError, plain
from farfield.files.atomic import write_bytes, write_text

CHECKPOINT_NAME = "checkpoint.pt"
"""In a run's folder: its state."""
BEST = "best"
"""Stem of the best weights' file, and of what is known of them."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write tensors and plain values atomically: a killed process leaves the previous checkpoint."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_bytes(path, buffer.getvalue())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint; anything but tensors and plain values is refused.

    Raises:
        FileFormatError: If the file is damaged or holds other objects.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for damaged or hostile files
        raise FileFormatError(
            path,
            where="file",
            expected="a checkpoint of farfield train",
            got=str(error)[:200],
            fix="Remove it to begin anew.",
        ) from error
    return state


STEPS = "training.steps"
"""The one setting of an experiment in which a run that goes on may differ."""


@dataclass(frozen=True)
class TrainingState:
    """The state of a running training.

    Args:
        step: Steps done.
        modules: State of the method's modules, keys such as ``detector.head.weight``.
        optimizer: State of the optimizer.
        average: Averages of the modules' state, by the same keys.
        provenance: Experiment, fingerprints of the streams, versions.
    """

    step: int
    modules: Mapping[str, Tensor]
    optimizer: dict[str, Any]
    average: Mapping[str, Tensor]
    provenance: Mapping[str, Any]

    def state(self) -> dict[str, Any]:
        """As tensors and plain values: ``modules/<name>/...`` and ``streams/<name>/fingerprint`` among them."""
        state = {f"modules/{name.replace('.', '/', 1)}": value for name, value in self.modules.items()}
        for name, fingerprint in _fingerprints(self.provenance).items():
            state[f"streams/{name}/fingerprint"] = fingerprint
        return {
            "step": self.step,
            **state,
            "optimizer": self.optimizer,
            "average": dict(self.average),
            "provenance": json.dumps(self.provenance),
        }


def load_run(path: Path, provenance: Mapping[str, Any], modules: nn.ModuleDict) -> TrainingState | None:
    """Read the state of a training that is to go on; None where there is no checkpoint.

    Checkpoints of the first form, with the key ``network``, are read as those of the module ``detector``.

    Raises:
        FileFormatError: If the file is damaged.
        ConfigError: If it belongs to another experiment, to other data or to other modules.
    """
    if not path.is_file():
        return None
    state = load_checkpoint(path)
    try:
        saved, step = json.loads(state["provenance"]), int(state["step"])
        modules_state, average, optimizer = _module_states(state), state["average"], state["optimizer"]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(
            path, where="keys", expected="those of farfield train", got=plain(error), fix="Remove it to begin anew."
        ) from error
    _check_same(path, saved, provenance, step)
    if "network" in state:
        average = {f"detector.{name}": value for name, value in average.items()}
    if set(modules_state) != set(modules.state_dict()):
        raise ConfigError(f"{path} holds other modules than the method: {', '.join(modules)}. Remove it to begin anew.")
    return TrainingState(step, modules_state, optimizer, average, saved)


def _check_same(path: Path, saved: Mapping[str, Any], provenance: Mapping[str, Any], step: int) -> None:
    """Refuse another experiment or other data. More steps than before are the same run, prolonged."""
    before, now = dict(flatten(_current_names(saved.get("experiment")))), dict(flatten(provenance.get("experiment")))
    names = [name for name in {**before, **now} if before.get(name) != now.get(name) and name != STEPS]
    if names:
        changes = [f"{name} was {before.get(name)!r}, is {now.get(name)!r}" for name in sorted(names)[:5]]
        more = f" and {len(names) - 5} more" if len(names) > 5 else ""
        raise ConfigError(
            f"{path} was made by another experiment: {'; '.join(changes)}{more}. Give this one another name "
            "(-o name=OTHER), set that back, or remove the run's folder."
        )
    if _fingerprints(saved) != _fingerprints(provenance):
        raise ConfigError(
            f"{path} was made of other data: their files or options changed since (data_fingerprint). Give this run "
            "another name (-o name=OTHER), or remove the run's folder."
        )
    if (steps := now.get(STEPS, step)) < step:
        raise ConfigError(f"{path} has done {step} steps; {STEPS} may be raised, not set to {steps}.")


def flatten(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Values of a tree of settings by dotted name.

    >>> dict(flatten({"a": {"b": 1, "c": [2, 3]}}))
    {'a.b': 1, 'a.c': [2, 3]}
    """
    if isinstance(tree, Mapping) and tree:
        for name, value in tree.items():
            yield from flatten(value, f"{path}.{name}" if path else str(name))
    else:
        yield path, tree


def prolonged(saved: Mapping[str, Any], provenance: Mapping[str, Any], step: int) -> list[dict[str, int]]:
    """Where a run's number of steps was raised: ``step`` done, ``from`` and ``to``, earlier ones first."""
    earlier = list(saved.get("prolonged", ()))
    before, now = (dict(flatten(one.get("experiment"))).get(STEPS) for one in (saved, provenance))
    return earlier if before == now else [*earlier, {"step": step, "from": int(before or step), "to": int(now or step)}]


def _current_names(experiment: Any) -> Any:
    """An experiment of an earlier version with its detector's settings under today's names."""
    try:
        described = experiment["detector"]
        config = DETECTORS[str(described["name"])].config_class.model_validate(described)
    except (TypeError, KeyError, ValueError, FarfieldError):
        return experiment
    return {**experiment, "detector": config.model_dump(mode="json")}


def _module_states(state: Mapping[str, Any]) -> dict[str, Tensor]:
    if "network" in state:
        return {f"detector.{name}": value for name, value in state["network"].items()}
    states = {name.removeprefix("modules/"): value for name, value in state.items() if name.startswith("modules/")}
    return {name.replace("/", ".", 1): value for name, value in states.items()}


def _fingerprints(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Fingerprint of each stream's data; a provenance with one ``data_fingerprint`` has one stream."""
    streams = provenance.get("streams")
    if streams is None:
        return {"labelled": provenance.get("data_fingerprint")}
    return {name: stream.get("data_fingerprint") for name, stream in streams.items()}


# The best weights so far, of a training that is validated


def best_of(stem: str) -> str:
    """Name of the best weights beside those of the last step: ``best`` beside ``weights``."""
    return BEST if stem == "weights" else f"{BEST}-{stem}"


@dataclass(frozen=True)
class BestScore:
    """The best score so far in a run's folder."""

    step: int
    score: float

    @classmethod
    def read(cls, folder: Path) -> "BestScore | None":
        """What an earlier part of the run reached; None where nothing stands there."""
        path = folder / f"{BEST}.json"
        try:
            tree = json.loads(path.read_text(encoding="utf-8"))
            return cls(int(tree["step"]), float(tree["validation"]))
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def write(self, folder: Path) -> None:
        """Keep it."""
        write_text(folder / f"{BEST}.json", json.dumps({"step": self.step, "validation": self.score}) + "\n")


def remove_best(folder: Path, stems: Sequence[str]) -> None:
    """Remove what another run left, as a run begins anew."""
    for name in (f"{BEST}.json", *(f"{stem}.safetensors" for stem in stems)):
        (folder / name).unlink(missing_ok=True)
