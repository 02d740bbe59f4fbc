"""What a detector states of itself, and which frames it refuses."""

import platform
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield.detectors.runtime import Detector
from farfield.errors import ConfigError
from farfield.frame import Cloud, Frame


def learnt(clouds, **options):
    return {"experiment": {"data": {"clouds": clouds, "options": options}}}


def detector(name="pointpillars", provenance=None, **changes) -> Detector:
    return Detector(small_detector(name, **changes), provenance=provenance, precision="fp32", device="cpu")


def cloud(rng, **extra) -> Cloud:
    points = rng.uniform([0, -15, -3], [60, 15, 1], (300, 3)).astype(np.float32)
    return Cloud(points, np.full(300, 0.5, np.float32), {k: np.full(300, v, np.float32) for k, v in extra.items()})


def frame(clouds, reference="lidar", kinds=None) -> Frame:
    """A frame of these clouds; with ``kinds`` their sensors are known."""
    made = replace(Frame(sequence="s", frame_id="0"), clouds=clouds, reference=reference)
    if kinds is not None:
        object.__setattr__(made, "sensors", {k: SimpleNamespace(kind=v, in_frame=True) for k, v in kinds.items()})
    return made


def test_a_detector_states_what_it_reads():
    lidar = detector(use_intensity=True, use_lag=True, provenance=learnt(["os2-64"], reference="radar"))
    assert (lidar.kind, lidar.reference, lidar.reach_m) == ("lidar", "radar", 64.0)
    assert lidar.columns == ("x_m", "y_m", "z_m", "intensity", "lag_s")
    radar = detector("rtnh", use_doppler=True)
    assert (radar.kind, radar.reference) == ("radar", None)
    assert radar.columns == ("x_m", "y_m", "z_m", "power", "doppler_m_s")
    assert detector(provenance=learnt(["radar_3frames"])).kind == "radar"
    assert detector(provenance=learnt(["os2-64"])).reference == "os2-64"
    assert detector(provenance=learnt(["gaussian"])).reference is None


def test_frames_in_other_coordinates_than_learnt_are_refused(rng):
    clouds = {"os2-64": cloud(rng), "radar": cloud(rng, power=0.5)}
    radar, lidar = detector("rtnh", learnt(["radar"], reference="radar")), detector(provenance=learnt(["os2-64"]))
    with pytest.raises(ConfigError, match=r"farfield\.detect\(detector, data\)"):
        radar(frame(clouds, "os2-64"))
    with pytest.raises(ConfigError, match="learnt in those of os2-64"):
        lidar(frame(clouds, "radar"))
    assert len(radar(frame(clouds, "radar"))) >= 0
    assert len(lidar(frame(clouds, "os2-64"))) >= 0
    assert len(lidar(frame({"lidar": cloud(rng)}, "ego"))) >= 0  # data of another kind: nothing to compare


def test_a_cloud_of_another_kind_of_sensor_is_refused_and_never_chosen(rng):
    clouds = {"radar": cloud(rng, power=0.5), "lidar": cloud(rng, power=0.5)}
    mixed = frame(clouds, kinds={"radar": "radar", "lidar": "lidar"})
    lidar, radar = detector(), detector("rtnh")
    with pytest.raises(ConfigError, match=r"it is of a radar.*What fits here: lidar"):
        lidar.with_cloud("radar")(mixed)
    with pytest.raises(ConfigError, match=r"it is of a lidar.*What fits here: radar"):
        radar.with_cloud("lidar")(mixed)
    np.testing.assert_array_equal(lidar(mixed).score, lidar(clouds["lidar"]).score)
    with pytest.raises(ConfigError, match="expected a cloud of a lidar"):
        lidar(frame({"radar": clouds["radar"]}, kinds={"radar": "radar"}))


def test_a_cloud_without_the_columns_is_refused_and_never_chosen(rng):
    moving = detector("rtnh", use_doppler=True)
    with pytest.raises(ConfigError, match="'doppler_m_s'"):
        moving.with_cloud("radar")(frame({"radar": cloud(rng, power=0.5)}))
    both = {"still": cloud(rng, power=0.5), "moving": cloud(rng, power=0.5, doppler_m_s=1.0)}
    np.testing.assert_array_equal(moving(frame(both)).score, moving(both["moving"]).score)
    with pytest.raises(ConfigError, match="its clouds are: none"):
        moving(frame({}))
    with pytest.raises(ConfigError, match="named 'absent'"):
        moving.with_cloud("absent")(frame(both))


HOLES = """
import numpy as np
from farfield.detectors.runtime import give_back_freed_memory, keep_freed_memory
def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 // 10**6
assert keep_freed_memory()
blocks = [np.ones(200_000, np.uint8) for _ in range(1500)]  # 300 MB
blocks = blocks[::10]  # nine of ten are freed, none at the end
before = resident_mb()
give_back_freed_memory()
print(before - resident_mb(), sum(map(len, blocks)))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other allocators give back by themselves")
def test_holes_between_blocks_in_use_are_given_back():
    ran = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True, check=True)
    assert int(ran.stdout.split()[0]) > 200, ran.stdout
