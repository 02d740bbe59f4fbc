"""``farfield demo``."""

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from farfield.cli._flags import JobFlags
from farfield.cli._output import bar, check_outputs, would_write
from farfield.errors import ConfigError
from farfield.vocabulary.counts import count_of

_START_S, _FRAME_S = 15.0, 1.5  # two cores of an AMD EPYC: imports and the page; simulating and searching a frame
_RADAR_START_S, _RADAR_FRAME_S = 20.0, 1.5
_WEATHERS = ("normal", "sleet")
_SHOWN = "pointpillars-cirrus-sim"
_RADAR, _LIDAR = "rtnh-kradar-sim", "pointpillars-kradar-sim"
PICTURE = "weathers.jpg"
_STREET, STREET_PICTURE = "os-2-128", "street.jpg"
_REAL_S = 60.0  # twelve frames, the page and the picture


def seconds_of(frames: int, *, radar: bool = False) -> float:
    """About how long so many frames take on two cores."""
    return _RADAR_START_S + _RADAR_FRAME_S * frames if radar else _START_S + _FRAME_S * frames


def run(
    *,
    radar: bool = False,
    real: bool = False,
    out: Path = Path("farfield-demo"),
    sequences: int | None = None,
    frames: int | None = None,
    seed: int = 2026,
    dry_run: bool = False,
) -> int:
    """Simulate, detect, score and report: the main job from end to end, with no data and no GPU.

    examples:
      farfield demo
      farfield demo --frames 60 --sequences 6 --out my-demo
      farfield demo --radar
      farfield demo --real

    Two-pattern LiDAR frames of roads that the detector has never seen are simulated and written as Cirrus files,
    checked by the doctor, searched for vehicles to 250 m with the bundled weights, scored with DDS and wDDS by range,
    and shown on one HTML page.

    With --radar drives of the K-Radar car are simulated, each in normal weather and once more in sleet, searched with
    4D radar (rtnh-kradar-sim) and with LiDAR (pointpillars-kradar-sim), and scored by weather. How much ice covers the
    LiDAR's window in sleet is an input of the simulation.

    With --real nothing is simulated: the detector, which learnt from simulated frames alone, searches the Open Sweeps,
    real streets that ship with the package, and is scored on them; a picture shows one street with what it finds.

    After an interruption the same command resumes.

    Args:
        radar: 4D radar beside LiDAR, in normal weather and in sleet.
        real: Real sweeps of streets in the place of simulated ones.
        out: Folder for the frames and the report.
        sequences: Number of roads; highway and town take turns (default: 4; with --radar 10 drives).
        frames: Number of frames in all (default: 20; with --radar 40, half of them in each weather).
        seed: Another seed gives other roads and traffic.
        dry_run: Say what would be written, and write nothing.
    """
    if real:
        return _real(out, {"--radar": radar, "--sequences": sequences, "--frames": frames}, dry_run=dry_run)
    few, many = (10, 40) if radar else (4, 20)
    sequences, frames = few if sequences is None else sequences, many if frames is None else frames
    what = (
        _frames_by_weather(sequences, frames)
        if radar
        else f"{count_of(frames, 'frame')} of {count_of(sequences, 'road')}"
    )
    minutes = max(1, round(seconds_of(frames, radar=radar) / 60))
    about = f"about {minutes} {'minute' if minutes == 1 else 'minutes'} on two cores"
    check_outputs((), folders={"--out": out})
    if dry_run:
        would_write(f"{what}, and a report", out, f"in {about}")
        return 0
    print(f"{what}: {about}\n", flush=True)
    return (_with_radar if radar else _with_lidar)(out, sequences, frames, seed)


def _real(out: Path, simulating: Mapping[str, int | None], *, dry_run: bool) -> int:
    flag = next((name for name, value in simulating.items() if value), None)
    if flag is not None:
        raise ConfigError(f"{flag}: expected a demo of simulated frames, got --real, which simulates nothing")
    from farfield.datasets.open_sweeps import NAME
    from farfield.vocabulary.scores import SHOWN_SCORE

    check_outputs((), folders={"--out": out})
    about = f"about {max(1, round(_REAL_S / 60))} minute on two cores"
    if dry_run:
        would_write(f"a report on {NAME} and {STREET_PICTURE}", out, f"in {about}")
        return 0
    from farfield.api import load_detector, open_dataset
    from farfield.cli import evaluate
    from farfield.evaluation.around import detect_around
    from farfield.evaluation.report_data import confident
    from farfield.figures.birds_eye import street
    from farfield.figures.style import figure_bytes
    from farfield.files.atomic import write_bytes

    began = time.monotonic()
    print(f"real sweeps of streets: {about}\n\n1/2 detecting, scoring, drawing", flush=True)
    detector, data = load_detector(_SHOWN), open_dataset(NAME)
    evaluate.run(_SHOWN, Path(NAME), out=out / "real-evaluation")
    print("\n2/2 drawing a street", flush=True)
    frame = data[data.frame_ids.index(_STREET)]
    picture = out / STREET_PICTURE
    write_bytes(picture, figure_bytes(street(frame, confident(detect_around(detector, frame), SHOWN_SCORE)), "jpg"))
    print(f"\ndone in {time.monotonic() - began:.0f} s")
    print(f"picture: {picture.resolve()}")
    print(f"report: {(out / 'real-evaluation' / 'report.html').resolve()}")
    return 0


def _frames_by_weather(sequences: int, frames: int) -> str:
    frames_a_weather = frames // len(_WEATHERS)
    if frames % len(_WEATHERS) or not 1 <= sequences <= frames_a_weather:
        raise ConfigError(
            f"--frames: with --radar expected an even number, half of them in each weather and at least one a drive; "
            f"got {frames} frames of {count_of(sequences, 'drive')}"
        )
    drives = count_of(sequences, "drive")
    return f"{drives} of the K-Radar car, {count_of(frames_a_weather, 'frame')} in normal weather and the same in sleet"


def _with_lidar(out: Path, sequences: int, frames: int, seed: int) -> int:
    from farfield.api import load_detector
    from farfield.cli import doctor, evaluate
    from farfield.simulation.recording import record

    began = time.monotonic()
    load_detector(_SHOWN)  # what is missing is told before the work
    data = out / f"simulated-{seed}-{sequences}x{frames}"
    print("1/3 simulating", flush=True)
    simulating = partial(bar, what="simulating", transient=True)
    record("cirrus-sim", data, frames=frames, sequences=sequences, seed=seed, progress=simulating, report=print)
    print("\n2/3 checking the files", flush=True)
    status = doctor.run(data)
    print("\n3/3 detecting, scoring, drawing", flush=True)
    evaluate.run(_SHOWN, data, clouds="gaussian,uniform", out=out / "evaluation")
    print(f"done in {time.monotonic() - began:.0f} s")
    print(f"report: {(out / 'evaluation' / 'report.html').resolve()}")
    return status


def _with_radar(out: Path, sequences: int, frames: int, seed: int) -> int:
    from farfield.api import load_detector, open_dataset
    from farfield.evaluation.weathers import evaluate_weathers, weather_table
    from farfield.pages.evaluation_page import write_weathers
    from farfield.simulation.recording import record

    began, frames_a_weather = time.monotonic(), frames // len(_WEATHERS)
    detectors = [load_detector(name) for name in (_RADAR, _LIDAR)]  # what is missing is told before the work
    folder = out / f"radar-{seed}-{sequences}x{frames_a_weather}"
    for number, weather in enumerate(_WEATHERS, 1):
        print(f"{number}/3 simulating: {weather}", flush=True)
        record(
            *("kradar-sim", folder / weather),
            frames=frames_a_weather,
            sequences=sequences,
            seed=seed,
            weather=weather,
            stride_s=1.0,
            sensors="os2-64,cells",
            progress=partial(bar, what="simulating", transient=True),
            report=print,
        )
        print(flush=True)
    print("3/3 detecting with radar and with LiDAR, scoring, drawing\n", flush=True)
    report_folder = out / "radar-evaluation"
    evaluation = evaluate_weathers(
        detectors,
        {weather: open_dataset(folder / weather) for weather in _WEATHERS},
        title="4D radar and LiDAR on the same simulated drives, in normal weather and in sleet",
        name=f"{folder.name} in normal weather and in sleet",
        journals=report_folder,
        bulk=JobFlags(workers=1).options("detecting"),
    )
    page, picture = write_weathers(evaluation, report_folder, picture=PICTURE)
    print(weather_table(evaluation.results, _WEATHERS))
    print(f"\ndone in {time.monotonic() - began:.0f} s")
    print(f"picture: {picture.resolve()}")
    print(f"report: {page.resolve()}")
    return 0
