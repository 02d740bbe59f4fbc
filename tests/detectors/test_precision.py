"""Which number type auto takes, by what the processor has; the flags are faked."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from farfield.api import load_detector
from farfield.cli import main
from farfield.detectors import DETECTORS, devices
from farfield.detectors.devices import chosen_precision, flags_of_cpu
from farfield.training.config import TrainingConfig
from farfield.training.processes import precision_of

FULL = {"_is_avx512_supported": True, "_is_avx512_bf16_supported": True, "_is_amx_tile_supported": True}
KINDS = {
    "AMX": FULL,
    "AVX-512 BF16": {**FULL, "_is_amx_tile_supported": False},
    "AVX-512 alone": {**FULL, "_is_amx_tile_supported": False, "_is_avx512_bf16_supported": False},
    "AVX2": dict.fromkeys(FULL, False),
}


SLOW_MAPS = {"dense": {"fp32": 10.0, "bf16": 21.5}, "rows": {"fp32": 8.0, "bf16": 5.0}}


@pytest.fixture(autouse=True)
def _no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A cache of its own for each test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    devices.kept_times.cache_clear()
    yield
    devices.kept_times.cache_clear()


@pytest.fixture
def cpu(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """The processor that torch is made to see, and how long bfloat16 takes where it is emulated."""
    monkeypatch.setattr(devices, "measured_times", lambda: SLOW_MAPS)
    for name, there in KINDS[request.param].items():
        monkeypatch.setattr(torch.cpu, name, lambda there=there: there)
    return str(request.param)


@pytest.mark.parametrize("cpu", KINDS, indirect=True)
def test_auto_goes_by_what_the_processor_multiplies(cpu: str) -> None:
    wanted = "bf16" if cpu in ("AMX", "AVX-512 BF16") else "fp32"
    detector = load_detector("pointpillars-cirrus-sim", device="cpu")
    assert detector.precision == wanted
    dtype = {"bf16": torch.bfloat16, "fp32": torch.float32}[wanted]
    assert detector.network.get_submodule(detector.network.low_precision[0]) is not None
    assert dtype in {parameter.dtype for parameter in detector.network.parameters()}
    assert precision_of(TrainingConfig(accelerator="cpu")) == wanted, "training, too"


@pytest.mark.parametrize("cpu", ["AVX-512 alone"], indirect=True)
def test_a_network_of_gathers_takes_bfloat16_where_it_is_emulated(cpu: str) -> None:
    assert chosen_precision(DETECTORS["sparsecentre"].network_class)[0] == "bf16"
    assert {name: chosen_precision(DETECTORS[name].network_class)[0] for name in ("pointpillars", "voxelnet")} == {
        "pointpillars": "fp32",
        "voxelnet": "fp32",
    }
    why = chosen_precision()[1]
    assert why == "the processor emulates bfloat16; convolutions took 10.0 ms in fp32 and 21.5 ms in bf16"


@pytest.mark.parametrize("cpu", ["AVX-512 alone"], indirect=True)
def test_the_choice_can_be_overruled(cpu: str) -> None:
    assert load_detector("pointpillars-cirrus-sim", device="cpu", precision="bf16").precision == "bf16"
    assert load_detector("pointpillars-cirrus-sim", device="cpu").why_precision == chosen_precision()[1]
    assert load_detector("pointpillars-cirrus-sim", device="cpu", precision="bf16").why_precision == "asked for"


@pytest.mark.parametrize("cpu", ["AVX-512 alone"], indirect=True)
def test_predict_prints_what_was_chosen(cpu: str, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    import numpy as np

    np.save(tmp_path / "0.npy", np.ones((3, 4), dtype=np.float32))
    words = ["predict", "pointpillars-cirrus-sim", str(tmp_path / "0.npy"), "--device", "cpu"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "fp32 on cpu: the processor emulates bfloat16; convolutions took 10.0 ms" in said.err
    assert said.out.startswith("sequence,frame,label"), "boxes alone stand on the output"
    assert main([*words, "--precision", "bf16"]) == 0
    assert "bf16 on cpu: asked for" in capsys.readouterr().err


def test_the_measurement_is_taken_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    emulating, asked = {"avx512": True}, []
    monkeypatch.setattr(devices, "measured_times", lambda: asked.append(1) or SLOW_MAPS)
    assert chosen_precision(flags=emulating)[0] == "fp32"
    assert (tmp_path / "cache" / "farfield" / "precision.json").is_file()
    devices.kept_times.cache_clear()
    assert chosen_precision(flags=emulating)[0] == "fp32"
    assert asked == [1], "another process reads the file"
    (tmp_path / "cache" / "farfield" / "precision.json").write_text("[")
    devices.kept_times.cache_clear()
    assert chosen_precision(flags=emulating)[0] == "fp32"
    assert asked == [1, 1], "a damaged file is measured anew"
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    devices.kept_times.cache_clear()
    assert chosen_precision(flags=emulating)[0] == "fp32", "no cache can be written"


def test_a_measurement_takes_about_half_a_second() -> None:
    began = time.process_time()
    taken = devices.measured_times()
    assert time.process_time() - began < 3
    assert all(ms > 0 for times in taken.values() for ms in times.values())
    assert set(taken) == {"dense", "rows"}


def test_torch_answers_for_this_processor() -> None:
    assert set(flags_of_cpu()) == {"amx", "avx512_bf16", "avx512"}
