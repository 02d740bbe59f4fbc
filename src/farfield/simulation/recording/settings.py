"""What is recorded where, and the settings file that claims a folder for it."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.errors import DatasetError, plain
from farfield.frame.provenance import SIMULATION_FILE

if TYPE_CHECKING:
    from farfield.simulation import Preset


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """What is written where.

    Args:
        preset: What is simulated.
        seed: Its seed.
        sensors: Which sensors are written.
        plan: Number of frames of each sequence.
        out: The folder.
        cache: Whether the binary cache of the clouds is written too.
        frozen: Whether frames are compared with the recorded checksums of the preset.
        raw: Whether the raw streams are written, in bags, instead of frames; the plan counts sweeps then.
    """

    preset: "Preset"
    seed: int
    sensors: tuple[str, ...]
    plan: tuple[int, ...]
    out: Path
    cache: bool = False
    frozen: bool = False
    raw: bool = False


def claim(wanted: RecordingOptions) -> None:
    """Claim the folder for these settings, or make sure that it was claimed for the same ones.

    Sensors and frames may be added later: what a sensor measures does not depend on the others.

    Raises:
        DatasetError: If the folder holds something else.
    """
    from farfield.files.atomic import write_text

    out, sensors = wanted.out, set(wanted.sensors)
    settings = json.loads(json.dumps({"seed": wanted.seed, "preset": wanted.preset.said()}))
    settings |= {"raw": True} if wanted.raw else {}
    record = out / SIMULATION_FILE
    before: set[str] = set()
    if record.is_file():
        drawn, before = _claimed(record, settings, wanted)
        if drawn >= len(wanted.plan) and before >= sensors:
            return
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out}: expected an empty or absent folder, or one that farfield simulate began")
    out.mkdir(parents=True, exist_ok=True)
    settings["sensors"] = sorted(before | sensors)
    settings["sequences"] = [_drawn(wanted.preset, wanted.seed, sequence) for sequence in range(len(wanted.plan))]
    write_text(record, json.dumps(settings, indent=1) + "\n")


def _claimed(record: Path, settings: dict[str, Any], wanted: RecordingOptions) -> tuple[int, set[str]]:
    """Sequences and sensors for which a folder was claimed before, with the same settings."""
    try:
        found = json.loads(record.read_text("utf-8"))
        drawn, before = found.pop("sequences", []), set(found.pop("sensors", []))
        count = len(drawn)
    except (ValueError, AttributeError, TypeError) as error:
        raise DatasetError(f"{record}: expected the settings of a simulation, found: {plain(error)}") from error
    if found != settings:
        differ = sorted(key for key in settings | found if found.get(key) != settings.get(key))
        raise DatasetError(
            f"{wanted.out}: expected a data set of preset {wanted.preset.name}, seed {wanted.seed}, with the same "
            f"settings; {record.name} there differs in: {', '.join(differ) or 'its keys'}. Name another folder, or "
            "remove this one."
        )
    return count, before


def _drawn(preset: "Preset", seed: int, sequence: int) -> dict[str, Any]:
    """What was drawn for a sequence: its weather with all rates and coverages, its sensors' offsets."""
    from farfield.simulation.rigs.drive import drive_of

    drive = drive_of(preset, seed, sequence)
    mounted = drive.mounted
    return {
        "name": drive.segment.name,
        "road": drive.segment.road,
        "weather": {k: round(v, 6) if isinstance(v, float) else v for k, v in asdict(drive.weather).items()},
        "lidar_height_m": round(float(mounted.ego_T_lidar[2, 3]), 6),
        "uniform_offset_ms": round(1000 * mounted.uniform_offset_s, 6),
        "radar_offset_ms": round(1000 * mounted.radar_offset_s, 6),
    }
