"""Where a detector runs and in which numbers, and what it says where there is no such device or no room."""

from contextlib import nullcontext

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from small import small_detector

from farfield.detectors import devices
from farfield.detectors.devices import OutOfMemory, chosen_device, default_precision, fitting
from farfield.detectors.inputs import Inputs
from farfield.detectors.runtime import Detector, record_trunk
from farfield.errors import ConfigError
from farfield.frame import Cloud
from farfield.training.config import TrainingConfig
from farfield.training.processes import precision_of


@pytest.fixture
def gpu(monkeypatch):
    """A machine that says it has a GPU of a compute capability."""

    def of(capability, count=1):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: count > 0)
        monkeypatch.setattr(torch.cuda, "device_count", lambda: count)
        monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device=None: capability)
        native = capability >= (8, 0)
        monkeypatch.setattr(
            torch.cuda, "is_bf16_supported", lambda including_emulation=True: including_emulation or native
        )
        monkeypatch.setattr(torch.cuda, "device", lambda device: nullcontext())

    return of


@pytest.mark.parametrize(
    ("capability", "detecting", "training"),
    [
        ((9, 0), "bf16", "bf16"),
        ((8, 0), "bf16", "bf16"),
        ((7, 5), "fp16", "fp32"),
        ((7, 0), "fp16", "fp32"),
        ((6, 1), "fp32", "fp32"),
    ],
)
def test_the_number_type_is_what_the_gpu_multiplies_natively(gpu, capability, detecting, training):
    gpu(capability)
    assert default_precision(torch.device("cuda"))[0] == detecting
    assert precision_of(TrainingConfig()) == training  # float16 would want its gradients scaled
    assert precision_of(TrainingConfig(precision="fp32")) == "fp32"


def test_auto_takes_a_gpu_if_there_is_one(gpu):
    gpu((9, 0), count=2)
    assert chosen_device() == chosen_device("auto") == torch.device("cuda")
    assert chosen_device("cuda:1") == torch.device("cuda:1")
    assert chosen_device("cpu") == torch.device("cpu")
    with pytest.raises(ConfigError, match=r"one of the 2 GPUs.*'cuda:2'"):
        chosen_device("cuda:2")
    gpu((9, 0), count=0)
    assert chosen_device() == chosen_device("auto") == torch.device("cpu")
    with pytest.raises(ConfigError, match=r"the 0 GPUs that torch .* sees.*Take auto or cpu"):
        Detector(small_detector("pointpillars"), device="cuda")


def test_an_unknown_device_is_refused():
    with pytest.raises(ConfigError, match="expected auto, cpu, cuda or cuda:NUMBER; got 'gpu9'"):
        chosen_device("gpu9")


@pytest.mark.parametrize("name", ["pointpillars", "second", "voxelnet", "pointrcnn", "sparsecentre", "rtn", "rtnh"])
@pytest.mark.parametrize("precision", ["bf16", "fp16"])
def test_every_detector_runs_in_half_precision(rng, name, precision):
    points = rng.uniform([0, -15, -2.5], [60, 15, 0.9], (900, 3)).astype("float32")
    extra = {"power": rng.uniform(0, 1, 900).astype("float32")}
    cloud = Cloud(points, rng.uniform(0, 1, 900).astype("float32"), extra)
    found = Detector(small_detector(name, score_threshold=0.0), precision=precision, device="cpu")
    kinds = {
        value.dtype for part in found.network.low_precision for value in found.network.get_submodule(part).parameters()
    }
    assert kinds == {devices.DTYPES[precision]}
    assert len(found(cloud)) > 0


def test_inputs_arrive_as_they_were(rng):
    cloud = torch.from_numpy(rng.normal(size=(30, 4)).astype("float32"))
    there = Inputs({"points": [cloud, cloud[:0]]}).on(torch.device("cpu"))
    assert torch.equal(there["points"][0], cloud)
    assert len(there) == 2


def test_too_much_for_the_memory_is_explained():
    with (
        pytest.raises(OutOfMemory, match=r"The memory of this machine is not enough\. Take less\."),
        fitting("Take less."),
    ):
        torch.empty(2**60, dtype=torch.uint8)
    with pytest.raises(RuntimeError, match="must match"), fitting("Take less."):
        torch.zeros(2) + torch.zeros(3)


def test_a_detector_says_what_to_change_where_a_gpu_is_full(rng, monkeypatch):
    found = Detector(small_detector("pointpillars"), precision="fp32", device="cpu")

    def full(batch):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 9.00 GiB.\nmore")

    monkeypatch.setattr(found.network, "predict", full)
    cloud = Cloud(rng.uniform(0, 9, (40, 3)).astype("float32"), None, {})
    with pytest.raises(OutOfMemory, match=r"Tried to allocate 9.00 GiB.\).*fewer frames at a time, precision bf16"):
        found(cloud)


def test_only_a_trunk_on_a_gpu_is_recorded():
    there = Detector(small_detector("pointpillars"), device="cpu")
    with pytest.raises(ConfigError, match="on a GPU; got pointpillars on cpu"):
        record_trunk(there, Cloud(np.zeros((1, 3), np.float32)))
