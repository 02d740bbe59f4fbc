"""The calibration that windows share: values and picks with undo, what was solved, what was saved."""

from dataclasses import replace
from pathlib import Path

from farfield.calibration.jobs import KRADAR_NODE_M
from farfield.calibration.radar_matching import RadarPose
from farfield.datasets.base import Dataset
from farfield.errors import ConfigError
from farfield.files.atomic import read_bytes, write_bytes
from farfield.studio.calibrating.camera_task import CameraTask
from farfield.studio.calibrating.radar_task import RadarTask
from farfield.studio.calibrating.task import CalibrationSolution, CalibrationTask, Pick, Snapshot, Values, radar_values
from farfield.studio.messages.calibration import MOST_PICKS, CalibState, CameraValues, PickRow, RadarValues
from farfield.studio.options import CalibrationSettings
from farfield.studio.showing.layers import camera_model
from farfield.studio.showing.opened import plain_error, plain_remarks

_MOST_STEPS = _MOST_TAKEN = 1000
_MAX_BYTES = 1 << 20
_COPY = ".before-"


class CancelledError(Exception):
    """Somebody stopped the job."""


class CalibrationError(ConfigError):
    """What cannot be done now, with what to do about it.

    Args:
        code: A word for the page.
        sentence: Why.
        fix: What to do.
    """

    def __init__(self, code: str, sentence: str, mend: str = "") -> None:
        super().__init__(sentence)
        self.code, self.sentence, self.mend = code, sentence, mend


class CalibrationService:
    """One calibration.

    Args:
        data: The data set.
        settings: Which kind, frames and start.

    Raises:
        FarfieldError: If the data set has no such sensors or frames.
    """

    def __init__(self, data: Dataset, settings: CalibrationSettings) -> None:
        self.data, self.settings, self.remarks = data, settings, plain_remarks(data)
        self.task: CalibrationTask = (
            RadarTask(data, settings) if settings.kind == "radar-lidar" else CameraTask(data, settings)
        )
        self._steps = [Snapshot(self.task.before, self.task.picks())]
        self._at = 0
        self._saved: Values = self._steps[0].values
        self._written: list[Path] = []
        self._stored = self.task.stored
        # What takes the reader's radar points back to the nodes that were measured, in the radar's coordinates.
        self._read: RadarValues | None = None
        if isinstance(self._stored, RadarPose):
            x_m, y_m = self._stored.x_m + KRADAR_NODE_M, self._stored.y_m + KRADAR_NODE_M
            self._read = radar_values(replace(self._stored, x_m=x_m, y_m=y_m))
        self.seq = 0
        self.ready = False
        self.job: str | None = None
        self._taken: dict[str, None] = {}
        self._stop = False

    @property
    def now(self) -> Snapshot:
        """The calibration as it stands."""
        return self._steps[self._at]

    def was_taken(self, message: str) -> bool:
        """Whether a message was taken before, among the last thousand: one that comes again changes nothing."""
        return message in self._taken

    def note_taken(self, message: str) -> None:
        """Note that a message was taken."""
        self._taken[message] = None
        while len(self._taken) > _MOST_TAKEN:
            del self._taken[next(iter(self._taken))]

    def begin(self, job: str) -> None:
        """Let a job begin.

        Raises:
            CalibrationError: If one runs already.
        """
        if self.job is not None:
            raise CalibrationError("busy", "something is being computed already", "wait, or stop it with Esc")
        self.job, self._stop = job, False

    def end(self) -> None:
        """The job is over."""
        self.job = None

    def cancel(self) -> bool:
        """Stop the job at its next step; whether there was one."""
        self._stop = True
        return self.job is not None

    def go_on(self) -> None:
        """For a job between its steps.

        Raises:
            CancelledError: If somebody stopped it.
        """
        if self._stop:
            raise CancelledError

    def values_of(self, radar: RadarValues | None, camera: CameraValues | None) -> Values:
        """The values of a message that are of this kind.

        Raises:
            CalibrationError: If they are of the other kind, or there are none.
        """
        values = radar if self.task.kind == "radar-lidar" else camera
        if values is None or (radar is not None and camera is not None):
            what = "a radar" if self.task.kind == "radar-lidar" else "a camera"
            raise CalibrationError("kind", f"expected the values of {what}", "reload the page")
        return values

    def set(self, base: int, values: Values) -> None:
        """Take values; what was solved counts no more.

        Raises:
            CalibrationError: If they come from another state than the present one.
        """
        if base != self.seq:
            raise CalibrationError("conflict", "another window changed the calibration meanwhile", "change it again")
        if values != self.now.values:
            self._push(replace(self.now, values=values, solved=None))

    def pick(self, frame: int, point_m: tuple[float, float, float], pixel: tuple[float, float]) -> None:
        """Add a pair, unless it is there already, as two windows that recover send the same pairs.

        Raises:
            CalibrationError: If there are too many, or no pairs are picked here.
        """
        if self.task.kind != "lidar-camera":
            raise CalibrationError("kind", "pairs are picked for a camera only")
        if all(served.index != frame for served in self.task.frames):
            raise CalibrationError("frame", f"frame {frame} is not among those that serve", "go to one of them")
        if any((pick.frame, pick.point_m, pick.pixel) == (frame, point_m, pixel) for pick in self.now.picks):
            return
        if len(self.now.picks) >= MOST_PICKS:
            raise CalibrationError("full", f"{MOST_PICKS} pairs are picked", "remove some")
        number = 1 + max((served.number for served in self.now.picks), default=0)
        self._push(replace(self.now, picks=(*self.now.picks, Pick(number, frame, point_m, pixel))))

    def unpick(self, number: int, used: bool | None) -> None:
        """Take a pair away, or leave it out or in.

        Raises:
            CalibrationError: If there is none of this number.
        """
        if all(pick.number != number for pick in self.now.picks):
            raise CalibrationError("pick", f"there is no pair {number}")
        rest = (pick for pick in self.now.picks if used is not None or pick.number != number)
        rows = (replace(pick, used=used) if used is not None and pick.number == number else pick for pick in rest)
        self._push(replace(self.now, picks=tuple(rows)))

    def take(self, solved: CalibrationSolution) -> None:
        """Take what a solver found."""
        self._push(replace(self.now, values=solved.values, solved=solved))

    def undo(self, what: str) -> None:
        """Take the last change back, or do it again.

        Raises:
            CalibrationError: If there is none.
        """
        to = self._at + (1 if what == "redo" else -1)
        if not 0 <= to < len(self._steps):
            raise CalibrationError("undo", f"there is nothing to {what}")
        self._at = to
        self.seq += 1

    def _push(self, snapshot: Snapshot) -> None:
        self._steps = [*self._steps[max(0, self._at + 1 - _MOST_STEPS) : self._at + 1], snapshot]
        self._at = len(self._steps) - 1
        self.seq += 1

    def save(self, to: str) -> tuple[list[Path], list[Path]]:
        """Write the calibration; files, and copies of what was there. Reads and writes files: for a thread.

        Raises:
            FarfieldError: If the data set has no place for it, or a file cannot be read.
        """
        now = self.now
        self._stored = self.task.stored
        written = self.task.save(now, None if to == "data" else self.settings.folder)
        self._written = written
        self._saved = now.values
        self.seq += 1
        return [path for path in written if _COPY not in path.name], [path for path in written if _COPY in path.name]

    def restore(self) -> list[Path]:
        """Put back byte for byte what the last save replaced; files that were not there go. For a thread.

        Raises:
            CalibrationError: If nothing was saved.
        """
        if not self._written:
            raise CalibrationError("restore", "nothing was saved that could be put back")
        copies = {path.with_name(path.name.split(_COPY)[0]): path for path in self._written if _COPY in path.name}
        files = [path for path in self._written if _COPY not in path.name]
        for path in files:
            if path in copies:
                write_bytes(path, read_bytes(copies[path], max_bytes=_MAX_BYTES))
            else:
                path.unlink(missing_ok=True)
        self._written, self._saved = [], self._steps[0].values
        self.task.stored = self._stored
        self.seq += 1
        return files

    def shown(self, path: Path) -> str:
        """A file as the page may name it."""
        return plain_error(str(path), self.data)

    def state(self, answers: str = "") -> CalibState:
        """As a message that answers a request."""
        task, now = self.task, self.now
        values, files = now.values, task.saves_to()
        return CalibState(
            kind=task.kind,
            answers=answers,
            seq=self.seq,
            ready=self.ready,
            radar=values if isinstance(values, RadarValues) else None,
            camera=values if isinstance(values, CameraValues) else None,
            before=task.before,
            stored=self._read,
            start=None if task.start is None else camera_model(task.start),
            sensor=task.sensor,
            lidar=task.lidar,
            frames=task.frames,
            numbers=task.numbers,
            picks=self._picks(),
            solved="" if now.solved is None else now.solved.summary,
            offsets=() if now.solved is None else now.solved.offsets,
            notes=() if now.solved is None else (*now.solved.notes, *self.remarks),
            undo=self._at > 0,
            redo=self._at < len(self._steps) - 1,
            unsaved=values != self._saved,
            restorable=bool(self._written),
            saves_to=tuple(self.shown(path) for path in files[0][:20]),
            not_saved=plain_error(task.lost(values) or files[1], self.data),
            folder=self.shown(self.settings.folder),
        )

    def _picks(self) -> tuple[PickRow, ...]:
        rows = zip(self.now.picks, self.task.off_px(self.now), strict=True)
        return tuple(
            PickRow(
                pick=pick.number,
                frame=pick.frame,
                point_m=pick.point_m,
                pixel=pick.pixel,
                used=pick.used,
                residual_px=None if off is None else round(off, 3),
                range_m=round(sum(coordinate * coordinate for coordinate in pick.point_m) ** 0.5, 2),
            )
            for pick, off in rows
        )
