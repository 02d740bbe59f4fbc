"""The doctor and the drives on stamps: gaps, doubled and backward times, breaks, sensors out of step."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from farfield.datasets.base import Dataset
from farfield.frame import Cloud, Drive, Frame, Sensor
from farfield.inspection.doctor import Finding, examine

START = 1_600_000_000_000_000_000
MS = 1_000_000
CLOUD = Cloud(np.zeros((5, 3), dtype=np.float32), np.zeros(5, dtype=np.float32))


class Stamped(Dataset):
    """Frames of given times; ``camera`` has stamps of its own."""

    name = "stamped"

    def __init__(self, times_ns: Sequence[int], camera_ns: Sequence[int | None]) -> None:
        self.root, self.times, self.camera = Path("/nowhere"), list(times_ns), list(camera_ns)
        self.sequences = ("one",) * len(self.times)
        self.frame_ids = tuple(str(number) for number in range(len(self.times)))

    def files(self, index: int) -> Sequence[Path]:
        return []

    def frame(self, index: int) -> Frame:
        time_ns, camera = self.times[index], self.camera[index]
        sensors = {"lidar": Sensor(kind="lidar", time_ns=time_ns)}
        sensors |= {} if camera is None else {"camera": Sensor(kind="camera", time_ns=camera)}
        return Frame(
            sequence="one", frame_id=str(index), time_ns=time_ns, sensors=sensors, clouds={"lidar": CLOUD}
        )  # fmt: skip

    def _times_of(self, indices: np.ndarray) -> np.ndarray:
        return np.array(self.times, dtype=np.int64)[indices]


def about(times_ns: Sequence[int], camera_ns: Sequence[int | None] | None = None) -> list[Finding]:
    data = Stamped(times_ns, [None] * len(times_ns) if camera_ns is None else camera_ns)
    return [finding for finding in examine(data, max_clouds=1).findings if finding.topic == "stamps"]


def steady(count: int = 40, period_ms: float = 100.0) -> np.ndarray:
    return START + np.rint(np.arange(count) * period_ms * MS).astype(np.int64)


def test_stamps_in_order_are_said_to_be() -> None:
    times = steady()
    (found,) = about(times.tolist(), (times + 12 * MS).tolist())
    assert found.severity == "ok"
    assert "3 streams in order, sensors within 12.0 ms" in found.what


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda t: np.insert(t, 5, t[5]), "1 stamp twice the same"),
        (lambda t: np.concatenate([t[:9], t[7:]]), "1 stamp earlier than the one before"),
        (lambda t: np.concatenate([t[:20], t[20:] + 33_200 * MS]), "a break of 33.3 s within a drive"),
    ],
)
def test_what_is_wrong_with_a_stream_is_a_warning(spoil: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    found = about(spoil(steady()).tolist())
    assert all(finding.severity == "warn" for finding in found)
    assert words in found[0].what
    assert found[0].where == "one"
    assert found[0].fix


def test_a_camera_that_is_a_frame_off_is_out_of_step() -> None:
    times = steady()
    (found,) = about(times.tolist(), (times - 68 * MS).tolist())
    assert (
        found.what
        == "camera is out of step: in 39 of 40 frames a neighbour's stamp is nearer; typically -68.0 ms from its frame"
    )
    assert "farfield sync" in found.fix


def test_a_camera_that_runs_freely_drifts() -> None:
    times = steady(100)
    camera = START + np.rint((times - START) * 1.004).astype(np.int64)
    (found,) = about(times.tolist(), camera.tolist())
    assert "camera drifts: its distance from the frames changes by" in found.what


def test_a_clock_of_another_day_shares_no_moment() -> None:
    times = steady()
    (found,) = about(times.tolist(), (times + 86_400_000 * MS).tolist())
    assert "camera shares no moment with its frames in 1 drive" in found.what


def test_figures_stand_in_the_facts() -> None:
    times = steady()
    facts = examine(Stamped(times.tolist(), (times + 12 * MS).tolist()), max_clouds=1).facts["stamps"]
    assert facts["camera"]["median_ms"] == pytest.approx(12)
    assert facts["frames"] == {"duplicates": 0, "backwards": 0, "gaps": 0, "longest_gap_s": 0.0}


def test_drives_say_it_themselves() -> None:
    times = steady(10)
    times[4] = times[3]
    (drive,) = Stamped((times + np.where(np.arange(10) > 6, 5_000 * MS, 0)).tolist(), [None] * 10).drives()
    assert isinstance(drive, Drive)
    assert drive.out_of_step() == ("1 time stands there twice", "a break of 5.1 s after frame 6")
    (sound,) = Stamped(steady().tolist(), [None] * 40).drives()
    assert sound.out_of_step() == ()
    (backward,) = Stamped(steady()[::-1].tolist(), [None] * 40).drives()
    assert backward.out_of_step() == ("39 times run backwards",)
