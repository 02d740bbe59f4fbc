"""``farfield adapt``: self-training of a detector on unlabelled sweeps, from beginning to end, resumable.

The order of work: look at the detector and at one target frame; source frames, simulated if need be; thresholds from
the source's scores; search of the target; rounds of training, each with a fixed last step; search; weights and page.
What is done stays in the folder, so that the same command goes on where it was killed, to the same bits. Labels of
the target decide nothing, but for those of a few sweeps that the user names to learn from.
"""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from farfield.adaptation.failure_modes import diagnose_log
from farfield.adaptation.pseudo_labels import check_ignores
from farfield.datasets import Dataset, open_dataset
from farfield.datasets.joined import joined
from farfield.datasets.maps import WholeBodies
from farfield.detectors.runtime import Detector
from farfield.detectors.weights import load_weights, save_weights
from farfield.errors import ConfigError, DatasetError
from farfield.evaluation import as_trained, detect, suitable_clouds
from farfield.evaluation.leakage import digests_text
from farfield.experiments.adapting.donors import check_donors, donor_frames
from farfield.experiments.adapting.folder import PAGE, SCORES, WEIGHTS, check_folder, clear
from farfield.experiments.adapting.labelled import LabelledSweeps, labelled_sweeps
from farfield.experiments.adapting.options import (
    THRESHOLDS,
    AdaptationOptions,
    CalibratedThresholds,
    load_thresholds,
    options_of,
    save_thresholds,
)
from farfield.experiments.adapting.report import HeldOutFrames, held_frames, held_scores, page_of
from farfield.experiments.adapting.rounds import (
    check_minutes,
    check_round,
    experiment_of_round,
    measured_step_s,
    pseudo_label_rates,
    rare_classes,
    simulated_frame_s,
    steps_in,
    steps_wanted,
)
from farfield.experiments.adapting.source import FOLDER, TrainingHistory, learnt_by, simulation_of, source_frames
from farfield.experiments.frames import spread, without
from farfield.experiments.plan import Plan, logged
from farfield.experiments.schema import DataConfig, Experiment
from farfield.files.atomic import write_text
from farfield.files.remote_paths import as_path
from farfield.files.sizes import sized
from farfield.jobs import JobOptions
from farfield.jobs.folders import held
from farfield.metrics.detections import Detections
from farfield.metrics.score_calibration import thresholds_of
from farfield.pages.training_pages import HeldScores
from farfield.simulation.recording.frames import bytes_needed
from farfield.simulation.recording.recorder import planned_recording
from farfield.training.report import TrainingReport
from farfield.vocabulary.counts import count_of


@dataclass(frozen=True, kw_only=True)
class AdaptationResult:
    """What an adaptation left.

    Args:
        folder: Its folder; ``load_detector`` takes it.
        weights: The adapted weights.
        page: What changed, one self-contained page.
        before: What the detector found in the target before.
        after: What it finds now.
        settled: Thresholds and steps.
        signs: Failure modes that the logs show, one sentence each.
        scores: Scores on labelled frames that were not learnt from; None where none were given.
    """

    folder: Path
    weights: Path
    page: Path
    before: Detections
    after: Detections
    settled: CalibratedThresholds
    signs: tuple[str, ...] = ()
    scores: HeldScores | None = None


def adapt(
    detector: str | Path,
    data: Path | str | Dataset | Sequence[Path | str],
    *,
    out: Path | str,
    source: Path | str | None = None,
    labels: Path | str | Dataset | None = None,
    learn_from: Path | str | Dataset | None = None,
    bulk: JobOptions | None = None,
    report: TrainingReport | None = None,
    overwrite: bool = False,
    **choices: Any,
) -> AdaptationResult:
    """Adapt a detector to unlabelled sweeps by self-training.

    Args:
        detector: A bundled detector's name, a run's folder or a weights file.
        data: The sweeps: a data set's folder, or one that is open, or the folders of several drives. Annotations are
            not looked at.
        out: Folder of the adaptation; called again with the same arguments, it goes on there.
        source: Labelled frames like those that the detector learnt from; by default they are simulated, from the preset
            that the weights' provenance names, without camera.
        labels: Labelled frames on which the detector is scored before and after, at the end: they decide nothing. Those
            that are learnt from do not count, so that the sweeps' own data set may be named.
        learn_from: Labels of a few of the user's sweeps, which teach: a data set with annotated frames, the sweeps' own
            among them, or its folder; or a table of boxes or a folder of ``FRAME.json`` of frames of ``data``. All
            other sweeps teach by pseudo boxes.
        bulk: Who detects (default: this process).
        report: Is informed of the course.
        overwrite: Begin anew; simulated source frames stay.
        **choices: Fields of :class:`~farfield.experiments.adapting.options.AdaptationOptions`.

    Raises:
        ConfigError: If a choice does not fit, the weights do not say what they learnt from or cannot ignore boxes, no
            cloud suits the detector, the folder holds something else, no labelled frame is left to score on, or a
            frame is among ``labels`` and among ``learn_from``.
        DatasetError: If there are no frames, all are labelled, or the labels that are to teach cannot.
        FarfieldError: If there are no such weights, or a round yields no pseudo box.
    """
    folder = Path(out)
    job = _job(detector, data, folder, source, labels, learn_from, bulk, report, choices)
    with held(folder):
        if overwrite:
            clear(folder)
        return job.run()


def dry_run(
    detector: str | Path,
    data: Path | str | Dataset | Sequence[Path | str],
    *,
    out: Path | str,
    source: Path | str | None = None,
    labels: Path | str | Dataset | None = None,
    learn_from: Path | str | Dataset | None = None,
    **choices: Any,
) -> list[str]:
    """What :func:`adapt` would do, in lines, checked as far as it is before anything is written; writes nothing.

    Args:
        detector: As of ``adapt``, and so the others.
        data: The sweeps.
        out: Folder of the adaptation.
        source: Labelled frames.
        labels: Labelled frames to score on.
        learn_from: Labels that teach.
        **choices: See :class:`~farfield.experiments.adapting.options.AdaptationOptions`.

    Raises:
        ConfigError, DatasetError, FarfieldError: As ``adapt`` before it begins.
    """
    return _job(detector, data, Path(out), source, labels, learn_from, None, None, choices).dry_run()


def _job(
    detector: str | Path,
    data: Path | str | Dataset | Sequence[Path | str],
    folder: Path,
    source: Path | str | None,
    labels: Path | str | Dataset | None,
    learn_from: Path | str | Dataset | None,
    bulk: JobOptions | None,
    report: TrainingReport | None,
    choices: Mapping[str, Any],
) -> "AdaptationJob":
    """The work, checked; nothing is written."""
    began = time.monotonic()
    job = AdaptationJob(
        start=str(detector),
        labelled_source=None if source is None else as_path(source),
        data=_opened(data),
        folder=folder,
        choices=options_of(choices),
        bulk=bulk or JobOptions(),
        report=report or TrainingReport(),
        began=began,
        labels=labels if labels is None or isinstance(labels, Dataset) else open_dataset(labels),
        learn_from=learn_from,
    )
    check_folder(folder)
    job.check()
    return job


def _opened(data: Path | str | Dataset | Sequence[Path | str]) -> Dataset:
    """The sweeps, of one data set or of several."""
    if isinstance(data, Dataset):
        return data
    return joined([open_dataset(folder) for folder in ([data] if isinstance(data, Path | str) else data)])


@dataclass(frozen=True, kw_only=True)
class AdaptationJob:
    """One adaptation; what is expensive is made on first use, once.

    Args:
        start: The detector's weights.
        labelled_source: A labelled source; None simulates it.
        data: The target as it was opened.
        folder: Where it is done.
        choices: What was chosen.
        bulk: Who detects.
        report: Is informed.
        began: ``time.monotonic()`` at the beginning.
        labels: Labelled frames on which to score before and after in the end; None for none.
        learn_from: Labels of some of the sweeps, which teach; None for none.
    """

    start: str
    labelled_source: Path | None
    data: Dataset
    folder: Path
    choices: AdaptationOptions
    bulk: JobOptions
    report: TrainingReport
    began: float
    labels: Dataset | None = None
    learn_from: Path | str | Dataset | None = None

    @cached_property
    def detector(self) -> Detector:
        """The detector that is adapted; thresholds and teacher go by the network's own scores."""
        return Detector.load(self.start, calibrated=False)

    @cached_property
    def learnt(self) -> TrainingHistory:
        """What it learnt from."""
        return learnt_by(self.detector.provenance, self.start)

    @cached_property
    def target(self) -> tuple[DataConfig, Dataset]:
        """Settings and frames of the target, as the detector sees them."""
        if not len(self.data):
            raise DatasetError(f"{self.data.root}: expected frames to adapt to, found none.")
        frames: Dataset = as_trained(self.data, self.detector.info)
        if self.labelled is not None:
            frames = without(frames, self.labelled.frames)
            if not len(frames):
                raise DatasetError(
                    f"{self.data.root}: expected sweeps without labels beside those of --learn-from; all "
                    f"{count_of(len(self.data), 'sweep')} are labelled. To learn from labels alone: farfield train, "
                    "with training.start"
                )
        frames = frames.select(spread(len(frames), self.choices.frames))
        clouds = self.choices.clouds or suitable_clouds(self.detector.info, frames[0])[:1]
        options = dict(self.data.options)
        if self.detector.reference in (*frames.references, frames[0].reference):
            options["reference"] = self.detector.reference
        return DataConfig(path=self.data.root, clouds=clouds, options=options), frames

    @cached_property
    def labelled(self) -> LabelledSweeps | None:
        """The labelled sweeps that teach."""
        if self.learn_from is None:
            return None
        return labelled_sweeps(
            self.learn_from,
            self.data,
            self.detector,
            self.learnt,
            self.choices.clouds,
            whole_bodies=self.choices.whole_bodies,
        )

    @cached_property
    def source(self) -> tuple[DataConfig, Dataset]:
        """Settings and frames of the source, as they teach."""
        return self._source(whole_bodies=self.choices.whole_bodies)

    def _source(self, *, whole_bodies: bool) -> tuple[DataConfig, Dataset]:
        return source_frames(
            self.detector,
            self.learnt,
            self.folder,
            labelled=self.labelled_source,
            frames=self.choices.source_frames,
            seed=self.choices.seed,
            name=self.start,
            whole_bodies=whole_bodies,
            progress=partial(self.report.reading, what="simulating the source"),
            say=self.report.say,
        )

    @cached_property
    def held(self) -> HeldOutFrames | None:
        """The labelled frames that are not learnt from."""
        if self.labels is None:
            return None
        if self.labelled is not None:
            self.labelled.check_apart(self.labels)
        bodies = self.choices.whole_bodies and WholeBodies().fits(self.labels.unwrapped)
        return held_frames(self.labels.mapped(WholeBodies()) if bodies else self.labels, self.target[1])

    @cached_property
    def donors(self) -> tuple[DataConfig, Dataset] | None:
        """Settings and frames of the sweeps with simulated road users in them; their own labels are not looked at."""
        if not self.choices.donors:
            return None
        return donor_frames(*self.target, copies=self.choices.donors, seed=self.choices.seed)

    @property
    def streams(self) -> dict[str, Dataset]:
        """The frames of all streams."""
        labelled = {} if self.labelled is None else {"labels": self.labelled.frames}
        donors = {} if self.donors is None else {"donors": self.donors[1]}
        return {"source": self.source[1], "target": self.target[1], **labelled, **donors}

    @property
    def configs(self) -> dict[str, DataConfig]:
        """The settings of all streams."""
        labelled = {} if self.labelled is None else {"labels": self.labelled.config}
        donors = {} if self.donors is None else {"donors": self.donors[0]}
        return {"source": self.source[0], "target": self.target[0], **labelled, **donors}

    def check(self) -> None:
        """Refuse what cannot be adapted, before anything is simulated or written."""
        inputs = self.detector.network.inputs
        if len(inputs) != 1:
            raise ConfigError(
                f"adapt: expected a detector that reads one cloud; {self.start} reads {', '.join(inputs)}."
            )
        check_ignores(self.detector.network)
        if self.labelled_source is None:
            simulation_of(self.learnt, self.choices.source_frames, self.choices.seed, self.start)
        elif self.choices.whole_bodies:
            _ = self.source  # tells them, or says that it does not
        if self.labelled is not None:
            for line in self.labelled.check(self.detector):
                self.report.say(line)
        config, frames = self.target
        for cloud in config.clouds:
            self.detector.with_cloud(cloud)(frames[0])  # reads it, or says why it cannot
        if self.donors is not None:
            check_donors(self.donors[1], self.detector)
        if self.choices.minutes:
            self.check_time()
        if self.held is not None:
            as_trained(self.held.frames, self.detector.info)[0].cloud(next(iter(config.clouds)))

    def check_time(self) -> None:
        """Refuse minutes that cannot suffice, by the time of one search and one simulated frame.

        An adaptation that goes on has some of its work behind it, and is not checked.
        """
        if any(self.folder.glob(".found-*")) or (self.folder / THRESHOLDS).is_file():
            return
        choices, (config, frames) = self.choices, self.target
        detector = self.detector.with_cloud(next(iter(config.clouds)))
        begun = time.perf_counter()
        detector(frames[0])  # its second time: nothing is compiled or allocated now
        sweep_s, frame_s, simulated = time.perf_counter() - begun, 0.0, 0
        if self.labelled_source is None and not (self.folder / FOLDER).is_dir():
            simulation = simulation_of(self.learnt, choices.source_frames, choices.seed, self.start)
            recording = planned_recording(simulation, self.folder / FOLDER)
            frame_s, simulated = simulated_frame_s(recording), sum(recording.plan)
        sweeps = len(frames) * (choices.rounds + 1) + choices.source_frames * (self.labelled_source is None)
        check_minutes(choices, sweep_s, sweeps, frame_s, simulated, steps_wanted(choices, self.learnt))

    def dry_run(self) -> list[str]:
        """What is to be done, in lines; as many rounds and steps as are chosen, which --minutes may lower."""
        choices, steps = self.choices, steps_wanted(self.choices, self.learnt)
        if self.labelled_source is not None:
            source = f"the labelled frames of {self.labelled_source}"
        else:
            simulation = simulation_of(self.learnt, choices.source_frames, choices.seed, self.start)
            recording = planned_recording(simulation, self.folder / FOLDER)
            most = sized(bytes_needed(recording, sum(recording.plan)))
            source = f"{count_of(sum(recording.plan), 'frame')} of {simulation.preset}, simulated, at most {most}"
        searched = f"{count_of(len(self.target[1]), 'sweep')} searched {count_of(choices.rounds + 1, 'time')}"
        limit = f", or fewer: {choices.minutes:g} minutes" if choices.minutes else ""
        labels = [] if self.labelled is None else self.labelled.check(self.detector)
        rounds = f"{searched}, {choices.rounds} rounds of {count_of(steps, 'step')}{limit}"
        donors = [] if self.donors is None else [f"donors: {count_of(len(self.donors[1]), 'frame')} made of the sweeps"]
        return [f"source: {source}", *labels, *donors, rounds]

    def run(self) -> AdaptationResult:
        """Do all that is not done yet: thresholds, rounds of pseudo-labels and training, weights, scores, page."""
        # 1. Thresholds of the pseudo-labels, from the scores on labelled source frames
        calibration = self.calibrated()
        # 2. Rounds: the target is searched, and a student learns what its teacher detected
        if self.labelled is not None and (contradiction := self.labelled.contradiction(self.source[1])):
            self.report.say(contradiction)
        detections = [self.search(self.start, 0)]
        for number in range(1, self.choices.rounds + 1):
            if self.labelled is None:  # else the labels teach, whatever the teacher finds
                check_round(detections[-1].boxes, calibration, number, self.streams, self.clouds)
            self.say_round(number, detections[-1], calibration)
            detections.append(self.search(self.train(number, calibration, detections[-1]), number))
        self.say_round(0, detections[-1], calibration)
        # 3. Weights, scores on labelled frames, and the page
        weights, rows = self.export(calibration), self.rows()
        signs = tuple(diagnose_log(rows))
        scores = self.scores(weights)
        page = page_of(
            self.folder / PAGE,
            start=self.start,
            detector=self.detector,
            data=self.streams,
            clouds=self.clouds,
            calibration=calibration,
            detections_by_round=detections,
            rows=rows,
            signs=signs,
            held=None if self.held is None else self.held.frames,
            scores=scores,
        )
        return AdaptationResult(
            folder=self.folder,
            weights=weights,
            page=page,
            before=detections[0],
            after=detections[-1],
            settled=calibration,
            signs=signs,
            scores=scores,
        )

    def scores(self, weights: Path) -> HeldScores | None:
        """Scores of the first and of the last weights on the labelled frames, kept in the folder; nothing is chosen."""
        if self.held is None:
            return None
        before, after = (
            detect(
                detector,
                self.held.frames,
                cloud=self.clouds["target"],
                annotated_only=True,
                bulk=self.job_options(f"scoring {name}"),
                journal=self.folder / f".found-held-{name}.jsonl",
            )
            for name, detector in (("before", self.detector), ("after", Detector.load(weights)))
        )
        scores = held_scores(self.held, before, after, self.detector.class_names, self.learnt.aliases)
        write_text(self.folder / SCORES, json.dumps(scores.to_json(), indent=1) + "\n")
        return scores

    @property
    def clouds(self) -> dict[str, str]:
        """The cloud of each stream that is searched."""
        return {name: next(iter(config.clouds)) for name, config in self.configs.items()}

    def identity(self) -> dict[str, Any]:
        """All that decides the outcome, for those who go on."""
        config, choices = self.configs, self.choices.model_dump(mode="json")
        for name in ("whole_bodies", "donors"):  # earlier versions did not know them
            if not choices[name]:
                del choices[name]
        return {
            "detector": self.detector.digest(),
            "target": self.target[1].fingerprint(),
            "source": self.source[1].fingerprint(),
            "source_clouds": list(config["source"].clouds),
            **choices,
            "clouds": list(config["target"].clouds),
            **self.identity_of_labels(),
        }

    def identity_of_labels(self) -> dict[str, Any]:
        """What of the labels that teach decides the outcome; nothing where there are none."""
        if self.labelled is None:
            return {}
        frames = self.labelled.frames.fingerprint()
        return {"labels": self.labelled.digest, "labelled": frames, "labelled_clouds": list(self.labelled.clouds)}

    def calibrated(self) -> CalibratedThresholds:
        """Thresholds and steps: as they were measured in the folder before, or measured now."""
        identity = self.identity()
        earlier = load_thresholds(self.folder, identity)
        if earlier is not None:
            return earlier
        as_learnt = self._source(whole_bodies=False)[1]  # thresholds judge the detector by what it learnt
        labelled = detect(
            self.detector,
            as_learnt,
            cloud=self.clouds["source"],
            annotated_only=True,
            bulk=self.job_options("searching the source"),
            journal=self.folder / ".found-source.jsonl",
        ).counted()
        truth = {key: boxes.relabel(dict(self.learnt.aliases)) for key, boxes in labelled.annotated.items()}
        lowest = float(self.detector.config.score_threshold)
        scores = thresholds_of(labelled.boxes, truth, self.detector.class_names, lowest=lowest)
        calibration = CalibratedThresholds(
            settings=identity, **scores._asdict(), source_rate=0.0, steps=steps_wanted(self.choices, self.learnt)
        )
        calibration = calibration.model_copy(update={"source_rate": pseudo_label_rates(labelled.boxes, calibration)[0]})
        if self.choices.minutes:
            calibration = self.fit_minutes(calibration)
        save_thresholds(self.folder, calibration)
        return calibration

    def fit_minutes(self, calibration: CalibratedThresholds) -> CalibratedThresholds:
        """As many steps as the minutes allow: a search of the target and a few steps are timed."""
        before = time.monotonic()
        detections = self.search(self.start, 0)
        search_s = time.monotonic() - before
        experiment = self.experiment(1, calibration, detections)
        step_s = measured_step_s(experiment, self.streams, self.folder)
        left_s = 60 * self.choices.minutes - (time.monotonic() - self.began) - self.choices.rounds * search_s
        steps = steps_in(left_s, step_s, self.choices, calibration.steps)
        self.report.say(f"a step takes {step_s:.2f} s: {self.choices.rounds} rounds of {count_of(steps, 'step')}")
        return calibration.model_copy(update={"steps": steps, "step_s": step_s})

    def experiment(self, number: int, calibration: CalibratedThresholds, detections: Detections) -> Experiment:
        """The training of a round, by what its teacher detected in the target."""
        start = self.start if number == 1 else self.folder / f"round-{number - 1}" / WEIGHTS
        return experiment_of_round(
            start, self.detector, self.learnt, self.configs, calibration, self.choices, number, detections.boxes
        )

    def train(self, number: int, calibration: CalibratedThresholds, detections: Detections) -> Path:
        """Do a round, or go on with it; gives its weights."""
        folder = self.folder / f"round-{number}"
        if (folder / WEIGHTS).is_file():  # written at the end of a round, whole or not at all
            return folder / WEIGHTS
        rare = rare_classes(detections.boxes, calibration)
        if rare:
            self.report.say(
                f"few confident pseudo-labels of {', '.join(rare)}: what is found of these is ignored, not background"
            )
        return Plan(self.experiment(number, calibration, detections), folder, self.streams).run(self.report)

    def search(self, weights: str | Path, number: int) -> Detections:
        """What weights find in the target, kept in the folder; ``number`` is that of the round that made them."""
        detector = self.detector if number == 0 else Detector.load(weights)
        return detect(
            detector,
            self.target[1],
            cloud=self.clouds["target"],
            bulk=self.job_options(f"searching the target, {'before' if number == 0 else f'after round {number}'}"),
            journal=self.folder / f".found-{number}.jsonl",
        )

    def job_options(self, what: str) -> JobOptions:
        """Who detects, with a progress bar of that name."""
        workers = self.bulk.workers or int(self.detector.device.type != "cpu")
        return replace(self.bulk, workers=workers, progress=partial(self.report.reading, what=what))

    def say_round(self, number: int, detections: Detections, calibration: CalibratedThresholds) -> None:
        """Name the pseudo-labels a sweep beside the source's rate; 0 is the end."""
        confident, ignored = pseudo_label_rates(detections.boxes, calibration)
        when = f"round {number} of {self.choices.rounds}" if number else "in the end"
        self.report.say(
            f"{when}: {confident:.1f} confident pseudo-labels a sweep and {ignored:.1f} ignored boxes; the source has "
            f"{calibration.source_rate:.1f} confident ones"
        )

    def rows(self) -> list[dict[str, float | int]]:
        """The rounds' logs, one after the other, with the steps counted through."""
        rows: list[dict[str, float | int]] = []
        for number in range(1, self.choices.rounds + 1):
            before = rows[-1]["step"] if rows else 0
            read = logged(self.folder / f"round-{number}")
            rows += [{**row, "step": before + row["step"], "round": number} for row in read]
        return rows

    def export(self, calibration: CalibratedThresholds) -> Path:
        """Write the last round's weights with all that they come from."""
        network, provenance = load_weights(self.folder / f"round-{self.choices.rounds}" / WEIGHTS)
        places = self.detector.info.open_places
        adapted = {
            "start": self.start,
            "start_digest": self.detector.digest(),
            "start_frame_digests": digests_text(self.detector.provenance),
            "open_sweeps": None if places is None else list(places),
            "start_trained_on": self.detector.provenance.get("experiment", {}).get("data"),
            "target_fingerprint": calibration.settings["target"],
            "sweeps": {
                "labelled": 0 if self.labelled is None else len(self.labelled.frames),
                "unlabelled": len(self.target[1]),
                "drives": len({*self.target[1].sequences, *(self.labelled.frames.sequences if self.labelled else ())}),
            },
            "labels_digest": calibration.settings.get("labels", ""),
            "source_fingerprint": calibration.settings["source"],
            "choices": self.choices.model_dump(mode="json"),
            "positive": calibration.positive,
            "negative": calibration.negative,
            "steps_a_round": calibration.steps,
        }
        path = self.folder / WEIGHTS
        state = network.state_dict()
        save_weights(path, state, config=network.config, provenance={**provenance, "adapted": adapted})
        return path
