"""What the parts of gpu_check.py share: rows of the table, detectors, clouds, clocks and peaks of memory."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from farfield.detectors import build_detector
from farfield.detectors.inputs import Inputs, cloud_tensor
from farfield.detectors.runtime import Detector
from farfield.experiments.catalogue import find
from farfield.experiments.schema import load_experiment
from farfield.frame import Cloud

OK, FAILED, MEASURED = "ok", "FAILED", "measured"
NEEDS_GPU, ABSENT = "needs a GPU", "not at hand"
PRECISIONS = ("fp32", "bf16", "fp16")
POINTS, REACH_M = 60_000, 250.0
LIDAR = ("pointpillars", "second", "voxelnet", "pointrcnn", "sparsecentre")
STAYS = ("pointpillars", "second", "sparsecentre", "pointrcnn")  # points stay on the device, up to suppression
RADAR = {"RTN-50": "rtn50-kradar", "RTN-X101": "rtnx101-kradar", "RTNH": "rtnh-kradar"}
_RADAR_SHARE = {"RTNH": 0.1}  # of the region's cells; RTN reads the whole cube
_BACKGROUND_LOGIT = 4.0


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Args:
        what: What was looked at.
        figure: What was found, in words.
        verdict: "ok", "FAILED", "measured", "needs a GPU" or "not at hand".
        numbers: The same for programs.
    """

    what: str
    figure: str
    verdict: str
    numbers: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(asdict(self))


@dataclass(frozen=True)
class Site:
    """Where the check runs.

    Args:
        device: The device under test; the CPU where there is no GPU.
        archive: A cloud made beforehand, for machines without the simulator.
    """

    device: torch.device
    archive: Path

    @property
    def gpu(self) -> bool:
        """Whether there is a GPU to test."""
        return self.device.type == "cuda"

    def needs_gpu(self, what: str, why: str = "") -> Row:
        """The row of something that a CPU cannot show."""
        return Row(what, why, NEEDS_GPU)

    def bounded(self, what: str, value: float, bound: float, words: str = "error") -> Row:
        """The row of a figure that must not exceed a bound; one that is not a number fails."""
        numbers = {"value": value, "bound": bound}
        return Row(what, f"{words} {value:.1e}, at most {bound:.0e}", OK if value <= bound else FAILED, numbers)


def exact_float32() -> None:
    """Products in whole float32: no TF32."""
    torch.backends.cuda.matmul.allow_tf32 = False
    torch.backends.cudnn.allow_tf32 = False


def busy_cloud(site: Site, points: int = POINTS, range_m: float = REACH_M) -> Cloud:
    """A cloud of so many points in a window of 100 m width: from the archive, simulated, or of plain geometry."""
    rows = _rows(site.archive)
    x, y, z = rows[:, :3].T
    inside = np.flatnonzero((x >= 0) & (x < range_m) & (np.abs(y) < 50) & (z > -6) & (z < 6))
    rng = np.random.default_rng(1)
    chosen = rows[np.sort(rng.choice(inside, points, replace=len(inside) < points))]
    again = len(inside) < points
    moved = chosen[:, :3] + (rng.normal(0, 0.05, (points, 3)) if again else 0.0)
    return Cloud(moved.astype(np.float32), chosen[:, 3], {"lag_s": chosen[:, 4]})


def make_archive(path: Path) -> str:
    """Simulate the archive's cloud, if it is not there and the simulator is; says where the cloud comes from."""
    if path.is_file():
        return f"the archive {path.name}"
    try:
        from farfield.simulation import simulate_sequence

        frames = list(simulate_sequence("cirrus-sim", seed=1, sequence=0, frames=2))
    except ImportError:
        return "plain geometry: there is neither the simulator nor an archive of its cloud"
    joined = Cloud.concatenate([cloud for frame in frames for cloud in frame.clouds.values()])
    rows = [joined.column(name) for name in ("x_m", "y_m", "z_m", "intensity", "lag_s")]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, rows=np.column_stack(rows).astype(np.float32))
    return "two simulated sweeps in both patterns"


def _rows(archive: Path) -> np.ndarray:
    """x, y, z, intensity and lag of many points."""
    if archive.is_file():
        with np.load(archive, allow_pickle=False) as stored:
            return np.asarray(stored["rows"])
    from sparse_convolution import scan

    once = scan(64, 3000)
    xyz = np.concatenate([once + np.array([ahead_m, 0.0, 0.0]) for ahead_m in (0, 75, 150)])
    strength = np.random.default_rng(0).uniform(0, 1, (len(xyz), 1))
    return np.column_stack([xyz, strength, 0 * strength]).astype(np.float32)


def radar_cloud(name: str) -> Cloud:
    """Cells of a radar's region with exponential power, as many as a radar detector reads."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(180), np.arange(32), np.arange(20), indexing="ij"), -1).reshape(-1, 3)
    count = round(_RADAR_SHARE.get(name, 0.9) * len(grid))
    points = grid[rng.choice(len(grid), count, replace=False)] * 0.4 + [0.2, -6.2, -1.8]
    return Cloud(points.astype(np.float32), None, {"power": rng.exponential(0.02, count).astype(np.float32)})


def network_of(name: str) -> Any:
    """A detector's network: shipped weights for LiDAR, untrained ones for radar, biased to background."""
    if name in RADAR:
        network = build_detector(load_experiment(find(RADAR[name])).detector, seed=0)
        with torch.no_grad():
            network.head.classes.bias[0] = _BACKGROUND_LOGIT
        return network.eval()
    from farfield.detectors.weights import load_weights, resolve_weights

    return load_weights(resolve_weights(f"{name}-cirrus-sim"))[0]


def stirred(network: Any) -> Any:
    """The network with a head that says something different everywhere; trained ones are left alone."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.head.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.1)
    return network


def detector_of(network: Any, device: torch.device, precision: str) -> Detector:
    """A detector; the network itself is left as it is."""
    return Detector(network, device=device, precision=precision)


def batch_of(detector: Detector, cloud: Cloud) -> Inputs:
    """A cloud as the detector's network takes it, on its device."""
    sources = detector.network.inputs.items()
    return Inputs({name: [cloud_tensor(cloud, source.columns)] for name, source in sources}).on(detector.device)


def cloud_for(site: Site, name: str) -> Cloud:
    """The cloud that a detector is timed with."""
    return radar_cloud(name) if name in RADAR else busy_cloud(site)


def wait(device: torch.device) -> None:
    """Wait until the device has done what it was given."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def milliseconds(run: Callable[[], Any], device: torch.device, *, frames: int, warm: int) -> np.ndarray:
    """Time of each run, the first few left out."""
    taken = []
    for _ in range(frames + warm):
        wait(device)
        began = time.perf_counter()
        run()
        wait(device)
        taken.append(1e3 * (time.perf_counter() - began))
    return np.array(taken[warm:])


@contextmanager
def peak_mb(device: torch.device) -> Iterator[dict[str, float]]:
    """Peak memory of the GPU inside the block, MB (10^6 bytes), all that is held there included."""
    peak: dict[str, float] = {}
    if device.type == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(device)
    yield peak
    if device.type == "cuda":
        peak["mb"] = torch.cuda.max_memory_allocated(device) / 1e6


def each(names: tuple[str, ...] | list[str], check: Callable[[str], Iterator[Row]]) -> Iterator[Row]:
    """The rows of each name; where one breaks off, a row says so and the next one follows."""
    for name in names:
        try:
            yield from check(name)
        except Exception as error:
            said = (str(error).splitlines() or [""])[0]
            yield Row(name, f"{type(error).__name__}: {said[:160]}", FAILED)
        with suppress(RuntimeError):
            torch.cuda.empty_cache()
