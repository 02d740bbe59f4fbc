"""Drivers: following by the Intelligent Driver Model, lane changes by MOBIL, and stopping at signals.

IDM: Treiber, Hennecke and Helbing, 2000, equations 3 and 4. MOBIL: Kesting, Treiber and Helbing, 2007. A vehicle that
changes lanes occupies both until it has left the old one, so that nobody drives beside it.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from farfield.simulation.world.motion import STEP_S

_LEAST_GAP_M = 1.0
_NONE_M = 1e6
_LANE_KEY_M = 1e7  # keys of lanes lie so far apart
_POLITENESS, _THRESHOLD_M_S2, _SAFE_M_S2, _KEEP_RIGHT_M_S2 = 0.3, 0.25, 2.5, 0.1
_CONSIDER_STEPS, _PAUSE_STEPS, _CALM_M = 5, 150, 40.0


@dataclass(eq=False)
class DriverSet:
    """n vehicles before they drive.

    Args:
        progress_m: Where each one's middle starts, along its own direction.
        lane: Its lane.
        length_m: Its length.
        desired_m_s: The speed it would drive on an empty road.
        headway_s: Time gap T.
        standstill_m: Gap s0 at a standstill.
        accelerate_m_s2: Greatest acceleration a.
        brake_m_s2: Comfortable deceleration b.
        steady: Those that keep their lane.
        surge: Depth of stop-and-go waves in the desired speed, 0 to below 1.
    """

    progress_m: Float[np.ndarray, " n"]
    lane: Int[np.ndarray, " n"]
    length_m: Float[np.ndarray, " n"]
    desired_m_s: Float[np.ndarray, " n"]
    headway_s: Float[np.ndarray, " n"]
    standstill_m: Float[np.ndarray, " n"]
    accelerate_m_s2: Float[np.ndarray, " n"]
    brake_m_s2: Float[np.ndarray, " n"]
    steady: Bool[np.ndarray, " n"]
    surge: float = 0.0

    def idm_m_s2(
        self,
        row: Int[np.ndarray, " m"] | slice,
        speed_m_s: Float[np.ndarray, " m"],
        gap_m: Float[np.ndarray, " m"],
        closing_m_s: Float[np.ndarray, " m"],
        ease: Float[np.ndarray, " m"] | float = 1.0,
    ) -> Float[np.ndarray, " m"]:
        """Acceleration of some vehicles, given the gaps to their leaders and how fast they close."""
        a, b = self.accelerate_m_s2[row], self.brake_m_s2[row]
        wish = self.standstill_m[row] + np.maximum(
            speed_m_s * (self.headway_s[row] + closing_m_s / (2 * np.sqrt(a * b))), 0.0
        )
        free = (speed_m_s / (self.desired_m_s[row] * ease)) ** 4
        change: Float[np.ndarray, " m"] = a * (1 - np.minimum(free, 4.0) - (wish / np.maximum(gap_m, 0.1)) ** 2)
        return np.clip(change, -8.0, a)


@dataclass(frozen=True)
class Signal:
    """A stop line: red during the first ``red_s`` of each period.

    Args:
        lane: Lane it holds for.
        progress_m: Place of the line.
        shift_s: Time by which its period began before time 0.
        period_s: Period.
        red_s: Red time of each.
    """

    lane: int
    progress_m: float
    shift_s: float
    period_s: float
    red_s: float


@dataclass(frozen=True)
class LaneChange:
    """One vehicle's move to another lane.

    Args:
        row: The vehicle.
        step: When it began.
        start_m: Its progress then.
        length_m: The distance over which it moves sideways.
        before: Lane it leaves.
        after: Lane it takes.
    """

    row: int
    step: int
    start_m: float
    length_m: float
    before: int
    after: int


@dataclass(frozen=True, eq=False)
class Trajectories:
    """What came of it.

    Args:
        progress_m: Progress at every moment, shape (n, steps). Bodies in a lane stay at least one metre apart.
        changes: Lane changes in the order in which they began.
    """

    progress_m: Float[np.ndarray, "n steps"]
    changes: list[LaneChange]


@dataclass(eq=False)
class _VehicleOrder:
    """Who follows whom: one entry for each vehicle, and one more for each that still occupies its old lane."""

    row: Int[np.ndarray, " e"]
    lane: Int[np.ndarray, " e"]
    leader: Int[np.ndarray, " e"] = field(init=False)
    sorted_row: Int[np.ndarray, " e"] = field(init=False)
    sorted_lane: Int[np.ndarray, " e"] = field(init=False)

    def settle(self, progress_m: Float[np.ndarray, " n"]) -> "_VehicleOrder":
        order = np.lexsort((progress_m[self.row], self.lane))
        self.sorted_row, self.sorted_lane = self.row[order], self.lane[order]
        self.leader = np.full(len(self.row), -1)
        same = self.sorted_lane[1:] == self.sorted_lane[:-1]
        self.leader[order[:-1][same]] = self.sorted_row[1:][same]
        return self


class _Simulation:
    def __init__(self, drivers: DriverSet, beside: Int[np.ndarray, "2 lanes"], signals: list[Signal]) -> None:
        self.drivers, self.beside = drivers, beside
        self.lane, self.old = drivers.lane.copy(), np.full(len(drivers.lane), -1)
        self.left_at_m = np.full(len(self.lane), np.inf)
        self.calm_until = np.arange(len(self.lane)) * 37 % _PAUSE_STEPS  # not all at once in the beginning
        self.changes: list[LaneChange] = []
        signals = sorted(signals, key=lambda signal: (signal.lane, signal.progress_m))
        self.signals = np.array([[s.lane, s.progress_m, s.shift_s, s.period_s, s.red_s] for s in signals]).reshape(
            -1, 5
        )
        self.order = self._ordered(drivers.progress_m)

    def _ordered(self, progress_m: Float[np.ndarray, " n"]) -> _VehicleOrder:
        both = np.flatnonzero(self.old >= 0)
        rows = np.concatenate([np.arange(len(self.lane)), both])
        return _VehicleOrder(rows, np.concatenate([self.lane, self.old[both]])).settle(progress_m)

    def gaps(self, progress_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " e"]:
        """Free distance of each entry to its leader."""
        row, leader = self.order.row, self.order.leader
        half_lengths_m = (self.drivers.length_m[row] + self.drivers.length_m[leader]) / 2
        return np.where(leader >= 0, progress_m[leader] - progress_m[row] - half_lengths_m, _NONE_M)

    def accelerate(
        self, progress_m: Float[np.ndarray, " n"], speed_m_s: Float[np.ndarray, " n"], time_s: float
    ) -> Float[np.ndarray, " n"]:
        """What each driver does: the least of what its leaders and a red signal allow."""
        row, leader, n = self.order.row, self.order.leader, len(self.lane)
        closing = np.where(leader >= 0, speed_m_s[row] - speed_m_s[leader], 0.0)
        ease: Float[np.ndarray, " e"] | float = 1.0
        if self.drivers.surge:
            ease = 1.0 + self.drivers.surge * np.sin(2 * np.pi * (time_s / 30.0 + progress_m[row] / 300.0))
        accelerations = self.drivers.idm_m_s2(row, speed_m_s[row], self.gaps(progress_m), closing, ease)
        out = accelerations[:n].copy()
        np.minimum.at(out, row[n:], accelerations[n:])
        return np.minimum(out, self._at_signals(progress_m, speed_m_s, time_s)) if len(self.signals) else out

    def _at_signals(
        self, progress_m: Float[np.ndarray, " n"], speed_m_s: Float[np.ndarray, " n"], time_s: float
    ) -> Float[np.ndarray, " n"]:
        front = progress_m + self.drivers.length_m / 2
        keys = self.signals[:, 0] * _LANE_KEY_M + self.signals[:, 1]
        index = np.minimum(np.searchsorted(keys, self.lane * _LANE_KEY_M + front), len(keys) - 1)
        lane, line_m, shift, period, red = self.signals[index].T
        gap = line_m - front
        holds = (lane == self.lane) & (gap > 0) & ((time_s + shift) % period < red)
        holds &= speed_m_s**2 < 2 * 3.5 * np.maximum(gap, 0.05)
        wait = self.drivers.idm_m_s2(slice(None), speed_m_s, np.where(holds, gap, _NONE_M), speed_m_s)
        return np.where(holds, wait, np.inf)

    def keep_apart(self, progress_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Hold vehicles back, leaders first, so that a metre stays between bodies."""
        corrected_m, length = progress_m.copy(), self.drivers.length_m
        entries = np.argsort(-progress_m[self.order.row], kind="stable")
        for entry in entries[self.order.leader[entries] >= 0]:
            row, leader = self.order.row[entry], self.order.leader[entry]
            corrected_m[row] = min(
                corrected_m[row], corrected_m[leader] - (length[row] + length[leader]) / 2 - _LEAST_GAP_M
            )
        return corrected_m

    def finish_changes(self, progress_m: Float[np.ndarray, " n"], step: int) -> None:
        """Vehicles that have reached their new lane leave the old one."""
        finished = (self.old >= 0) & (progress_m > self.left_at_m)
        if finished.any():
            self.old[finished] = -1
            self.calm_until[finished] = step + _PAUSE_STEPS
            self.order = self._ordered(progress_m)

    def consider_changes(
        self,
        progress_m: Float[np.ndarray, " n"],
        speed_m_s: Float[np.ndarray, " n"],
        change_m_s2: Float[np.ndarray, " n"],
        step: int,
    ) -> None:
        """Let those change lanes whom MOBIL tells to, one at a time in any stretch of road."""
        wish = np.stack([self._incentive(side, progress_m, speed_m_s, change_m_s2, step) for side in (0, 1)])
        gain, side = wish.max(axis=0), wish.argmax(axis=0)
        changed_m: list[float] = []
        for row in np.argsort(-gain, kind="stable"):
            if gain[row] <= 0:
                break
            if any(abs(progress_m[row] - other) < _CALM_M for other in changed_m):
                continue
            changed_m.append(float(progress_m[row]))
            length = max(3.0 * float(speed_m_s[row]), 22.0) + float(self.drivers.length_m[row])
            before, after = int(self.lane[row]), int(self.beside[side[row], self.lane[row]])
            self.old[row], self.lane[row] = before, after
            self.left_at_m[row] = progress_m[row] + length + self.drivers.length_m[row] / 2
            self.changes.append(LaneChange(int(row), step, float(progress_m[row]), length, before, after))
        if changed_m:
            self.order = self._ordered(progress_m)

    def _incentive(
        self,
        side: int,
        progress_m: Float[np.ndarray, " n"],
        speed_m_s: Float[np.ndarray, " n"],
        change_m_s2: Float[np.ndarray, " n"],
        step: int,
    ) -> Float[np.ndarray, " n"]:
        """Gain in acceleration over MOBIL's threshold by moving left (0) or right (1); -inf where unsafe."""
        drivers, order, n = self.drivers, self.order, len(self.lane)
        target = self.beside[side, self.lane]
        keys = order.sorted_lane * _LANE_KEY_M + progress_m[order.sorted_row]
        slot = np.searchsorted(keys, target * _LANE_KEY_M + progress_m)
        last = len(keys) - 1
        ahead, behind = np.minimum(slot, last), np.maximum(slot - 1, 0)
        lead = np.where((slot <= last) & (order.sorted_lane[ahead] == target), order.sorted_row[ahead], -1)
        tail = np.where((slot > 0) & (order.sorted_lane[behind] == target), order.sorted_row[behind], -1)
        rows, meet = np.arange(n), partial(_meet, drivers, progress_m, speed_m_s)
        gap_lead, acceleration_after = meet(rows, lead)
        gap_tail, tail_after = meet(tail, rows)
        if side == 0:  # who moves left minds those on the left, who moves right minds those behind
            minded, after = tail, tail_after
        else:
            minded, led = np.full(n, -1), order.leader[:n] >= 0
            minded[order.leader[:n][led]] = np.flatnonzero(led)
            _, after = meet(minded, order.leader[:n])
        loss = np.where(minded >= 0, after - change_m_s2[minded], 0.0)
        gain = (
            acceleration_after
            - change_m_s2
            + _POLITENESS * loss
            - _THRESHOLD_M_S2
            + (_KEEP_RIGHT_M_S2 if side else -_KEEP_RIGHT_M_S2)
        )
        able = (target >= 0) & (self.old < 0) & (step >= self.calm_until) & ~drivers.steady & (speed_m_s > 4.0)
        safe = (acceleration_after > -_SAFE_M_S2) & ((tail < 0) | (tail_after > -_SAFE_M_S2))
        safe &= (gap_lead > 3.0 + 0.3 * speed_m_s) & (gap_tail > 3.0 + 0.3 * np.where(tail >= 0, speed_m_s[tail], 0.0))
        return np.where(able & safe, gain, -np.inf)


def _meet(
    drivers: DriverSet,
    progress_m: Float[np.ndarray, " n"],
    speed_m_s: Float[np.ndarray, " n"],
    back: Int[np.ndarray, " n"],
    front: Int[np.ndarray, " n"],
) -> tuple[np.ndarray, np.ndarray]:
    """Gap and acceleration of the ``back`` ones if they followed the ``front`` ones; -1 stands for nobody."""
    both_exist = (back >= 0) & (front >= 0)
    half_lengths_m = (drivers.length_m[back] + drivers.length_m[front]) / 2
    gap = np.where(both_exist, progress_m[front] - progress_m[back] - half_lengths_m, _NONE_M)
    closing = np.where(both_exist, speed_m_s[back] - speed_m_s[front], 0.0)
    return gap, drivers.idm_m_s2(back, speed_m_s[back], gap, closing)


def drive(
    drivers: DriverSet, beside: Int[np.ndarray, "2 lanes"], *, steps: int, signals: list[Signal] | None = None
) -> Trajectories:
    """Let vehicles drive.

    Args:
        drivers: The vehicles. Those of one lane must not overlap at the start.
        beside: The lanes to the left and to the right of each lane in its driving direction, or -1.
        steps: Number of moments, ``STEP_S`` apart, the first at the start.
        signals: Stop lines.
    """
    run = _Simulation(drivers, beside, signals or [])
    gap = np.full(len(drivers.lane), _NONE_M)
    np.minimum.at(gap, run.order.row, run.gaps(drivers.progress_m))
    speed = np.minimum(drivers.desired_m_s, np.maximum(gap - drivers.standstill_m, 0.0) / drivers.headway_s)
    path = np.empty((len(drivers.lane), steps))
    path[:, 0] = drivers.progress_m
    for step in range(1, steps):
        position_before = path[:, step - 1]
        change = run.accelerate(position_before, speed, step * STEP_S)
        if step % _CONSIDER_STEPS == 0 and (beside >= 0).any():
            run.consider_changes(position_before, speed, change, step)
        speed = np.maximum(speed + STEP_S * change, 0.0)
        position = position_before + STEP_S * speed
        if (run.gaps(position) < _LEAST_GAP_M).any():
            position = run.keep_apart(position)
            speed = (position - position_before) / STEP_S
        path[:, step] = position
        run.finish_changes(position, step)
    return Trajectories(path, run.changes)
