"""``farfield adapt``."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_FILES_SAY, Files, Jobs, names
from farfield.cli._output import bar, would_write
from farfield.cli._training_report import BarReport, LineReport


def run(
    detector: Positional[str],
    data: Positional[Path],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    *,
    source: Path | None = None,
    labels: Path | None = None,
    clouds: Annotated[str, tyro.conf.arg(aliases=["--cloud"])] = "",
    rotate_deg: float = 0.0,
    reading: Files = AS_FILES_SAY,
    frames: int = 400,
    source_frames: int = 240,
    rounds: int = 2,
    steps: int = 0,
    minutes: float = 0.0,
    whole_bodies: bool = False,
    seed: int = 0,
    jobs: Jobs = ALL_CORES,
    out: Path | None = None,
    overwrite: bool = False,
    dry_run: bool = False,
) -> int:
    """Adapt a detector to your own unlabelled sweeps by self-training; run the same command again to go on.

    examples:
      farfield adapt pointpillars-cirrus-sim my-sweeps
      farfield adapt pointpillars-cirrus-sim my-sweeps --minutes 60 --out runs/mine
      farfield adapt runs/pointpillars-kitti my-sweeps --source /data/kitti
      farfield adapt pointpillars-cirrus-sim my-sweeps --labels my-labelled-sweeps
      farfield adapt pointpillars-cirrus-sim my-sweeps --whole-bodies
      farfield adapt pointpillars-cirrus-sim my-sweeps --rounds 3 -o method.strong.thinning=0.5

    Confident detections in your sweeps teach it as objects, less confident ones are ignored, and labelled
    frames like those that it learnt from stay in every batch: they are simulated, unless --source names some. Labels of
    your sweeps, if there are any, are not looked at, and the last step counts, not the best one. OUT then holds
    weights.safetensors, which all verbs take as a detector, and report.html, which shows what changed. A killed command
    goes on to the same weights.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        data: The sweeps; the data set's format is recognised, and a plain folder of clouds is one.
        override: Change a setting of method, training or augmentation, as key.key=value; may be given several times.
        source: Labelled frames of the kind that the detector learnt from; by default they are simulated, without
            camera, from the preset that its weights name.
        labels: Labelled frames on which to score before and after, at the end: they decide nothing. Frames that are
            learnt from do not count, so that DATA itself may be named.
        clouds: Clouds of the sweeps to learn from, separated by commas; the first that suits unless given.
        rotate_deg: Turn every sweep counter-clockwise about z; 180 looks backwards.
        reading: How the files of the sweeps and of the labelled frames are read.
        frames: Sweeps to learn from at most, spread evenly; 0 takes all.
        source_frames: Source frames at most, spread evenly.
        rounds: Times that the teacher is renewed.
        steps: Training steps of all rounds; 0 takes a quarter of those that made the weights, 1,000 at most.
        minutes: Take fewer steps where all would last longer than this; 0 sets no limit.
        whole_bodies: Learn boxes of whole bodies, as KITTI's and K-Radar's are, where the detector's show the parts
            that a sensor sees, as Cirrus' are: the source's labels teach them in the first round, pseudo boxes from
            then on.
        seed: Another seed simulates other roads and draws other batches.
        jobs: Who does the work.
        out: Folder of the adaptation; runs/adapted-DATA unless given.
        overwrite: Begin anew; simulated source frames stay.
        dry_run: Say what would be written, and write nothing.
    """
    from rich.console import Console

    from farfield.api import adapt

    opened = reading.open(data, rotate_deg=rotate_deg)
    folder = out or Path("runs") / f"adapted-{opened.root.name}"
    console = Console(stderr=True)
    kind = _Bars if console.is_terminal else _Lines
    choices: dict[str, Any] = {
        "source": source,
        "labels": None if labels is None else reading.open(labels, rotate_deg=rotate_deg),
        "clouds": tuple(names(clouds)),
        "frames": frames,
        "source_frames": source_frames,
        "rounds": rounds,
        "steps": steps,
        "minutes": minutes,
        "whole_bodies": whole_bodies,
        "overrides": tuple(override),
        "seed": seed,
    }
    if dry_run:
        from farfield.experiments.adapting import dry_run as lines_of_dry_run

        for line in lines_of_dry_run(detector, opened, out=folder, **choices):
            print(line)
        would_write("weights, report.html and what each round needs to go on", folder)
        return 0
    adapted = adapt(
        detector,
        opened,
        out=folder,
        **choices,
        bulk=jobs.options("searching"),
        report=kind(console, folder, 20),
        overwrite=overwrite,
    )
    print(f"weights: {adapted.weights}\nreport: {adapted.page.resolve()}")
    for row in () if adapted.scores is None else adapted.scores.lines:
        label, annotated, figure, before, after, gain = (" ".join(filter(None, cell)) for cell in row)
        print(f"{label}, {annotated} annotated, {figure}: {before} before, {after} after; difference {gain}")
    return 0


class _Lines(LineReport):
    """The lines of every round."""

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar."""
        return bar(numbers, what, transient=True)

    def on_train_start(self, step: int, steps: int) -> None:
        """Start the clock of a round."""
        self.first = None
        super().on_train_start(step, steps)

    def on_train_end(self, weights: Path | None) -> None:
        """Print nothing: the weights of a round are not the final ones."""
        del weights


class _Bars(BarReport):
    """The bar of every round."""

    def reading(self, numbers: Iterable[int], what: str) -> Iterable[int]:
        """With a progress bar of its own."""
        return bar(numbers, what, transient=True)

    def on_train_end(self, weights: Path | None) -> None:
        """Leave the bar."""
        del weights
        self.progress.stop()
