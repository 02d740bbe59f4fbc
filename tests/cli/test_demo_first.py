"""``farfield demo`` looks for what it needs before it simulates, and says which torch suits the machine."""

from pathlib import Path

import pytest

from farfield.cli import main
from farfield.errors import MissingExtraError, wording


def absent(*_: object, **__: object) -> None:
    raise MissingExtraError("torch", "detect", "Detecting objects")


@pytest.mark.parametrize("words", [[], ["--radar"]])
def test_without_torch_nothing_is_simulated(
    words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings: list[object] = []
    monkeypatch.setattr("farfield.api.load_detector", absent)
    monkeypatch.setattr("farfield.simulation.recording.record", lambda *settings, **_: recordings.append(settings))
    assert main(["demo", *words, "--out", str(tmp_path / "d")]) == 1
    assert not recordings, "24 s of simulation came before the error"
    assert not (tmp_path / "d").exists()
    assert "Detecting objects needs torch" in capsys.readouterr().err


def test_a_machine_without_a_gpu_is_not_sent_to_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wording, "has_nvidia_gpu", lambda: False)
    monkeypatch.setattr(wording.sys, "platform", "linux")
    message = str(MissingExtraError("torch", "detect", "Detecting objects"))
    assert "no NVIDIA GPU" in message
    assert "CPU" in message
    monkeypatch.setattr(wording, "has_nvidia_gpu", lambda: True)
    assert "CPU" not in str(MissingExtraError("torch", "detect", "Detecting objects"))
    monkeypatch.setattr(wording, "has_nvidia_gpu", lambda: False)
    assert "GPU" not in str(MissingExtraError("numba", "simulate", "Simulating"))
    monkeypatch.setattr(wording.sys, "platform", "darwin")
    message = str(MissingExtraError("torch", "detect", "Detecting objects"))
    assert "GPU" not in message, "pip takes no CUDA there"
