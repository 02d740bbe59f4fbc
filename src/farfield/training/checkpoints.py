"""Checkpoints of a running training: whole or absent, never torn, never pickled code.

A file is what ``torch.save`` writes, a zip archive, and behind it the SHA-256 of its bytes. Those of earlier versions
end with the archive, whose checksums cover the numbers.
"""

import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor, nn

from farfield.detectors import DETECTORS
from farfield.detectors.soundness import unlike, unsound
from farfield.detectors.torch_files import load_torch
from farfield.errors import ConfigError, FarfieldError, FileFormatError, plain
from farfield.files.archives import check_archive
from farfield.files.atomic import open_atomic, read_bytes, write_text
from farfield.files.json_text import plain_json
from farfield.files.limits import MAX_WEIGHTS_BYTES, open_file
from farfield.vocabulary.counts import count_of

CHECKPOINT_NAME = "checkpoint.pt"
"""In a run's folder: its state."""
BEST = "best"
"""Stem of the best weights' file, and of what is known of them."""


_MARK = b"farfield-sha256:"
_TRAILER_BYTES = len(_MARK) + 64
_ARCHIVE_END, _ARCHIVE_END_BYTES = b"PK\x05\x06", 22
_ANEW = "Remove it to begin anew."
_OURS = "a checkpoint of farfield train, an archive with the checksums of what it holds"
_BLOCK_BYTES = 1 << 20
_DAMAGED_ARCHIVE = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    IndexError,
)


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write tensors and plain values atomically: a killed process leaves the previous checkpoint."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    digest = hashlib.sha256(buffer.getbuffer()).hexdigest()
    buffer.seek(0, io.SEEK_END)
    buffer.write(_MARK + digest.encode())
    with open_atomic(path) as file:
        file.write(buffer.getbuffer())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint; anything but tensors and plain values is refused.

    Raises:
        FileFormatError: If the file changed since it was written, is damaged, or holds other objects.
    """
    _check_bytes(path)
    state = load_torch(path, expected=_OURS, fix=_ANEW)
    if not isinstance(state, dict):
        raise FileFormatError(path, where="the file", expected=_OURS, got=type(state).__name__, fix=_ANEW)
    return state


def _check_bytes(path: Path) -> None:
    """Compare a checkpoint with the digest behind it; one of an earlier version with its archive's checksums."""
    with open_file(path, max_bytes=MAX_WEIGHTS_BYTES) as file:
        size = os.fstat(file.fileno()).st_size
        file.seek(max(0, size - _TRAILER_BYTES))
        trailer = file.read()
        if not trailer.startswith(_MARK):
            _check_archive(path, file)
            return
        file.seek(0)
        digest, left = hashlib.sha256(), size - _TRAILER_BYTES
        while block := file.read(min(left, _BLOCK_BYTES)):
            digest.update(block)
            left -= len(block)
    stated, actual = trailer[len(_MARK) :], digest.hexdigest().encode()
    if actual != stated:
        expected = f"the bytes as they were written, of the SHA-256 {stated[:16].decode('ascii', 'replace')}"
        raise FileFormatError(path, where="digest", expected=expected, got=actual[:16].decode(), fix=_ANEW)


def _check_archive(path: Path, file: BinaryIO) -> None:
    """See that an archive ends with the file, and that what it holds has its checksums."""
    got = ""
    check_archive(path, file, expected=_OURS)
    try:
        with zipfile.ZipFile(file) as archive:
            damaged = archive.testzip()
            behind = archive.comment
        file.seek(-_ARCHIVE_END_BYTES, io.SEEK_END)
        if damaged is not None:
            got = f"another checksum at {damaged}"
        elif behind or not file.read().startswith(_ARCHIVE_END):
            got = "other bytes behind it, such as a damaged digest"
    except _DAMAGED_ARCHIVE as error:
        got = plain(error)[:200]
    if got:
        raise FileFormatError(path, where="file", expected=_OURS, got=got, fix=_ANEW)


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
        FileFormatError: If the file is damaged, or holds shapes or numbers that this training does not leave.
        ConfigError: If it belongs to another experiment, to other data or to other modules.
    """
    if not path.is_file():
        return None
    state = load_checkpoint(path)
    try:
        saved, step = plain_json(state["provenance"]), state["step"]
        modules_state, average, optimizer = _module_states(state), dict(state["average"]), dict(state["optimizer"])
        if not isinstance(saved, Mapping) or isinstance(step, bool) or not isinstance(step, int) or step < 0:
            raise ValueError(f"step {step!r} of {type(saved).__name__}")
        _check_same(path, saved, provenance, step)
        prolonged(saved, provenance, step)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(
            path, where="keys", expected="those of farfield train", got=plain(error), fix=_ANEW
        ) from error
    if "network" in state:
        average = {f"detector.{name}": value for name, value in average.items()}
    expected = modules.state_dict()
    if set(modules_state) != set(expected):
        raise ConfigError(f"{path} holds other modules than the method: {', '.join(modules)}. Remove it to begin anew.")
    _check_alike(path, "modules", modules_state, expected)
    _check_alike(path, "average", average, {name: value.float() for name, value in expected.items()})
    check_sound(path, "modules", modules_state)
    check_sound(path, "average", average)
    return TrainingState(step, modules_state, optimizer, average, saved)


def _check_alike(path: Path, where: str, tensors: Mapping[str, Any], expected: Mapping[str, Tensor]) -> None:
    """Refuse tensors of other names, shapes or types."""
    strange = next((name for name, tensor in tensors.items() if not isinstance(tensor, Tensor)), None)
    if strange is not None:
        got = type(tensors[strange]).__name__
        raise FileFormatError(path, where=f"{where}, {strange}", expected="a tensor", got=got, fix=_ANEW)
    if (misfit := unlike(tensors, expected)) is not None:
        name, here, there = misfit
        raise FileFormatError(path, where=f"{where}, {name}", expected=here, got=there, fix=_ANEW)


def check_sound(path: Path, where: str, tensors: Mapping[str, Tensor]) -> None:
    """Refuse numbers that no training leaves, in a checkpoint that is read or about to be written.

    Args:
        path: The checkpoint.
        where: What of it the tensors are.
        tensors: By name, any shapes.

    Raises:
        FileFormatError: If there is one.
    """
    if (fault := unsound(tensors)) is not None:
        name, got = fault
        fix = "Its training went astray, or the file is damaged. Remove the run's folder to begin anew."
        expected = "numbers as a training leaves them"
        raise FileFormatError(path, where=f"{where}, {name}", expected=expected, got=got, fix=fix)


_MOMENTS = ("exp_avg", "exp_avg_sq")


def resume_optimizer(path: Path, state: Mapping[str, Any], optimizer: torch.optim.Optimizer) -> None:
    """Give an optimiser the moments of a checkpoint, if they are of this very optimiser: torch trusts their shapes.

    Its groups' settings stay as the experiment has them.

    Args:
        path: The checkpoint, for messages.
        state: As AdamW's ``state_dict`` has it.
        optimizer: The optimiser that takes it.

    Raises:
        FileFormatError: If groups, parameters, shapes or number types are others, or a moment is none that a training
            leaves.
    """
    own = optimizer.state_dict()["param_groups"]
    groups, moments = state.get("param_groups"), state.get("state")
    if not isinstance(groups, list) or not isinstance(moments, Mapping):
        expected, got = "param_groups and state", ", ".join(map(str, state)) or "nothing"
        raise FileFormatError(path, where="optimizer", expected=expected, got=got, fix=_ANEW)
    numbers = [group.get("params") if isinstance(group, Mapping) else None for group in groups]
    if numbers != [group["params"] for group in own]:
        expected = f"groups of {', '.join(str(len(group['params'])) for group in own)} parameters"
        got = ", ".join(str(len(part)) if isinstance(part, list) else "none" for part in numbers) or "no group"
        raise FileFormatError(path, where="optimizer, param_groups", expected=expected, got=got, fix=_ANEW)
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    by_number: dict[Any, Tensor] = dict(
        zip((number for group in own for number in group["params"]), parameters, strict=True)
    )
    for number, values in moments.items():
        where, parameter = f"optimizer, state, {number}", by_number.get(number)
        if parameter is None or not isinstance(values, Mapping):
            expected, got = f"moments of a parameter from 0 to {len(by_number) - 1}", type(values).__name__
            raise FileFormatError(path, where=where, expected=expected, got=got, fix=_ANEW)
        _check_alike(path, where, values, {"step": torch.zeros(()), **dict.fromkeys(_MOMENTS, by_number[number])})
        for name, tensor in values.items():
            if not bool(torch.isfinite(tensor).all()) or (name != _MOMENTS[0] and bool((tensor < 0).any())):
                expected = "finite numbers" if name == _MOMENTS[0] else "finite numbers of 0 or more"
                raise FileFormatError(path, where=f"{where}, {name}", expected=expected, got="others", fix=_ANEW)
    optimizer.load_state_dict({"state": dict(moments), "param_groups": own})


def _check_same(path: Path, saved: Mapping[str, Any], provenance: Mapping[str, Any], step: int) -> None:
    """Refuse another experiment or other data. More steps than before are the same run, prolonged."""
    before, now = dict(flatten(_current_names(saved.get("experiment")))), dict(flatten(provenance.get("experiment")))
    names = [name for name in {**before, **now} if before.get(name) != now.get(name) and name != STEPS]
    # Earlier versions recorded any data as simulated, if the experiment had a way to; fingerprints count
    names = [name for name in names if ".simulate" not in name or now.get(name) is not None]
    if names:
        changes = [f"{name} was {before.get(name)!r}, is {now.get(name)!r}" for name in sorted(names)[:5]]
        more = f" and {len(names) - 5} more" if len(names) > 5 else ""
        raise ConfigError(
            f"{path} was made by another experiment: {'; '.join(changes)}{more}. Give this one another name "
            "(-o name=OTHER), set that back, or remove the run's folder."
        )
    if _fingerprints(saved) != _fingerprints(provenance):
        taken_out = (provenance.get("held_out") or {}).get("taken_out") if "held_out" not in saved else 0
        why = (
            "it learnt from frames that it validates on, as earlier versions let it"
            if taken_out
            else "their files or options changed since (data_fingerprint)"
        )
        raise ConfigError(
            f"{path} was made of other data: {why}. Give this run another name (-o name=OTHER), or remove the run's "
            "folder."
        )
    if (steps := now.get(STEPS, step)) < step:
        raise ConfigError(f"{path} has done {count_of(step, 'step')}; {STEPS} may be raised, not set to {steps}.")


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


_DECIDING = ("device", "precision", "threads", "environment.commit", "environment.versions.torch")
"""What, besides experiment and data, decides the bytes of weights, by its dotted name in a provenance."""


def resumed_otherwise(saved: Mapping[str, Any], provenance: Mapping[str, Any], step: int) -> list[dict[str, Any]]:
    """Where a run went on with another of what decides its bytes: ``step`` done and ``changes`` by name.

    Earlier ones come first. A change is a pair: what it was and what it is.
    """
    before, now = dict(flatten(saved)), dict(flatten(provenance))
    changes = {
        name: [before[name], now[name]]
        for name in _DECIDING
        if name in before and name in now and before[name] != now[name]
    }
    earlier = list(saved.get("resumed_otherwise", ()))
    return [*earlier, {"step": step, "changes": changes}] if changes else earlier


def provenance_in(path: Path) -> Mapping[str, Any]:
    """The provenance in a checkpoint; empty where there is none or it is of another form, which :func:`load_run` says.

    Raises:
        FileFormatError: If the file is damaged.
    """
    if not path.is_file():
        return {}
    try:
        provenance = plain_json(load_checkpoint(path)["provenance"])
    except (KeyError, TypeError, ValueError):
        return {}
    return provenance if isinstance(provenance, Mapping) else {}


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
        """What an earlier part of the run reached; None where nothing stands there.

        Raises:
            FileFormatError: If it is damaged.
        """
        path = folder / f"{BEST}.json"
        if not path.is_file():
            return None
        try:
            tree = plain_json(read_bytes(path, max_bytes=_BLOCK_BYTES))
            best = cls(tree["step"], tree["validation"])
            whole = type(best.step) is int and best.step >= 0
            if not whole or type(best.score) not in (int, float) or not 0 <= best.score <= 1:
                raise ValueError(f"step {best.step}, validation {best.score}")
            if set(tree) != {"step", "validation"} and tree != best._tree():  # which earlier versions wrote
                raise ValueError("figures that changed since they were written")
        except (ValueError, KeyError, TypeError) as error:
            fix = "Remove it: the next validation then counts as the best."
            expected = "a step, a validation from 0 to 1, and their digest"
            raise FileFormatError(path, where="the file", expected=expected, got=plain(error)[:200], fix=fix) from error
        return best

    def write(self, folder: Path) -> None:
        """Keep it."""
        write_text(folder / f"{BEST}.json", json.dumps(self._tree()) + "\n")

    def _tree(self) -> dict[str, Any]:
        figures = {"step": self.step, "validation": self.score}
        return {**figures, "sha256": hashlib.sha256(json.dumps(figures).encode()).hexdigest()}


def begin_log(path: Path, *, anew: bool) -> None:
    """Make a log ready for a run's lines.

    Args:
        path: The log.
        anew: The run begins, and no line of another stays; else a last line is cut that is damaged or has no end, as a
            process leaves it that was killed while it wrote.
    """
    if anew:
        path.unlink(missing_ok=True)
    elif path.is_file():
        data = path.read_bytes()
        end = data.rfind(b"\n") + 1
        last = data[data.rfind(b"\n", 0, max(0, end - 1)) + 1 : end]
        try:
            plain_json(last or b"0")
        except ValueError:
            end -= len(last)
        with path.open("r+b") as file:
            file.truncate(end)


def remove_best(folder: Path, stems: Sequence[str]) -> None:
    """Remove what another run left, as a run begins anew."""
    for name in (f"{BEST}.json", *(f"{stem}.safetensors" for stem in stems)):
        (folder / name).unlink(missing_ok=True)
