"""``farfield import-weights``: trained weights of other codebases as ours."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from farfield.cli._output import check_outputs


def run(
    checkpoint: Positional[Path],
    out: Positional[Path],
    *,
    kind: Literal["pointpillars", "second", "rtnh"] | None = None,
    settings: Path | None = None,
    allow_unknown: bool = False,
    every_key: bool = False,
) -> int:
    """Turn a checkpoint of OpenPCDet (PointPillars, SECOND) or K-Radar's kit (RTNH) into weights that predict reads.

    examples:
      farfield import-weights pointpillar_7728.pth kitti-pointpillars.safetensors
      farfield import-weights second_7862.pth kitti-second.safetensors --every-key
      farfield import-weights RTNH_wide_10.pt rtnh-wide.safetensors
      farfield import-weights mine.pth mine.safetensors --settings mine.yaml
      farfield predict kitti-second.safetensors scan.bin

    A checkpoint does not hold its grid, anchors and thresholds: those of OpenPCDet's KITTI files, or of the kit's
    cfg_RTNH.yml and cfg_RTNH_wide.yml, are taken, and --settings names a YAML file with those of another training,
    under our names, such as grid, anchors and max_points. Every key is used, ignored for a stated reason, or an error.
    No real checkpoint of either was at hand. farfield doctor CHECKPOINT says what a file is.

    Args:
        checkpoint: The checkpoint, .pth or .pt.
        out: The weights file to write, .safetensors.
        kind: The checkpoint's detector (default: recognised).
        settings: YAML file with settings of the detector that differ from those that are taken.
        allow_unknown: Leave out keys that the detector has no place for instead of failing.
        every_key: Show where each key went.
    """
    import hashlib

    from farfield.detectors import DETECTORS
    from farfield.errors import ConfigError
    from farfield.files.atomic import readable
    from farfield.jobs.folders import held

    _ = DETECTORS[kind or "pointpillars"].network_class  # without torch, says how to install it
    from farfield.detectors.importing import import_checkpoint
    from farfield.detectors.weights import save_weights

    if out.suffix != ".safetensors":
        raise ConfigError(f"Expected a target that ends in .safetensors, got {out}.")
    check_outputs((checkpoint, settings), files={"out": out})
    network, report = import_checkpoint(
        checkpoint, kind, settings=None if settings is None else _read_settings(settings), allow_unknown=allow_unknown
    )
    provenance = {
        "imported_from": report.origin,
        "checkpoint": readable(checkpoint.name),
        "checkpoint_sha256": hashlib.sha256(checkpoint.read_bytes()).hexdigest(),
        "left_out": list(report.unknown),
        **({"experiment": {"data": dict(report.data)}} if report.data else {}),
    }
    with held(out, file=True):
        save_weights(out, network.state_dict(), config=network.config, provenance=provenance)
    print(report.text(every_key=every_key))
    print(f"weights: {out}")
    return 0


def _read_settings(path: Path) -> dict[str, object]:
    import yaml

    from farfield.errors import ConfigError, plain
    from farfield.files.atomic import read_bytes
    from farfield.files.yaml_text import MAX_BYTES, plain_yaml

    try:
        settings = plain_yaml(read_bytes(path, max_bytes=MAX_BYTES))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(
            f"{path}: expected a YAML file with the detector's settings, found: {plain(error)}."
        ) from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: expected a mapping such as grid: {{range_m: 70.4}}, found {settings!r}.")
    return {str(key): value for key, value in settings.items()}
