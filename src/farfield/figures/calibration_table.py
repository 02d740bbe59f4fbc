"""A calibration's JSON as a table: value, change, sigma and residual, and whether to keep what was there or replace it.

A change counts from two sigmas on. What the data do not tell is neither kept nor replaced for them: it keeps its start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, hypot, isfinite
from statistics import median
from typing import Any

from farfield.metrics.result import table
from farfield.vocabulary.counts import count_of

_SIGMAS = 2.0
_PICKED_PX, _BOARD_PX, _COVERED = 5.0, 1.0, 0.75
_HEAD = ["parameter", "value", "change", "sigma", "verdict"]


@dataclass(frozen=True, kw_only=True)
class CalibrationRow:
    """One unknown.

    Args:
        name: Its name, with the unit.
        value: What it is now; None where only the change says something.
        change: Against what was there; None where nothing was.
        sigma: Standard deviation; None where the data do not tell.
        observed: Whether the data tell it.
    """

    name: str
    value: float | None = None
    change: float | None = None
    sigma: float | None = None
    observed: bool = True

    @property
    def verdict(self) -> str:
        """``keep``, ``replace``, ``not told``, or nothing where there is nothing to compare with."""
        if not self.observed or self.sigma is None or not isfinite(self.sigma):
            return "not told"
        if self.change is None:
            return ""
        return "replace" if abs(self.change) > _SIGMAS * self.sigma else "keep"


def calibration_text(result: Mapping[str, Any]) -> str:
    """Table, residual, notes and verdict of the JSON of ``farfield calibrate``.

    Args:
        result: What the ``to_json`` of a calibration gives.
    """
    rows = calibration_rows(result)
    cells = [
        [row.name, _number(row.value), _number(row.change, signed=True), _number(row.sigma), row.verdict]
        for row in rows
    ]
    lines = [table(_HEAD, cells), "", f"residual: {_residual(result)}"]
    notes = dict.fromkeys([*result.get("notes", ()), *result.get("unobserved", ())])
    lines += [f"note: {note}" for note in notes]
    verdict, why = calibration_verdict(result, rows)
    return "\n".join([*lines, f"{verdict}: {why}"])


def calibration_rows(result: Mapping[str, Any]) -> list[CalibrationRow]:
    """The unknowns of a calibration's JSON, in its order."""
    notes = " ".join([*result.get("notes", ()), *result.get("unobserved", ())])
    if result["kind"] == "board":
        values = _board_values(result)
        return [CalibrationRow(name=n, value=float(v), sigma=result["sigma"].get(n)) for n, v in values.items()]
    if result["kind"] == "radar-lidar":
        return _radar_rows(result, notes)
    changes = result.get("change") or {}
    sigmas = result.get("sigma") or {name: entry["sigma"] for name, entry in result.get("parameters", {}).items()}
    return [
        CalibrationRow(
            name=_titled(name),
            change=changes.get(name),
            sigma=sigma,
            observed=not _is_unobserved(name.rpartition("_")[0] or name, notes),
        )
        for name, sigma in sigmas.items()
    ]


def calibration_verdict(result: Mapping[str, Any], rows: Sequence[CalibrationRow]) -> tuple[str, str]:
    """``keep`` or ``replace``, and why."""
    moved = [row.name for row in rows if row.verdict == "replace"]
    untold = [row.name for row in rows if row.verdict == "not told"]
    rest = f"; {', '.join(untold)}: not told by these data" if untold else ""
    if result["kind"] == "board":
        pixels = median(result["error_px"].values()) if result["error_px"] else float("inf")
        if pixels <= _BOARD_PX and result["covered"] >= _COVERED:
            return "replace", f"corners fit to {pixels:.2f} px and cover {result['covered']:.0%} of the picture"
        return "keep", (
            f"corners fit to {pixels:.2f} px (at most {_BOARD_PX:g} is good) and cover {result['covered']:.0%} of the "
            f"picture ({_COVERED:.0%} is enough): take more pictures"
        )
    if result.get("from") == "pairs":
        pixels = median(result["residual_px"])
        fits = pixels <= _PICKED_PX
        return ("replace" if fits else "keep"), f"picks fit to {pixels:.1f} px; {_PICKED_PX:g} px is good{rest}"
    if result["kind"] == "radar-lidar" and result["pose"]["frames"] != result["before"]["frames"]:
        moved.append("frame offset")
    if not any(row.change is not None for row in rows):
        return "replace", f"nothing was there to keep{rest}"
    before, after = (result.get(f"residual_{when}", {}).get("score") for when in ("before", "after"))
    if before is not None and after is not None and after < before:
        return "keep", f"edges fit worse than before (score {before:.3f}, now {after:.3f}): look at the picture"
    if moved:
        return "replace", f"{', '.join(moved)} moved by more than {_SIGMAS:g} sigma{rest}"
    return "keep", f"nothing moved by more than {_SIGMAS:g} sigma{rest}"


def _radar_rows(result: Mapping[str, Any], notes: str) -> list[CalibrationRow]:
    pose, before = result["pose"], result["before"]
    ours = {"x_cm": ("x_m", 100.0), "y_cm": ("y_m", 100.0), "yaw_deg": ("yaw_rad", degrees(1.0))}
    rows = []
    for name, entry in result["parameters"].items():
        field, factor = ours.get(name, ("", 1.0))
        change = factor * (pose[field] - before[field]) if field else None
        value = factor * pose[field] if field else entry["value"]
        observed = not _is_unobserved(name.rpartition("_")[0], notes)
        rows.append(
            CalibrationRow(name=_titled(name), value=value, change=change, sigma=entry["sigma"], observed=observed)
        )
    return rows


def _board_values(result: Mapping[str, Any]) -> dict[str, float]:
    matrix, lens = result["matrix"], dict(zip(("k1", "k2", "p1", "p2", "k3"), result["distortion"], strict=False))
    return {"fx": matrix[0][0], "fy": matrix[1][1], "cx": matrix[0][2], "cy": matrix[1][2], **lens}


def _is_unobserved(name: str, notes: str) -> bool:
    return any(f"{name} {words}" in notes for words in ("is not observed", "cannot be told apart"))


def _residual(result: Mapping[str, Any]) -> str:
    if result["kind"] == "board":
        pixels = list(result["error_px"].values())
        return (
            f"median {median(pixels):.2f} px over {count_of(len(pixels), 'picture')}, "
            f"{len(result['left_out'])} left out"
        )
    if result["kind"] == "lidar-lidar":
        return f"{result['rms_cm']:.1f} cm from the planes, {count_of(result['pairs'], 'point', spec=',')}"
    if result.get("from") == "pairs":
        pixels = result["residual_px"]
        return f"median {median(pixels):.1f} px, largest {max(pixels):.1f} px, of {len(pixels)} picks"
    if "residual_after" in result:
        before, after = result["residual_before"], result["residual_after"]
        return f"median {_pixels(before)} before, {_pixels(after)} now, {after['edges']:,} edges"
    return ", ".join(f"{_titled(name)} {value:.3g}" for name, value in result["residual"].items())


def _pixels(residual: Mapping[str, Any]) -> str:
    return "none" if residual["median_px"] is None else f"{residual['median_px']:.2f} px"


def _titled(name: str) -> str:
    stem, _, unit = name.rpartition("_")
    return f"{stem.replace('_', ' ')} ({unit})" if stem and unit in ("deg", "cm", "ms", "px") else name


def _number(value: float | None, *, signed: bool = False) -> str:
    if value is None or not isfinite(value):
        return "-"
    text = f"{value:.0f}" if hypot(value) >= 1000 else f"{value:.3g}"
    return f"+{text}" if signed and value > 0 else text
