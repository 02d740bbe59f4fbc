"""Peak memory of the radar detectors beside the paper's, and what is said where memory is not enough."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial

import torch
from _gpu_common import (
    FAILED,
    MEASURED,
    OK,
    RADAR,
    Row,
    Site,
    busy_cloud,
    detector_of,
    each,
    network_of,
    peak_mb,
    radar_cloud,
)
from _report import ROOT

from farfield.detectors.devices import OutOfMemory, fitting
from farfield.vocabulary.published_tables import KRADAR_TABLES

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
    script = str(ROOT / "benchmarks" / "radar_detector_speed.py")
    command = [sys.executable, script, "--peak", RADAR[name], "--precision", precision, "--threads", "1"]
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
