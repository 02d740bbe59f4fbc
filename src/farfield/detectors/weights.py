"""Trained weights as safetensors files: tensors, and beside them everything needed to rebuild and to trust them.

A file carries the SHA-256 of all its bytes (:mod:`farfield.files.safetensors`). Files of earlier versions carry none:
what they hold is checked as far as numbers and shapes tell, and a warning says so.
"""

import json
import warnings
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from farfield.detectors.network import Network, build_detector
from farfield.detectors.provenance import Provenance, provenance_of
from farfield.detectors.soundness import unlike, unsound
from farfield.detectors.spec import DETECTORS
from farfield.errors import FarfieldError, FileFormatError, did_you_mean, plain
from farfield.files.atomic import read_bytes, write_bytes
from farfield.files.json_text import plain_json
from farfield.files.limits import MAX_WEIGHTS_BYTES
from farfield.files.remote_paths import checked_file
from farfield.files.remote_stores import is_url
from farfield.files.safetensors import KEY, check_digest, metadata_of, with_digest

_MAX_METADATA_BYTES = 32_000_000  # a digest of each frame that was learnt from is 13 bytes
_KEYS = {"format", "config", "provenance"}


def save_weights(
    path: Path, state: dict[str, Tensor], *, config: Any, provenance: dict[str, Any], half: bool = False
) -> None:
    """Write weights with their detector's configuration and the provenance of the training.

    Args:
        path: Target, ``.safetensors``.
        state: The network's state dict.
        config: The detector's configuration object.
        provenance: Seed, versions, commit, data fingerprint, metric convention, resolved experiment.
        half: Store matrices and kernels in float16, at half the size; vectors stay as they are.

    Raises:
        FarfieldError: If a number is not finite, or none that a training leaves, or if the provenance could not be read
            again; nothing is written.
    """
    try:
        Provenance.model_validate(plain_json(json.dumps(provenance)))
    except (ValueError, RecursionError) as error:
        expected = "the record of a training, as JSON takes it"
        raise FileFormatError(path, where="provenance", expected=expected, got=plain(error)[:300]) from error
    metadata = {
        "format": "farfield-detector-1",
        "config": config.model_dump_json(),
        "provenance": json.dumps(provenance),
    }
    tensors = {name: tensor.detach().to("cpu").contiguous().clone() for name, tensor in state.items()}
    if half:
        tensors = {name: t.half() if t.ndim > 1 and t.is_floating_point() else t for name, t in tensors.items()}
    if (fault := unsound(tensors)) is not None:
        raise FarfieldError(
            f"{path}: expected finite weights to write, found {fault[1]} of {fault[0]}. The training went astray: go "
            "on from an earlier state with a lower training.learning_rate. Nothing was written."
        )
    write_bytes(path, with_digest(save(tensors, metadata=metadata)))


def load_weights(path: Path) -> tuple[Network, dict[str, Any]]:
    """Rebuild a trained network.

    Returns:
        The network in evaluation mode on the CPU, and the provenance of its training.

    Raises:
        FileFormatError: If the file is not one of ours, changed since it was written, holds numbers that no training
            leaves, does not fit the network that it describes, or describes a detector that is not installed.
    """
    if not path.is_file():
        raise FarfieldError(f"{path}: expected a weights file, found nothing. Train one with: farfield train")
    data = read_bytes(path, max_bytes=MAX_WEIGHTS_BYTES)
    try:
        tensors, metadata = load(data), metadata_of(path, data)
    except (SafetensorError, ValueError, TypeError, KeyError, AssertionError, RuntimeError) as error:
        raise FileFormatError(path, where="header", expected="safetensors", got=plain(error)[:300]) from error
    is_ours = metadata.get("format") == "farfield-detector-1" and set(metadata) in (_KEYS, {*_KEYS, KEY})
    if not is_ours or sum(map(len, metadata.values())) > _MAX_METADATA_BYTES:
        raise FileFormatError(
            path,
            where="metadata",
            expected="format farfield-detector-1",
            got=f"{metadata.get('format')!r} with {', '.join(sorted(metadata)) or 'nothing'}"[:300],
            fix="Weights of other codebases need an import first.",
        )
    check_digest(path, data)
    del data  # the tensors are copies
    try:
        described, provenance = plain_json(metadata["config"]), provenance_of(path, metadata["provenance"])
        name = str(described["name"])
        if name not in DETECTORS:
            raise FileFormatError(
                path,
                where="configuration",
                expected=f"a detector that is installed, one of {', '.join(DETECTORS)}",
                got=name,
                fix=f"Install the package that has the detector {name}.",
            )
        config = DETECTORS[name].config_class.model_validate(described)
        with torch.device("meta"):  # shapes only: nothing is allocated on the word of the file
            network = build_detector(config)
        tensors = {name: t.float() if t.dtype == torch.float16 else t for name, t in tensors.items()}
        if (misfit := unlike(tensors, network.state_dict())) is not None:
            raise FileFormatError(path, where=misfit[0], expected=misfit[1], got=misfit[2])
        if (fault := unsound(tensors)) is not None:
            fix = "The file is damaged, or its training went astray: copy it anew, or take earlier weights."
            expected = "numbers as a training leaves them"
            raise FileFormatError(path, where=fault[0], expected=expected, got=fault[1], fix=fix)
        network.load_state_dict(tensors, assign=True)
    except FileFormatError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RuntimeError, FarfieldError) as error:
        raise FileFormatError(
            path, where="configuration and tensors", expected="those of one detector", got=plain(error)[:300]
        ) from error
    if KEY not in metadata:
        warnings.warn(
            f"{path}: these weights are of an earlier version and carry no digest: their numbers are possible, and "
            "whether a bit of them changed cannot be told. Train, adapt or import them anew for one.",
            stacklevel=2,
        )
    return network.eval(), provenance


def bundled_weights() -> dict[str, Path]:
    """The weights that ship with the package, by name."""
    folder = Path(str(files("farfield.detectors") / "weights_data"))
    return {path.stem: path for path in sorted(folder.glob("*.safetensors"))}


def resolve_weights(name: str | Path) -> Path:
    """Turn a bundled name, a run's folder or a file into the path of a weights file.

    Raises:
        FarfieldError: If it is none of these.
    """
    bundled = bundled_weights()
    if str(name) in bundled:
        return bundled[str(name)]
    path = checked_file(str(name)) if is_url(str(name)) else Path(name)
    if path.is_dir() and (path / "weights.safetensors").is_file():
        return path / "weights.safetensors"
    if path.is_file():
        return path
    raise FarfieldError(
        f"Expected a bundled detector ({', '.join(bundled) or 'none in this build'}), a run's folder with "
        f"weights.safetensors, or a weights file; got {str(name)!r}.{did_you_mean(str(name), bundled)}"
    )
