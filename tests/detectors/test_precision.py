"""Which number type auto takes, by what the processor has; the flags are faked."""

import pytest

torch = pytest.importorskip("torch")

from farfield.api import load_detector
from farfield.cli import main
from farfield.detectors import DETECTORS
from farfield.detectors.precision import chosen_precision, flags_of_cpu
from farfield.training.config import TrainingConfig
from farfield.training.launching import precision_of

FULL = {"_is_avx512_supported": True, "_is_avx512_bf16_supported": True, "_is_amx_tile_supported": True}
KINDS = {
    "AMX": FULL,
    "AVX-512 BF16": {**FULL, "_is_amx_tile_supported": False},
    "AVX-512 alone": {**FULL, "_is_amx_tile_supported": False, "_is_avx512_bf16_supported": False},
    "AVX2": dict.fromkeys(FULL, False),
}


@pytest.fixture
def cpu(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> str:
    """The processor that torch is made to see."""
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
    assert "emulates" in chosen_precision()[1]


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
    assert "fp32 on cpu: the processor only emulates bfloat16" in said.err
    assert said.out.startswith("sequence,frame,label"), "boxes alone stand on the output"
    assert main([*words, "--precision", "bf16"]) == 0
    assert "bf16 on cpu: asked for" in capsys.readouterr().err


def test_torch_answers_for_this_processor() -> None:
    assert set(flags_of_cpu()) == {"amx", "avx512_bf16", "avx512"}
