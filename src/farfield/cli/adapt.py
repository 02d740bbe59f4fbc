"""``farfield adapt``."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_FILES_SAY, Files, Jobs, names
from farfield.cli._output import bar, check_outputs, console, leave_card, would_write
from farfield.cli._training_report import BarReport, LineReport
from farfield.errors import ConfigError

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def run(
    detector: Positional[str],
    data: Positional[tuple[Path, ...]],
    override: Annotated[tyro.conf.UseAppendAction[list[str]], tyro.conf.arg(aliases=["-o"])],
    *,
    source: Path | None = None,
    labels: Path | None = None,
    learn_from: Path | None = None,
    clouds: Annotated[str, tyro.conf.arg(aliases=["--cloud"])] = "",
    rotate_deg: float = 0.0,
    reading: Files = AS_FILES_SAY,
    frames: int = 400,
    source_frames: int = 240,
    rounds: int = 2,
    steps: int = 0,
    minutes: float = 0.0,
    whole_bodies: bool = False,
    donors: int = 0,
    seed: int = 0,
    jobs: Jobs = ALL_CORES,
    out: Path | None = None,
    overwrite: bool = False,
    dry_run: bool = False,
) -> int:
    """Adapt a detector to your own sweeps, unlabelled or with a few labels; run the same command again to go on.

    examples:
      farfield adapt pointpillars-cirrus-sim my-sweeps
      farfield adapt pointpillars-cirrus-sim my-sweeps --minutes 60 --out runs/mine
      farfield adapt pointpillars-cirrus-sim monday tuesday wednesday --frames 0
      farfield adapt runs/pointpillars-kitti my-sweeps --source /data/kitti
      farfield adapt pointpillars-cirrus-sim my-sweeps --labels my-labelled-sweeps
      farfield adapt pointpillars-cirrus-sim my-sweeps --learn-from my-sweeps --whole-bodies
      farfield adapt pointpillars-cirrus-sim my-sweeps --learn-from ten-sweeps.csv --labels other-drive
      farfield adapt pointpillars-cirrus-sim my-sweeps --whole-bodies
      farfield adapt pointpillars-cirrus-sim my-sweeps --donors 40
      farfield adapt pointpillars-cirrus-sim my-sweeps --rounds 3 -o method.strong.thinning=0.5

    Confident detections in your sweeps become training objects, less confident ones are ignored, and every batch also
    holds labelled frames like those of the original training: simulated ones, unless --source names others. Labels of
    your sweeps are not read, except those of --learn-from, which join every batch. The weights of the last step are
    taken, not the best ones. OUT then holds weights.safetensors, which all verbs take as a detector, and report.html,
    which shows what changed. A killed command resumes to the same weights.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        data: The sweeps, of one data set or of several, such as drives that lie in folders of their own; the format is
            recognised, and a plain folder of clouds is a data set.
        override: Change a setting of method, training or augmentation, as key.key=value; may be given several times.
        source: Labelled frames of the kind that the detector learnt from; by default they are simulated, without
            camera, from the preset that its weights name.
        labels: Labelled frames on which to score before and after, at the end: they decide nothing. Frames that are
            learnt from do not count, so that DATA itself may be named; frames of --learn-from are refused.
        learn_from: Labels of a few of your sweeps to learn from: a data set's folder with annotated frames, DATA itself
            among them; or a table (.csv) or a folder (FRAME.json) of boxes of frames of DATA.
        clouds: Clouds of the sweeps to learn from, separated by commas (default: the first that suits).
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
        donors: Copies of each sweep in which simulated road users stand, hidden by what is there and with shadows: they
            teach in every batch, before your own background. What else stands there counts neither as object nor as
            background. The sweeps have to be in their sensor's axes.
        seed: Another seed simulates other roads and draws other batches.
        jobs: Who does the work.
        out: Folder of the adaptation (default: runs/adapted-DATA).
        overwrite: Begin anew; simulated source frames stay.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.api import adapt
    from farfield.datasets.joined import joined

    if not data:
        raise ConfigError("adapt: expected the folder of your sweeps behind the detector, got none")
    opened = joined([reading.open(one, rotate_deg=rotate_deg) for one in data])
    folder = out or Path("runs") / f"adapted-{opened.root.name}"
    check_outputs((detector, *data, source, labels, learn_from, *reading.paths), folders={"--out": folder})
    if source is not None and source.resolve() in {one.resolve() for one in data}:
        print(
            f"warning: --source {source} is DATA itself: its labels are learnt from, and a score on these frames says "
            "nothing of others",
            file=sys.stderr,
        )
    terminal = console(stderr=True)
    kind = _Bars if terminal.is_terminal else _Lines
    choices: dict[str, Any] = {
        "source": source,
        "labels": None if labels is None else reading.open(labels, rotate_deg=rotate_deg),
        "learn_from": _opened_labels(learn_from, reading, rotate_deg),
        "clouds": tuple(names(clouds)),
        "frames": frames,
        "source_frames": source_frames,
        "rounds": rounds,
        "steps": steps,
        "minutes": minutes,
        "whole_bodies": whole_bodies,
        "donors": donors,
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
        report=kind(terminal, folder, 20),
        overwrite=overwrite,
    )
    roots = [part for part in (*data, source, labels, learn_from) if part is not None]
    leave_card(folder, f"Weights adapted from {Path(detector).name}, and pseudo labels", *roots)
    print(f"weights: {adapted.weights}\nreport: {adapted.page.resolve()}")
    for row in () if adapted.scores is None else adapted.scores.lines:
        label, annotated, figure, before, after, gain = (" ".join(filter(None, cell)) for cell in row)
        print(f"{label}, {annotated} annotated, {figure}: {before} before, {after} after; difference {gain}")
    return 0


def _opened_labels(path: Path | None, reading: Files, rotate_deg: float) -> "Path | Dataset | None":
    """A data set that is to teach, read as the sweeps are; files of labels stay a path."""
    from farfield.datasets import recognise

    is_data_set = path is not None and path.is_dir() and recognise(path) is not None
    return reading.open(path, rotate_deg=rotate_deg) if path is not None and is_data_set else path


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
