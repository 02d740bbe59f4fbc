"""A calibration as a table: what moved by more than two sigmas is replaced, the rest is kept."""

from typing import Any

import pytest

from farfield.figures.calibration_table import calibration_rows, calibration_text, calibration_verdict

RADAR: dict[str, Any] = {
    "kind": "radar-lidar",
    "pose": {"x_m": -2.60, "y_m": 0.31, "yaw_rad": 0.0, "frames": 0},
    "before": {"x_m": -2.54, "y_m": 0.30, "yaw_rad": 0.0, "frames": 0},
    "parameters": {
        "x_cm": {"value": -260.0, "sigma": 1.0},
        "y_cm": {"value": 31.0, "sigma": 2.0},
        "yaw_deg": {"value": 0.0, "sigma": 0.05},
        "time offset_ms": {"value": 3.0, "sigma": 1.0},
    },
    "unobserved": ["yaw is not observed"],
    "notes": [],
    "residual": {"range_cm": 12.0, "azimuth_deg": 0.3},
}
BOARD: dict[str, Any] = {
    "kind": "board",
    "matrix": [[900.0, 0, 640], [0, 901.0, 360], [0, 0, 1]],
    "distortion": [-0.1, 0.01, 0.0, 0.0, 0.0],
    "sigma": dict.fromkeys(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), 0.5),
    "error_px": {"a.png": 0.2, "b.png": 0.4},
    "left_out": {},
    "covered": 0.9,
    "notes": [],
}
PAIRS: dict[str, Any] = {
    "kind": "lidar-camera",
    "from": "pairs",
    "parameters": {"roll_deg": {"value": 0.1, "sigma": 0.2}},
    "residual_px": [1.0, 2.0, 3.0],
    "notes": ["add a point far left in the picture"],
}
LIDARS: dict[str, Any] = {
    "kind": "lidar-lidar",
    "rms_cm": 2.0,
    "pairs": 12_000,
    "change": {"yaw_deg": 0.01, "x_cm": 0.1},
    "parameters": {"yaw_deg": {"value": 0.0, "sigma": 0.1}, "x_cm": {"value": 0.0, "sigma": 0.2}},
    "notes": [],
}


def test_verdicts_of_parameters() -> None:
    verdicts = {row.name: row.verdict for row in calibration_rows(RADAR)}
    assert verdicts == {"x (cm)": "replace", "y (cm)": "keep", "yaw (deg)": "not told", "time offset (ms)": ""}
    text = calibration_text(RADAR)
    assert "replace: x (cm) moved by more than 2 sigma; yaw (deg): not told by these data" in text
    assert "note: yaw is not observed" in text


@pytest.mark.parametrize(
    ("result", "verdict"),
    [
        (RADAR, "replace"),
        ({**RADAR, "pose": {**RADAR["before"]}}, "keep"),
        ({**RADAR, "pose": {**RADAR["before"], "frames": 1}}, "replace"),
        (BOARD, "replace"),
        ({**BOARD, "covered": 0.3}, "keep"),
        ({**BOARD, "error_px": {"a.png": 3.0}}, "keep"),
        (PAIRS, "replace"),
        ({**PAIRS, "residual_px": [20.0, 30.0]}, "keep"),
        (LIDARS, "keep"),
        ({**LIDARS, "change": {"yaw_deg": 1.0, "x_cm": 0.1}}, "replace"),
        ({name: value for name, value in LIDARS.items() if name != "change"}, "replace"),
    ],
)
def test_every_kind_has_a_table_and_a_verdict(result: dict[str, Any], verdict: str) -> None:
    assert calibration_verdict(result, calibration_rows(result))[0] == verdict
    text = calibration_text(result)
    assert "parameter" in text
    assert "residual: " in text
    assert f"\n{verdict}: " in text


def test_edges_that_fit_worse_are_kept() -> None:
    residual = {"median_px": 1.0, "edges": 100, "score": 0.5}
    result = {
        "kind": "lidar-camera",
        "change": {"yaw_deg": 3.0},
        "sigma": {"yaw_deg": 0.1},
        "residual_before": residual,
        "residual_after": {**residual, "score": 0.4},
        "notes": [],
    }
    assert "keep: edges fit worse than before" in calibration_text(result)
    assert "replace" in calibration_text({**result, "residual_after": {**residual, "score": 0.6}})
