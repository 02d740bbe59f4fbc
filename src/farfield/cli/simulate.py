"""``farfield simulate``: write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE."""

from functools import partial
from pathlib import Path

import tyro

from farfield.cli._progress import bar
from farfield.vocabulary.conditions import Side, Time, Weather


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
    traffic: Side | None = None,
    workers: int = 0,
    engine: str = "local",
    cache: bool = False,
    recording: bool = False,
    dry_run: bool = False,
) -> int:
    """Write a simulated data set in the layout of Cirrus, K-Radar, KITTI or RADIATE.

    examples:
      farfield simulate cirrus-sim data/sim --frames 100
      farfield simulate cirrus-sim data/snow --frames 100 --weather heavy_snow --sensors gaussian,uniform
      farfield simulate cirrus-sim-highway data/highway --frames 200 --sequences 40 --seed 3 --workers 4 --cache
      farfield simulate kradar-sim data/kradar --frames 116 --sensors os2-64,sparse,cam-front
      farfield simulate kradar-sim-mini data/mini
      farfield simulate radiate-sim data/radiate --frames 160 --traffic right
      farfield simulate cirrus-sim-val-v2 data/val
      farfield simulate cirrus-sim data/raw --recording --frames 600 --sequences 1

    Run again, it goes on where it stopped: a frame's files appear whole or not at all. The bytes do not depend on the
    number of workers. A frozen preset (cirrus-sim-val-v2) is compared with its recorded checksums; exit status 1 if a
    frame differs.

    Args:
        preset: cirrus-sim (two scan patterns and a camera, highway and town in turn), cirrus-sim-ideal (patterns taken
            at the same moment), cirrus-sim-highway, cirrus-sim-urban, cirrus-sim-varied (many roads, sensor mountings
            and size priors, to train on), cirrus-sim-val-v2 (frozen), kradar-sim (58 sequences in seven weathers: two
            Ousters, 4D radar, stereo cameras), kitti-sim (64 beams, full bodies, annotated in the camera's field),
            radiate-sim (a turning radar, four pictures a second, traffic on the left), cirrus-sim-mini,
            kradar-sim-mini, kitti-sim-mini, radiate-sim-mini.
        out: Folder to write into; made if absent. Cirrus frames go to Cirrus_dataset1 below it, K-Radar's to 1, 2, ...
        frames: Number of frames in all, spread evenly over the sequences; the preset's own unless given.
        sequences: Number of sequences, each another road with other traffic; the preset's own unless given.
        sensors: What to write, separated by commas. Cirrus: gaussian, uniform, camera. K-Radar: os2-64, os1-128,
            cam-front, cam-left, cam-right, cam-rear, cells (the radar's cells in the wide region, to train on), sparse,
            polar3d, cube, tesseract (260 MB a frame). RADIATE: polar, cartesian.
        weather: Put every sequence into this weather.
        time: Put every sequence into this time of day.
        seed: Another seed gives another world; the preset's own unless given.
        stride_s: Seconds between frames of a sequence, at most 1; the preset's own unless given.
        uniform_offset_ms: How much later the uniform pattern is taken, in every sequence; 0 is the ideal pair.
        traffic: On which side it keeps; the left is the mirror image of the right. The preset's own unless given.
        workers: Processes; 0 takes as many as there are cores, frames and memory for.
        engine: Where the frames are simulated.
        cache: Also write the binary cache that makes reading fast (Cirrus).
        recording: Write the raw streams of each drive of the Cirrus car instead of frames: a ROS 2 bag (MCAP) with the
            LiDARs at 10 Hz, the camera at 30 Hz (320 pixels wide), two IMUs at 100 Hz, GPS at 1 Hz and the car's pose,
            each with a clock of its own, and SEQUENCE_truth.json beside. --frames counts sweeps, 10 a second.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.simulation.recording import RecordingOptions
    from farfield.simulation.recording.recorder import record_frames

    options = RecordingOptions(
        preset=preset,
        out=out,
        frames=frames,
        sequences=sequences,
        sensors=sensors,
        weather=weather,
        time=time,
        seed=seed,
        stride_s=stride_s,
        uniform_offset_ms=uniform_offset_ms,
        traffic=traffic,
        workers=workers,
        engine=engine,
        cache=cache,
        raw=recording,
        dry_run=dry_run,
    )
    if options.raw:
        from farfield.simulation.recording.raw.streams import record_raw

        record_raw(options, progress=partial(bar, what="recording", transient=True), report=print)
        return 0
    recorded = record_frames(options, progress=partial(bar, what="simulating", transient=True), report=print)
    return int(recorded.different > 0)
