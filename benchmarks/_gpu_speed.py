"""Milliseconds and memory from points to boxes, with a loader too, and as the range grows; the radar's peaks."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _gpu_common import (
    ABSENT,
    FAILED,
    LIDAR,
    MEASURED,
    OK,
    PRECISIONS,
    RADAR,
    Row,
    Site,
    busy_cloud,
    cloud_for,
    detector_of,
    each,
    milliseconds,
    network_of,
    peak_mb,
    radar_cloud,
    wait,
)
from _report import ROOT
from torch import Tensor
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from farfield.detectors import DETECTORS, build_detector
from farfield.detectors.devices import OutOfMemory, fitting
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.runtime import Detector, record_trunk
from farfield.vocabulary.published_tables import KRADAR_TABLES

# Milliseconds and memory from points to boxes, as one call or with a loader, and as the range grows.


AIMS_MS = {"pointpillars": 4.0, "second": 10.0, "sparsecentre": 6.0}  # at 250 m x 100 m in half precision on an H100
DENSE = ("pointpillars", "second", "voxelnet")  # a trunk of one shape whatever the points: what graphs need
RANGES_M = (50, 100, 150, 200, 250)
RANGE_POINTS = 30_000
LOADED_FRAMES = 64


def speed(site: Site) -> Iterator[Row]:
    """Every detector in every precision, as it is; then dense trunks as CUDA graphs."""
    if not site.gpu:
        yield site.needs_gpu("fp16 and CUDA graphs", "below: two frames in fp32 and bf16 on the CPU")
    yield from each([*LIDAR, *RADAR], partial(_eager, site))
    if site.gpu:
        yield from each(list(DENSE), partial(_changed, site, "CUDA graph", record_trunk))


def compiled(site: Site) -> Iterator[Row]:
    """Dense trunks by torch.compile, each of which takes half a minute to compile."""
    if not site.gpu:
        yield site.needs_gpu("torch.compile", "")
        return
    yield from each(list(DENSE), partial(_changed, site, "torch.compile", _compiled))


def _eager(site: Site, name: str) -> Iterator[Row]:
    network, cloud = network_of(name), cloud_for(site, name)
    for precision in PRECISIONS if site.gpu else PRECISIONS[:2]:
        with peak_mb(site.device) as peak:
            detector = detector_of(network, site.device, precision)
            taken = milliseconds(partial(detector, cloud), site.device, **_rounds(site))
        yield _timed(f"{name}, {precision}", taken, peak, name, precision, len(cloud))


def _changed(site: Site, words: str, change: Callable[[Detector, Any], None], name: str) -> Iterator[Row]:
    cloud = busy_cloud(site)
    for precision in PRECISIONS[1:]:
        detector = detector_of(network_of(name), site.device, precision)
        expected = len(detector(cloud))
        change(detector, cloud)
        with peak_mb(site.device) as peak:
            taken = milliseconds(partial(detector, cloud), site.device, **_rounds(site))
        row = _timed(f"{name}, {precision}, {words}", taken, peak, name, precision, len(cloud))
        found = len(detector(cloud))
        yield Row(row.what, f"{row.figure}; {found} boxes, eager {expected}", row.verdict, row.numbers)


def _compiled(detector: Detector, cloud: Any) -> None:
    del cloud
    detector.network.backbone = torch.compile(detector.network.backbone, dynamic=False)


def _rounds(site: Site) -> dict[str, int]:
    return {"frames": 30, "warm": 5} if site.gpu else {"frames": 2, "warm": 1}


def _timed(what: str, taken: np.ndarray, peak: dict[str, float], name: str, precision: str, points: int) -> Row:
    median = float(np.median(taken))
    words = f"{median:.1f} ms (fastest {taken.min():.1f})"
    words += f", peak {peak['mb']:.0f} MB" if "mb" in peak else ""
    aim = AIMS_MS.get(name) if "mb" in peak and precision != "fp32" else None
    words += "" if aim is None else f"; aim {aim:g} ms: {'met' if median <= aim else 'missed'}"
    numbers = {"ms": median, "fastest_ms": float(taken.min()), "points": points, "aim_ms": aim, **peak}
    return Row(what, words, MEASURED, numbers)


class Clouds(TorchDataset):
    """Clouds in files, as a network takes them.

    Args:
        paths: One file a frame.
        columns: Columns of the tensor.
    """

    def __init__(self, paths: list[Path], columns: tuple[str, ...]) -> None:
        self.paths, self.columns = paths, columns

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Tensor:
        """The cloud of a frame."""
        from farfield.frame import Cloud

        rows = np.load(self.paths[index], allow_pickle=False)
        return cloud_tensor(Cloud(rows[:, :3], rows[:, 3], {"lag_s": rows[:, 4]}), self.columns)


def loader(site: Site) -> Iterator[Row]:
    """Frames a second from files to boxes, workers reading and pinning beside the network."""
    if not site.gpu:
        yield site.needs_gpu("frames a second with pinned memory", "below: on the CPU, one worker")
    names = ["pointpillars", "second", "sparsecentre"] if site.gpu else ["pointpillars"]
    yield from each(names, partial(_loaded, site))


def _loaded(site: Site, name: str) -> Iterator[Row]:
    frames = LOADED_FRAMES * 4 if site.gpu else 6
    detector = detector_of(network_of(name), site.device, "auto")
    columns = detector.network.inputs["points"].columns
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.npy"
        cloud = busy_cloud(site)
        np.save(path, np.column_stack([cloud.points_m, cloud.intensity, cloud.column("lag_s")]).astype(np.float32))
        for workers, batch in ((0, 1), (4, 1), (8, 4)) if site.gpu else ((1, 1),):
            data = DataLoader(
                Clouds([path] * frames, columns),
                batch_size=batch,
                num_workers=workers,
                collate_fn=list,
                pin_memory=site.gpu,
            )
            taken = milliseconds(partial(_go_through, detector, data), site.device, frames=1, warm=1 if site.gpu else 0)
            rate = frames / (float(taken[0]) / 1e3)
            words = f"{rate:.1f} frames a second, {workers} workers, {batch} a batch, {detector.precision}"
            yield Row(name, words, MEASURED, {"frames_a_second": rate, "workers": workers, "batch": batch})


def _go_through(detector: Detector, data: DataLoader) -> None:
    for clouds in data:
        there = [cloud.to(detector.device, non_blocking=True) for cloud in clouds]
        detector.network.predict(Inputs({"points": there}))
    wait(detector.device)


def ranges(site: Site) -> Iterator[Row]:
    """Time and memory of windows of 50 to 250 m with the same number of points."""
    if not site.gpu:
        yield site.needs_gpu("cost by range on the GPU", "below: on the CPU, bf16, two frames each")
    yield from each(["pointpillars", "second", "sparsecentre", *["voxelnet"] * site.gpu], partial(_ranges, site))


def _ranges(site: Site, name: str) -> Iterator[Row]:
    config = DETECTORS[name].config_class.model_validate({"name": name, "score_threshold": 0.3})
    found: dict[int, tuple[float, float | None]] = {}
    for range_m in RANGES_M if site.gpu else (RANGES_M[0], RANGES_M[-1]):
        grid = config.grid.model_copy(update={"range_m": float(range_m)})
        network = build_detector(config.model_copy(update={"grid": grid}), seed=0)
        cloud = busy_cloud(site, RANGE_POINTS, float(range_m))
        with peak_mb(site.device) as peak:
            detector = detector_of(network, site.device, "bf16")
            taken = milliseconds(partial(detector, cloud), site.device, **_rounds(site))
        found[range_m] = float(np.median(taken)), peak.get("mb")
    words = ", ".join(f"{r} m {ms:.1f} ms" + ("" if mb is None else f" {mb:.0f} MB") for r, (ms, mb) in found.items())
    growth = found[RANGES_M[-1]][0] / found[RANGES_M[0]][0]
    yield Row(f"{name}, bf16", f"{words}: {growth:.1f} x", MEASURED, {"by_range_m": found, "growth": growth})


def backbone(site: Site) -> Iterator[Row]:
    """SECOND's sparse backbone, and spconv's in turns with it where that is at hand."""
    from sparse_convolution import CASES

    theirs = _spconv(site)
    if theirs is None:
        yield Row("spconv", "not importable here, or no GPU: pip install spconv-cu126 beside torch", ABSENT)
    cases = [f"{count:,} voxels" for count in (CASES if site.gpu else [20_000])]
    for dtype in ("float32", "float16", "bfloat16") if site.gpu else ("float32",):
        yield from each(cases, partial(_backbone, site, theirs, dtype))


def _spconv(site: Site) -> Callable[..., Any] | None:
    """Makes spconv's backbone on the GPU; None where it cannot."""
    if not site.gpu:
        return None
    try:
        import spconv.pytorch  # noqa: F401
        from _gpu_spconv import spconv_backbone
    except Exception:
        return None
    return spconv_backbone


def _backbone(site: Site, theirs: Callable[..., Any] | None, dtype: str, size: str) -> Iterator[Row]:
    from sparse_convolution import CASES, case, ours

    count = int(size.split()[0].replace(",", ""))
    keys = torch.from_numpy(case(count, CASES[count])).to(site.device)
    features = torch.randn(count, 4, generator=torch.Generator().manual_seed(0)).to(site.device)
    run = ours(False, dtype)
    run.network.to(site.device)  # type: ignore[attr-defined]
    with torch.no_grad():
        mine = milliseconds(partial(run, features, keys), site.device, **_rounds(site))
        what, numbers = f"{size}, {dtype}", {"ms": float(np.median(mine))}
        yield Row(
            f"ours, {what}", f"{np.median(mine):.2f} ms (fastest {mine.min():.2f}), rulebooks anew", MEASURED, numbers
        )
        if theirs is None:
            return
        if dtype == "bfloat16":
            yield Row(f"spconv, {what}", "spconv 2.3 has no bfloat16", ABSENT)
            return
        other = theirs(dtype, site.device)
        taken = milliseconds(partial(other, features, keys), site.device, **_rounds(site))
        out, places = run(features, keys)
        values, their_places = other(features, keys)
    order, their_order = places.argsort(), their_places.argsort()
    gap = float("nan")
    if torch.equal(places[order], their_places[their_order]):
        gap = float((out[order].double() - values[their_order].double()).abs().max() / out.abs().max())
    share = np.median(mine) / np.median(taken)
    words = f"{np.median(taken):.2f} ms; ours takes {share:.2f} of it; outputs differ by {gap:.0e}"
    yield Row(f"spconv, {what}", words, MEASURED, {"ms": float(np.median(taken)), "gap": gap, "ours_share": share})


# Peak memory of the radar detectors beside the paper's, and what is said where memory is not enough.


_ROWS = {"RTN-50": "rtn_resnet50", "RTN-X101": "rtn_resnext101"}
_STATED_MB = {"RTNH": 421.0}  # not in Table 9: stated in the paper's text as it is cited; not checked against it
_LITTLE_BYTES = 32e6  # beside what the network itself holds


def radar(site: Site) -> Iterator[Row]:
    """Peak memory of one frame."""
    if not site.gpu:
        yield site.needs_gpu("peak memory of the GPU", "below: of a process on the CPU")
    yield from each(list(RADAR), partial(_radar, site))


def paper_mb(name: str) -> float:
    """Memory that K-Radar's paper states, MB: Table 9 for RTN."""
    if name in _STATED_MB:
        return _STATED_MB[name]
    return float(KRADAR_TABLES["9"].figures[_ROWS[name]]["overall"]["memory_mb"])


def _radar(site: Site, name: str) -> Iterator[Row]:
    paper = paper_mb(name)
    for precision in ("fp32", "bf16") if site.gpu else ("fp32",):
        if site.gpu:
            with peak_mb(site.device) as peak:
                detector, cloud = detector_of(network_of(name), site.device, precision), radar_cloud(name)
                for _ in range(3):
                    detector(cloud)
            mb, words = peak["mb"], "with its weights"
        else:
            mb, words = _process_mb(name, precision), "above what the process held before"
        yield Row(
            f"{name}, {precision}",
            f"{mb:.0f} MB {words}; the paper {paper:.0f} MB",
            MEASURED,
            {"mb": mb, "paper_mb": paper, "gpu": site.gpu},
        )


def _process_mb(name: str, precision: str) -> float:
    """Peak memory of a process that detects, less what it held before it had a network."""
    script = str(ROOT / "benchmarks" / "detector_speed.py")
    command = [sys.executable, script, "radar", "--child", "--peak", RADAR[name], "--precision", precision]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    peak = json.loads(done.stdout.splitlines()[-1])
    return float(peak["peak_mb"] - peak["before_mb"])


def full(site: Site) -> Iterator[Row]:
    """What a user reads where memory is not enough."""
    if site.gpu:
        detector, cloud = detector_of(network_of("second"), site.device, "fp32"), busy_cloud(site)
        torch.cuda.empty_cache()
        allowed = torch.cuda.memory_reserved() + _LITTLE_BYTES
        torch.cuda.set_per_process_memory_fraction(allowed / torch.cuda.get_device_properties(0).total_memory)
        try:
            yield _said(lambda: detector(cloud))
        finally:
            torch.cuda.set_per_process_memory_fraction(1.0)
        yield Row("the next frame with enough memory", f"{len(detector(cloud))} boxes", OK)
        return
    yield site.needs_gpu("a GPU that is full", "below: the machine's own memory")
    yield _said(_too_much)


def _too_much() -> None:
    with fitting("Take less."):
        torch.empty(2**60, dtype=torch.uint8)


def _said(run: Callable[[], object]) -> Row:
    what = "too much for the memory"
    try:
        run()
    except OutOfMemory as error:
        return Row(what, f"says: {str(error)[:110]}...", OK, {"said": str(error)})
    except RuntimeError as error:
        return Row(what, f"PyTorch's own error: {str(error)[:90]}", FAILED)
    return Row(what, "it was enough: nothing was shown", FAILED)
