"""Raw outputs before suppression, boxes after it, and the copies in between: the GPU's beside the CPU's."""

import json
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from _gpu_common import (
    FAILED,
    LIDAR,
    OK,
    PRECISIONS,
    RADAR,
    STAYS,
    Row,
    Site,
    batch_of,
    busy_cloud,
    cloud_for,
    detector_of,
    each,
    exact_float32,
    network_of,
    stirred,
)

from farfield.detectors.runtime import Detector

BOUNDS = {"fp32": 1e-4, "bf16": 0.05, "fp16": 0.01}
"""Of the largest number of an output: the largest error in float32, in half precision that of 99.9 % of the numbers."""
COMMON = {"fp32": 0.999, "bf16": 0.9, "fp16": 0.9}
"""Share of the places of an output that both devices have to have: votes decide on cells, and rounding on votes."""
SMALL_COPY = 1024  # bytes: counts and flags that decide on the sizes of what follows
SAME_BOX = {"pointrcnn": 1e-4}  # metres, radians; PointRCNN's boxes are of float32, which has 1.5e-5 m at 250 m
SAME_BOX_FLOAT64 = 1e-9


def raw(site: Site) -> Iterator[Row]:
    """Raw outputs of every detector."""
    exact_float32()
    if not site.gpu:
        yield site.needs_gpu(
            "raw outputs in fp32 on both devices", "and fp16; below: bf16 against fp32, both on the CPU"
        )
    yield from each([*LIDAR, *RADAR], partial(_raw, site))


def _raw(site: Site, name: str) -> Iterator[Row]:
    network = network_of(name)
    network = stirred(network) if name in RADAR else network
    cloud = cloud_for(site, name)
    expected = _outputs(detector_of(network, torch.device("cpu"), "fp32"), cloud)
    for precision in PRECISIONS if site.gpu else ("bf16",):  # a CPU takes minutes in float16
        got = _outputs(detector_of(network, site.device, precision), cloud)
        error, common = _differences(got, expected, precision)
        row = site.bounded(f"{name}, {precision}", error, BOUNDS[precision])
        enough = common >= COMMON[precision]
        figure = row.figure + ("" if common == 1 else f", {100 * common:.2f} % of places in both")
        verdict = row.verdict if enough else FAILED
        yield Row(row.what, figure, verdict, {**row.numbers, "common": common})


@torch.no_grad()
def _outputs(detector: Detector, cloud: Any) -> dict[str, tuple[Any, Any]]:
    """Numbers of each output, with the numbers of their places where these depend on the values; on the CPU."""
    outputs = detector.network(batch_of(detector, cloud))
    fields = zip(type(outputs).__annotations__, outputs, strict=True)
    named = {name: value for name, value in fields if torch.is_tensor(value)}
    if "vote_keys" in named:  # the sparse detector: cells before and after the diffusion
        pairs = {"logits": "keys", "codes": "keys", "votes": "vote_keys"}
    elif "proposals" in named:  # PointRCNN's first stage: the second one sees a choice of its boxes
        pairs = dict.fromkeys(("logits", "codes"), "rows")
    else:
        pairs = dict.fromkeys(named)
    return {name: (None if at is None else named[at].cpu(), named[name].double().cpu()) for name, at in pairs.items()}


def _differences(got: Any, expected: Any, precision: str) -> tuple[float, float]:
    """Largest error over all outputs, and the least share of places that both have."""
    error, common = 0.0, 1.0
    for name, (places, values) in expected.items():
        other_places, other = got[name]
        if places is not None:
            mine, theirs = _shared(places, other_places)
            common = min(common, len(mine) / max(len(places), len(other_places), 1))
            values, other = values[mine], other[theirs]
        if values.shape != other.shape:
            raise ValueError(f"{name}: expected shape {tuple(values.shape)}, got {tuple(other.shape)}")
        gaps = ((other - values).abs() / values.abs().max()).flatten()
        if not torch.isfinite(gaps).all():
            return float("nan"), common
        rank = len(gaps) - 1 if precision == "fp32" else int(0.999 * (len(gaps) - 1))
        error = max(error, float(gaps.kthvalue(rank + 1).values))
    return error, common


def _shared(one: Any, other: Any) -> tuple[Any, Any]:
    """Rows of equal numbers in two lists without repetitions."""
    mine, theirs = torch.sort(one), torch.sort(other)
    at = torch.searchsorted(theirs.values, mine.values).clamp(max=max(len(other) - 1, 0))
    same = theirs.values[at] == mine.values
    return mine.indices[same], theirs.indices[at[same]]


def boxes(site: Site) -> Iterator[Row]:
    """Boxes decoded and suppressed on the device, beside those of the CPU from the same maps."""
    if not site.gpu:
        yield site.needs_gpu("boxes of maps on a GPU", "below: the same code on the CPU")
    yield from each([*STAYS, "voxelnet"], partial(_boxes, site))


@torch.no_grad()
def _boxes(site: Site, name: str) -> Iterator[Row]:
    from farfield.detectors.anchors.head import boxes_on_device

    cloud = busy_cloud(site)
    for precision in PRECISIONS if site.gpu else ("fp32",):
        detector = detector_of(network_of(name), site.device, precision)
        maps = detector.network(batch_of(detector, cloud))
        head = detector.network.head
        if name == "pointrcnn":
            (got,) = detector.network.decode(maps)
        elif hasattr(head, "boxes_on_device"):
            (got,) = head.boxes_on_device(*head.peak_boxes(maps), maps.frames)
        else:
            (got,) = boxes_on_device(maps, head.anchors, head.config)
        host = type(maps)(*[value.cpu() if torch.is_tensor(value) else value for value in maps])
        (expected,) = detector.network.decode(host)
        yield _compared(f"{name}, {precision}", got, expected, SAME_BOX.get(name, SAME_BOX_FLOAT64))


def _compared(what: str, got: Any, expected: Any, bound: float = SAME_BOX_FLOAT64) -> Row:
    """Whether two sets of boxes are one, in whatever order equal scores stand."""
    numbers = {"boxes": len(expected), "got": len(got)}
    if len(got) != len(expected) or not len(got):
        return Row(what, f"{len(got)} boxes, expected {len(expected)}", FAILED, numbers)
    one, other = (torch.from_numpy(_rows(boxes)) for boxes in (got, expected))
    gap = torch.cdist(one, other, p=torch.inf)
    error = float(torch.maximum(gap.min(0).values.max(), gap.min(1).values.max()))
    words = f"{len(got)} boxes, largest difference {error:.0e}, at most {bound:.0e}"
    return Row(what, words, OK if error <= bound else FAILED, {**numbers, "error": error})


def _rows(boxes: Any) -> Any:
    turn = np.column_stack([np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)])
    return np.column_stack([boxes.centre_m, boxes.size_m, turn, boxes.score])


def copies(site: Site) -> Iterator[Row]:
    """What the profiler counts between host and GPU, from points to boxes."""
    if not site.gpu:
        yield site.needs_gpu("copies between host and GPU, from points to boxes")
        return
    yield from each(list(STAYS), partial(_copies, site))


def _copies(site: Site, name: str) -> Iterator[Row]:
    detector, cloud = detector_of(network_of(name), site.device, "auto"), busy_cloud(site)
    for _ in range(3):
        detector(cloud)
    with copies_of() as seen:
        found = detector(cloud)
    back = [size for kind, size in seen if "DtoH" in kind]
    there = [size for kind, size in seen if "HtoD" in kind]
    large = [size for size in back if size > SMALL_COPY]
    allowed = 9 * 8 * max(len(found), 1)  # a box is nine float64
    words = f"to the GPU {len(there)} copies, {sum(there) / 1e3:.1f} kB; back {len(back)}, {sum(back) / 1e3:.1f} kB, "
    words += f"{len(large)} of them above 1 kB"
    good = bool(seen) and len(large) <= 1 and sum(large) <= allowed
    yield Row(name, words, OK if good else FAILED, {"to_gpu": there, "back": back, "boxes": len(found)})


@contextmanager
def copies_of() -> Iterator[list[tuple[str, int]]]:
    """The copies that the profiler saw inside the block: words and bytes of each."""
    from torch.profiler import ProfilerActivity, profile

    seen: list[tuple[str, int]] = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Warning: Profiler clears events", UserWarning)
        with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiler:
            yield seen
            torch.cuda.synchronize()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.json"
        profiler.export_chrome_trace(str(path))
        events = json.loads(path.read_text("utf-8"))["traceEvents"]
    seen += [(event["name"], int(event["args"]["bytes"])) for event in events if event.get("cat") == "gpu_memcpy"]
