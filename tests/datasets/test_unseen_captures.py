"""Velodyne's and Hesai's captures by a generator that has not seen the readers."""

import numpy as np
import pytest

from .generators.captures import CaptureTruth, write_hesai, write_vlp16
from .generators.truth import open_recognised

SENSORS = ("vlp16", "vlp16 dual", "pandar64", "xt32")


def written(sensor, root):
    if sensor.startswith("vlp16"):
        return write_vlp16(root / "drive.pcap", dual="dual" in sensor)
    return write_hesai(root / "drive.pcap", model=sensor)


def turned(angle_rad):
    return np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi


def check_sweep(frame, truth: CaptureTruth):
    """Every point is one of the returns, where it was measured, with its ring, strength and time."""
    cloud = frame.cloud()
    points = cloud.points_m.astype(np.float64)
    ranges = np.linalg.norm(points, axis=1)
    assert {"ring"} <= set(cloud.columns)
    assert cloud.intensity is not None
    offsets = cloud.offsets_s()
    assert offsets is not None
    near = np.array(sorted(truth.returns)) * truth.unit_m
    matched = []
    for row, range_m in enumerate(ranges):
        candidates = [
            truth.returns[round(value / truth.unit_m)]
            for value in near[
                np.searchsorted(near, range_m - truth.distance_m) : np.searchsorted(near, range_m + truth.distance_m)
            ]
        ]
        azimuth = -np.arctan2(points[row, 1], points[row, 0])  # clockwise, from ahead
        elevation = np.arcsin(points[row, 2] / range_m)
        good = [
            entry
            for entry in candidates
            if abs(turned(azimuth - entry.azimuth_rad)) < np.radians(truth.azimuth_deg)
            and abs(elevation - entry.elevation_rad) < 0.012 / range_m + 1e-5 + 0.001 * (truth.distance_m > 0.05)
            and round(float(cloud.intensity[row]) * 255) == entry.strength
        ]
        assert len(good) == 1, f"point {row} at {range_m:.3f} m, {np.degrees(azimuth):.2f} deg: {candidates[:2]}"
        time_us = frame.time_ns / 1000 + offsets[row] * 1e6
        assert abs(time_us - good[0].time_us) < truth.time_us, f"{time_us - good[0].time_us} us off"
        matched.append(good[0])
    return matched


@pytest.mark.parametrize("sensor", SENSORS)
def test_sweeps_hold_every_return_where_it_was(sensor, tmp_path):
    truth = written(sensor, tmp_path)
    data = open_recognised(tmp_path)
    assert truth.turns - 1 <= len(data) <= truth.turns + 1
    matched = [entry for frame in data for entry in check_sweep(frame, truth)]
    numbers = [entry.number for entry in matched]
    assert len(set(numbers)) == len(numbers)
    assert len(numbers) >= len(truth.returns) * (truth.turns - 1.2) / (truth.turns + 0.2)
    (drive,) = data.drives()
    assert np.allclose(np.diff(drive.times_ns)[1:], 1e8, atol=2e6)  # a turn may begin anywhere


@pytest.mark.parametrize("sensor", SENSORS)
def test_rings_are_the_beams(sensor, tmp_path):
    truth = written(sensor, tmp_path)
    frame = open_recognised(tmp_path)[0]
    ring = np.asarray(frame.cloud().extra["ring"])
    entries = check_sweep(frame, truth)
    pairs = {(int(own), entry.ring) for own, entry in zip(ring, entries, strict=True)}
    assert len(pairs) == len({own for own, _ in pairs}) == len({beam for _, beam in pairs})
