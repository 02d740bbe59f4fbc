"""What a GPU must show: the CPU's outputs and boxes, points that stay, one copy back, words where it is full."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from _gpu_common import exact_float32
from _gpu_outputs import SAME_BOX, SAME_BOX_FLOAT64, SMALL_COPY, _compared, _differences, _outputs, _rows, copies_of
from _gpu_training import RESUMED, trained
from small import SMALL, small_detector

from farfield.detectors.devices import OutOfMemory
from farfield.detectors.runtime import Detector, record_trunk
from farfield.frame import Cloud

pytestmark = pytest.mark.gpu

STAYS = ["pointpillars", "second", "voxelnet", "sparsecentre", "pointrcnn"]


def cloud(rng, n=6000) -> Cloud:
    points = rng.uniform([0, -19, -2.8], [63, 19, 0.9], (n, 3)).astype(np.float32)
    power = {"power": rng.uniform(0, 1, n).astype(np.float32), "lag_s": np.zeros(n, np.float32)}
    return Cloud(points, rng.uniform(0, 1, n).astype(np.float32), power)


def detector(name, device, precision="fp32", **changes) -> Detector:
    network = small_detector(name, **changes)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.head.parameters() if name != "pointrcnn" else ():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.2)
    return Detector(network, device=device, precision=precision)


@pytest.mark.parametrize("name", SMALL)
def test_raw_outputs_are_those_of_the_cpu(rng, name):
    exact_float32()
    seen = cloud(rng)
    expected, got = (_outputs(detector(name, torch.device(device)), seen) for device in ("cpu", "cuda"))
    error, common = _differences(got, expected, "fp32")
    assert error <= 1e-4
    assert common >= 0.99


@pytest.mark.parametrize("name", STAYS)
@pytest.mark.parametrize("precision", ["fp32", "bf16", "fp16"])
def test_boxes_are_those_that_the_cpu_makes_of_the_same_maps(rng, name, precision):
    there = detector(name, "cuda", precision, score_threshold=0.3)
    columns = there.network.inputs["points"].columns
    rows = torch.from_numpy(np.column_stack([cloud(rng).column(name) for name in columns])).cuda()
    with torch.no_grad():
        maps = there.network({"points": [rows]})
    host = type(maps)(*[value.cpu() if torch.is_tensor(value) else value for value in maps])
    (got,), (expected,) = there.network.decode(maps), there.network.decode(host)
    assert len(expected) > 10
    assert _compared(name, got, expected, SAME_BOX.get(name, SAME_BOX_FLOAT64)).verdict == "ok"


@pytest.mark.parametrize("name", ["pointpillars", "second", "sparsecentre"])
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_boxes_do_not_depend_on_the_order_of_points(rng, name, precision):
    there, seen = detector(name, "cuda", precision, score_threshold=0.3), cloud(rng, 60_000)
    order = rng.permutation(len(seen))
    wanted, got = _rows(there(seen)), _rows(there(seen[order]))
    assert len(wanted) > 20
    np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize("name", ["pointpillars", "second", "sparsecentre", "pointrcnn"])
def test_nothing_large_goes_back_but_the_boxes(rng, name):
    there, seen = detector(name, "cuda", score_threshold=0.3), cloud(rng)
    there(seen)
    with copies_of() as copies:
        boxes = there(seen)
    back = [size for words, size in copies if "DtoH" in words]
    assert len(boxes) > 20
    assert [size for size in back if size > SMALL_COPY] == [len(boxes) * 9 * 8]
    assert not [words for words, size in copies if size > 65536 and "Pageable" in words], "expected pinned memory"


@pytest.mark.parametrize("name", ["pointpillars", "second", "voxelnet"])
def test_a_recorded_trunk_finds_the_same_boxes(rng, name):
    there, seen, other = detector(name, "cuda", score_threshold=0.3), cloud(rng), cloud(rng)
    expected, several = [there(each) for each in (seen, other)], there.detect([seen, other])
    record_trunk(there, seen)
    for got, wanted in zip(
        [there(seen), there(other), *there.detect([seen, other])], [*expected, *several], strict=True
    ):
        assert _compared(name, got, wanted).verdict == "ok"


def test_a_full_gpu_is_explained(rng):
    grid = {**SMALL["second"].settings["grid"], "cell_m": [0.05, 0.05, 0.2]}
    there = detector("second", "cuda", grid={key: value for key, value in grid.items() if key != "voxel_m"})
    seen = cloud(rng, 60_000)
    torch.cuda.empty_cache()
    allowed = torch.cuda.memory_reserved() + 32e6
    torch.cuda.set_per_process_memory_fraction(allowed / torch.cuda.get_device_properties(0).total_memory)
    try:
        with pytest.raises(OutOfMemory, match=r"this process holds .*fewer frames at a time"):
            there(seen)
    finally:
        torch.cuda.set_per_process_memory_fraction(1.0)
    assert len(there(seen)) >= 0


@pytest.mark.parametrize("way", [("cpu", "gpu"), ("gpu", "cpu")])
def test_a_training_goes_on_on_another_device(tmp_path, way):
    exact_float32()
    whole = np.array(trained("pointpillars", tmp_path / "whole", device=way[0], steps=4))
    trained("pointpillars", tmp_path / "parted", device=way[0], steps=4, stop=3)
    parted = np.array(trained("pointpillars", tmp_path / "parted", device=way[1], steps=4))
    assert len(parted) == 4
    np.testing.assert_allclose(parted, whole, rtol=RESUMED)
