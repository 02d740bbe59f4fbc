"""``farfield simulate``: write a simulated data set in the layout of Cirrus or of K-Radar."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from farfield.errors import ConfigError, DatasetError
from farfield.vocabulary.conditions import Time, Weather

if TYPE_CHECKING:
    from farfield.simulation import Preset

_SETTINGS_FILE = "simulation.json"
_MAX_STRIDE_S = 1.0  # readers begin a new segment after a longer pause


def run(
    preset: tyro.conf.Positional[str],
    out: tyro.conf.Positional[Path],
    /,
    *,
    frames: int | None = None,
    sequences: int | None = None,
    sensors: str | None = None,
    weather: Weather | None = None,
    time: Time | None = None,
    seed: int | None = None,
    stride_s: float | None = None,
    uniform_offset_ms: float | None = None,
    workers: int = 0,
    cache: bool = False,
) -> int:
    """Write a simulated data set in the layout of Cirrus or of K-Radar.

    examples:
      farfield simulate cirrus-sim data/sim --frames 100
      farfield simulate cirrus-sim data/snow --frames 100 --weather heavy_snow --sensors gaussian,uniform
      farfield simulate cirrus-sim-highway data/highway --frames 200 --sequences 40 --seed 3 --workers 4 --cache
      farfield simulate kradar-sim data/kradar --frames 116 --sensors os2-64,sparse,cam-front
      farfield simulate kradar-sim-mini data/mini
      farfield simulate cirrus-sim-val-v2 data/val

    Run again, it goes on where it stopped: a frame's files appear whole or not at all. The bytes do not depend on the
    number of workers. A frozen preset (cirrus-sim-val-v2) is compared with its recorded checksums; exit status 1 if a
    frame differs.

    Args:
        preset: cirrus-sim (two scan patterns and a camera, highway and town in turn), cirrus-sim-ideal (patterns taken
            at the same moment), cirrus-sim-highway, cirrus-sim-urban, cirrus-sim-varied (many roads, sensor mountings
            and size priors, to train on), cirrus-sim-val-v2 (frozen), kradar-sim (58 sequences in seven weathers: two
            Ousters, 4D radar, stereo cameras), cirrus-sim-mini, kradar-sim-mini.
        out: Folder to write into; made if absent. Cirrus frames go to Cirrus_dataset1 below it, K-Radar's to 1, 2, ...
        frames: Number of frames in all, spread evenly over the sequences; the preset's own unless given.
        sequences: Number of sequences, each another road with other traffic; the preset's own unless given.
        sensors: What to write, separated by commas. Cirrus: gaussian, uniform, camera. K-Radar: os2-64, os1-128,
            cam-front, cam-left, cam-right, cam-rear, cells (the radar's cells in the wide region, to train on), sparse,
            polar3d, cube, tesseract (260 MB a frame).
        weather: Put every sequence into this weather.
        time: Put every sequence into this time of day.
        seed: Another seed gives another world; the preset's own unless given.
        stride_s: Seconds between frames of a sequence, at most 1; the preset's own unless given.
        uniform_offset_ms: How much later the uniform pattern is taken, in every sequence; 0 is the ideal pair.
        workers: Processes; 0 takes as many as there are cores.
        cache: Also write the binary cache that makes reading fast (Cirrus).
    """
    from farfield.recording import writing as _simulating
    from farfield.simulation import find_preset
    from farfield.simulation.frozen import FROZEN
    from farfield.simulation.presets import check_sensors

    changes: dict[str, Any] = {"weather": weather, "time": time, "stride_s": stride_s}
    if uniform_offset_ms is not None:
        changes["uniform_offset_ms"] = (uniform_offset_ms, uniform_offset_ms)
    changes = {name: value for name, value in changes.items() if value is not None}
    chosen = find_preset(preset, **changes)
    frozen = preset in FROZEN
    if frozen and (changes or sensors or seed not in (None, chosen.seed)):
        raise ConfigError(f"{preset} is frozen: expected its own seed and settings. Use cirrus-sim for others.")
    if chosen.stride_s > _MAX_STRIDE_S or chosen.stride_s <= 0:
        raise ConfigError(f"--stride-s: expected more than 0 and at most {_MAX_STRIDE_S:g} s, got {chosen.stride_s:g}")
    if cache and chosen.rig != "cirrus":
        raise ConfigError("--cache: expected a Cirrus preset; K-Radar's files have no such cache")
    named = check_sensors(chosen, tuple(sensors.replace(" ", "").split(",")) if sensors else chosen.sensors)
    plan = _plan(chosen, frames, sequences, frozen=frozen)
    used_seed = chosen.seed if seed is None else seed
    _settle(out, chosen, used_seed, named, plan)
    _simulating.sweep_out(out)
    jobs = list(_simulating.jobs_for(plan, chosen, used_seed, named, out, cache=cache, check=frozen))
    count = sum(len(job.indices) for job in jobs)
    needed = count * _simulating.frame_bytes(chosen, named) * (1.6 if cache else 1.0)
    processes = min(workers if workers > 0 else os.cpu_count() or 1, max(len(jobs), 1))
    _announce(chosen, used_seed, named, plan, count, processes, needed, out)
    _simulating.check_disk(out, round(needed), count)
    verdicts = _simulating.work(jobs, processes, count)
    _finish(chosen, out)
    return _conclude(verdicts, out, frozen=frozen)


def _plan(preset: "Preset", frames: int | None, sequences: int | None, *, frozen: bool) -> list[int]:
    """Number of frames of each sequence."""
    count = len(preset.segments) if sequences is None else sequences
    if count < 1:
        raise ConfigError(f"--sequences: expected at least 1, got {count}")
    most = len(preset.segments) * preset.segments[0].frames
    if frozen and (count > len(preset.segments) or (frames or 0) > most):
        raise ConfigError(
            f"{preset.name} is frozen: expected at most {len(preset.segments)} x {preset.segments[0].frames} frames"
        )
    if frames is None:
        plan = [preset.segment(sequence).frames for sequence in range(count)]
    elif frames < 1:
        raise ConfigError(f"--frames: expected at least 1, got {frames}")
    else:
        used = range(min(count, frames))
        plan = _spread(frames, [preset.segment(i).frames if frozen else preset.longest(i) for i in used])
    for sequence, planned in enumerate(plan):
        if planned > preset.longest(sequence):
            raise ConfigError(
                f"--stride-s: sequence {sequence} lasts {preset.segment(sequence).duration_s:g} s and has room for "
                f"{preset.longest(sequence)} frames, expected {planned}. Take a smaller --stride-s or fewer --frames."
            )
    return plan


def _spread(total: int, longest: list[int]) -> list[int]:
    """Spread frames evenly over sequences, none beyond its length."""
    if total > sum(longest):
        raise ConfigError(
            f"--frames: {len(longest)} sequences have room for {sum(longest)} frames, got {total}. Ask for more "
            "--sequences or a smaller --stride-s."
        )
    plan = [0] * len(longest)
    while (left := total - sum(plan)) > 0:
        open_ones = [i for i, most in enumerate(longest) if plan[i] < most]
        for rank, i in enumerate(open_ones):
            share = left // len(open_ones) + (rank < left % len(open_ones))
            plan[i] = min(plan[i] + share, longest[i])
    return plan


def _settle(out: Path, preset: "Preset", seed: int, sensors: tuple[str, ...], plan: list[int]) -> None:
    """Claim the folder for these settings, or make sure that it was claimed for the same ones.

    Sensors and frames may be added later: what a sensor measures does not depend on the others.
    """
    from farfield.files.atomic import write_text

    settings = json.loads(json.dumps({"seed": seed, "preset": asdict(preset)}))
    before: set[str] = set()
    record = out / _SETTINGS_FILE
    if record.is_file():
        try:
            found = json.loads(record.read_text("utf-8"))
            drawn, before = found.pop("sequences", []), set(found.pop("sensors", []))
        except (ValueError, AttributeError, TypeError) as error:
            raise DatasetError(f"{record}: expected the settings of a simulation, found: {error}") from error
        if found != settings:
            differ = sorted(key for key in settings if found.get(key) != settings[key])
            raise DatasetError(
                f"{out}: expected a data set of preset {preset.name}, seed {seed}, with the same settings; "
                f"{record.name} there differs in: {', '.join(differ) or 'its keys'}. Name another folder, or remove "
                "this one."
            )
        if len(drawn) >= len(plan) and before >= set(sensors):
            return
    elif out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise DatasetError(f"{out}: expected an empty or absent folder, or one that farfield simulate began")
    out.mkdir(parents=True, exist_ok=True)
    settings["sensors"] = sorted(before | set(sensors))
    settings["sequences"] = [_drawn(preset, seed, sequence) for sequence in range(len(plan))]
    write_text(record, json.dumps(settings, indent=1) + "\n")


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


def _announce(
    preset: "Preset",
    seed: int,
    sensors: tuple[str, ...],
    plan: list[int],
    count: int,
    processes: int,
    needed: float,
    out: Path,
) -> None:
    from farfield.simulation.rigs.drive import drive_of

    print(f"preset {preset.name}, seed {seed}: {sum(plan)} frames in {len(plan)} sequences, {count} still to write")
    print(f"  {', '.join(sensors)}; every {preset.stride_s:g} s; at most {needed / 1e9:.2f} GB")
    shown = list(range(len(plan)))[:6]
    for sequence in shown:
        drive = drive_of(preset, seed, sequence)
        print(f"  {drive.segment.name}: {drive.segment.road}; {drive.weather.describe()}")
    if len(plan) > len(shown):
        print(f"  ... {len(plan) - len(shown)} more, all in {out / _SETTINGS_FILE}")
    print(f"  {processes} process{'es' if processes > 1 else ''}, into {out}")


def _finish(preset: "Preset", out: Path) -> None:
    """Write what belongs to whole sequences: calibration, times, splits, odometry."""
    if preset.rig != "kradar":
        return
    from farfield.recording.writing import writer_for

    writer_for(preset, out).finish()


def _conclude(verdicts: list[str], out: Path, *, frozen: bool) -> int:
    print(f"wrote {len(verdicts)} frames into {out}")
    if not frozen:
        return 0
    if not verdicts:
        print("checksums: nothing was written, nothing checked; frames are compared when they are simulated")
        return 0
    counts = {name: verdicts.count(name) for name in ("identical", "equivalent", "different")}
    print("checksums: " + ", ".join(f"{count} {name}" for name, count in counts.items()))
    if counts["equivalent"]:
        print("  equivalent: point counts agree; another processor rounds single-precision rays differently")
    if counts["different"]:
        print("  different: these frames are not the frozen ones. Scores on them cannot be compared with others.")
    return int(counts["different"] > 0)
