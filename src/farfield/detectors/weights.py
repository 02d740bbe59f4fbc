"""Trained weights as safetensors files: tensors, and beside them everything needed to rebuild and to trust them.

A file carries the SHA-256 of all its bytes (:mod:`farfield.files.safetensors`). Files of earlier versions carry none;
what they hold is checked as far as numbers and shapes tell.
"""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from farfield.detectors.network import Network, build_detector
from farfield.detectors.soundness import unlike, unsound
from farfield.detectors.spec import DETECTORS
from farfield.errors import FarfieldError, FileFormatError, plain
from farfield.files.atomic import write_bytes
from farfield.files.safetensors import KEY, check_digest, with_digest

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
        FarfieldError: If a number is not finite, or none that a training leaves; nothing is written.
    """
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
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except SafetensorError as error:
        raise FileFormatError(path, where="header", expected="safetensors", got=str(error)) from error
    except (ValueError, TypeError, KeyError, RuntimeError) as error:
        raise FileFormatError(
            path, where="header", expected="tensors of safetensors", got=plain(error)[:300]
        ) from error
    tensors = {name: t.float() if t.dtype == torch.float16 else t for name, t in tensors.items()}
    is_ours = metadata.get("format") == "farfield-detector-1" and set(metadata) in (_KEYS, {*_KEYS, KEY})
    if not is_ours or sum(map(len, metadata.values())) > _MAX_METADATA_BYTES:
        raise FileFormatError(
            path,
            where="metadata",
            expected="format farfield-detector-1",
            got=f"{metadata.get('format')!r} with {', '.join(sorted(metadata)) or 'nothing'}"[:300],
            fix="Weights of other codebases need an import first.",
        )
    check_digest(path, path.read_bytes())
    if (fault := unsound(tensors)) is not None:
        raise FileFormatError(
            path,
            where=fault[0],
            expected="numbers as a training leaves them",
            got=fault[1],
            fix="The file is damaged, or its training went astray: copy it anew, or take earlier weights.",
        )
    try:
        described, provenance = json.loads(metadata["config"]), json.loads(metadata["provenance"])
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
        if (misfit := unlike(tensors, network.state_dict())) is not None:
            raise FileFormatError(path, where=misfit[0], expected=misfit[1], got=misfit[2])
        network.load_state_dict(tensors, assign=True)
    except FileFormatError:
        raise
    except (ValueError, KeyError, TypeError, RuntimeError, FarfieldError) as error:
        raise FileFormatError(
            path, where="configuration and tensors", expected="those of one detector", got=plain(error)[:300]
        ) from error
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
    path = Path(name)
    if path.is_dir() and (path / "weights.safetensors").is_file():
        return path / "weights.safetensors"
    if path.is_file():
        return path
    raise FarfieldError(
        f"Expected a bundled detector ({', '.join(bundled) or 'none in this build'}), a run's folder with "
        f"weights.safetensors, or a weights file; got {str(name)!r}."
    )
