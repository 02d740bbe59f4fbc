"""When each stream of a drive fires, what its clock reads then, and when the computer records the message.

The clock of a sensor reads ``t + offset + drift t``, ``t`` since the beginning of the recording, with some jitter. The
LiDARs and the GPS are fired by the pulses of the GPS; a camera and the IMUs run freely, by their own oscillators, so
that their rates are off by their drift. A message reaches the computer after a least delay and a random rest, and is
recorded by the computer's clock.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from farfield.simulation.rigs.drive import HALF_SWEEP_S, SimulatedDrive
from farfield.simulation.sequence import frame_time_ns

SWEEP_S = 2 * HALF_SWEEP_S
_NS = 1e9


@dataclass(frozen=True)
class SensorClock:
    """A clock against GPS time.

    Args:
        offset_ms: How much later it reads at the beginning of the recording.
        drift_ppm: How much faster it runs.
        jitter_ms: Standard deviation of a single reading.
    """

    offset_ms: float = 0.0
    drift_ppm: float = 0.0
    jitter_ms: float = 0.0

    def read_s(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """What it reads at moments since the beginning, without jitter."""
        return time_s * (1 + self.drift_ppm * 1e-6) + self.offset_ms * 1e-3


@dataclass(frozen=True)
class StreamKind:
    """How a stream runs.

    Args:
        number: Draws its random numbers.
        rate_hz: Nominal rate.
        free: Whether it runs by its own oscillator; others follow the GPS' pulses.
        offset_ms: Its clock's offset is drawn between plus and minus this.
        drift_ppm: Likewise its drift.
        jitter_ms: Jitter of its stamps.
        busy_s: How long a measurement takes after its stamp, such as a sweep.
        delay_ms: Its least delay on the way to the computer is drawn from this range.
        rest_ms: Mean of the random rest of the delay, exponential.
        lost: Share of its messages that are lost.
    """

    number: int
    rate_hz: float
    free: bool = False
    offset_ms: float = 0.0
    drift_ppm: float = 0.0
    jitter_ms: float = 0.0
    busy_s: float = 0.0
    delay_ms: tuple[float, float] = (1.0, 2.0)
    rest_ms: float = 0.3
    lost: float = 0.0


_LIDAR = StreamKind(
    0, 10.0, offset_ms=20.0, drift_ppm=50.0, jitter_ms=0.1, busy_s=SWEEP_S, delay_ms=(2.0, 6.0), rest_ms=1.0
)
_CAMERA = StreamKind(
    2, 30.0, free=True, offset_ms=20.0, drift_ppm=50.0, jitter_ms=0.2, delay_ms=(15.0, 30.0), rest_ms=2.0, lost=0.01
)
KINDS = {
    "gaussian": _LIDAR,
    "uniform": replace(_LIDAR, number=1, lost=0.005),
    "camera": _CAMERA,
    "imu_front": StreamKind(3, 100.0, free=True, offset_ms=5.0, drift_ppm=30.0, jitter_ms=0.05),
    "imu_rear": StreamKind(4, 100.0, free=True, offset_ms=5.0, drift_ppm=30.0, jitter_ms=0.05),
    "gps": StreamKind(5, 1.0, delay_ms=(80.0, 150.0), rest_ms=5.0),
    "tf": StreamKind(6, 20.0, delay_ms=(1.0, 2.0), rest_ms=0.2),
}
"""The streams of a recording; ``tf`` is the navigation unit's pose, stamped by GPS time."""
_HOST, _DRIFT_PPM, _OFFSET_MS = 7, 20.0, 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorStream:
    """One stream of a recording as it ran.

    Args:
        name: Its name in :data:`KINDS`.
        clock: Its clock.
        phase_s: When it fired first.
        least_delay_ms: From the stamp's moment to the computer at least: the measurement itself and the way.
        number: Numbers of the messages that were recorded, shape (n,).
        time_s: When each was taken since the beginning, a sweep when it began, shape (n,).
        stamp_ns: Its stamp, by the sensor's clock, shape (n,).
        log_ns: When it was recorded, by the computer's clock, shape (n,).
        fired: How many were taken, the lost ones included.
    """

    name: str
    clock: SensorClock
    phase_s: float
    least_delay_ms: float
    number: Int64[np.ndarray, " n"]
    time_s: Float[np.ndarray, " n"]
    stamp_ns: Int64[np.ndarray, " n"]
    log_ns: Int64[np.ndarray, " n"]
    fired: int

    def truth(self, epoch_ns: int) -> dict[str, Any]:
        """Its clock, phase, delays, losses and true times, as JSON takes them."""
        kind = KINDS[self.name]
        lost = np.setdiff1d(np.arange(self.fired), self.number)
        return {
            "rate_hz": kind.rate_hz,
            "free_running": kind.free,
            **asdict(self.clock),
            "phase_ms": self.phase_s * 1e3,
            "least_delay_ms": self.least_delay_ms,
            "mean_rest_of_delay_ms": kind.rest_ms,
            "lost": lost.tolist(),
            "true_ns": (epoch_ns + np.rint(self.time_s * _NS).astype(np.int64)).tolist(),
        }


@dataclass(frozen=True, eq=False)
class Schedule:
    """All streams of one recording.

    Args:
        epoch_ns: Its beginning, GPS time.
        span_s: How long it lasts.
        host: The computer's clock.
        streams: The streams.
    """

    epoch_ns: int
    span_s: float
    host: SensorClock
    streams: dict[str, SensorStream]


def schedule(drive: SimulatedDrive, sweeps: int, names: tuple[str, ...]) -> Schedule:
    """Draw the clocks of a drive and let its streams run: the same for the same drive, whatever streams are recorded.

    Args:
        drive: The drive.
        sweeps: How many sweeps each LiDAR makes.
        names: Which streams, names of :data:`KINDS`.
    """
    span_s = sweeps * SWEEP_S
    epoch_ns = frame_time_ns(drive.preset, drive.seed, drive.sequence, 0) - round(HALF_SWEEP_S * _NS)
    rng = _rng(drive, _HOST)
    host = SensorClock(*(rng.uniform(-1, 1, 2) * (_OFFSET_MS, _DRIFT_PPM)).tolist())
    phases = {"uniform": drive.mounting.uniform_offset_s, "gaussian": 0.0, "gps": 0.0, "tf": 0.0}
    streams = {name: _run(name, drive, span_s, epoch_ns, host, phases.get(name)) for name in names}
    return Schedule(epoch_ns, span_s, host, streams)


def _rng(drive: SimulatedDrive, number: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence((drive.seed, drive.sequence), spawn_key=(9, number)))


def _run(
    name: str, drive: SimulatedDrive, span_s: float, epoch_ns: int, host: SensorClock, phase_s: float | None
) -> SensorStream:
    kind, rng = KINDS[name], _rng(drive, KINDS[name].number)
    offset_ms, drift_ppm = rng.uniform(-1, 1, 2) * (kind.offset_ms, kind.drift_ppm)
    clock = SensorClock(float(offset_ms), float(drift_ppm), kind.jitter_ms)
    phase, way_ms = float(rng.random()) / kind.rate_hz, float(rng.uniform(*kind.delay_ms))
    phase = phase if phase_s is None else phase_s
    period_s = 1 / kind.rate_hz / (1 + clock.drift_ppm * 1e-6 if kind.free else 1)
    count = int(np.ceil(span_s * kind.rate_hz - 1e-6))
    time_s = phase + np.arange(count) * period_s
    noise = rng.standard_normal(count) * kind.jitter_ms * 1e-3
    arrived_s = time_s + kind.busy_s + way_ms * 1e-3 + rng.exponential(kind.rest_ms * 1e-3, count)
    recorded = np.flatnonzero(rng.random(count) >= kind.lost)
    return SensorStream(
        name=name,
        clock=clock,
        phase_s=phase,
        least_delay_ms=kind.busy_s * 1e3 + way_ms,
        number=recorded,
        time_s=time_s[recorded],
        stamp_ns=epoch_ns + np.rint((clock.read_s(time_s) + noise)[recorded] * _NS).astype(np.int64),
        log_ns=epoch_ns + np.rint(host.read_s(arrived_s)[recorded] * _NS).astype(np.int64),
        fired=count,
    )
