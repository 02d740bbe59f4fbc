"""The GPU check goes on after a part that breaks off, keeps to its time, and stores what it found."""

import json

import pytest

torch = pytest.importorskip("torch")

import gpu_check
from _gpu_common import Row
from gpu_check import Part

BROKEN = """
import os, time
from _gpu_common import Row

def raises(site):
    yield Row("before", "seen", "ok")
    raise ValueError("expected this")

def dies(site):
    yield Row("before", "seen", "ok")
    os._exit(7)

def sleeps(site):
    yield Row("before", "seen", "ok")
    time.sleep(60)

def nothing(site):
    return iter(())

def works(site):
    yield Row("device", site.device.type, "measured", {"gpu": site.gpu})
"""


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """Parts that break off in every way, and one that works after them."""
    (tmp_path / "broken_parts.py").write_text(BROKEN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    names = ("raises", "dies", "nothing", "works")
    monkeypatch.setattr(gpu_check, "PARTS", {name: Part(f"it {name}", f"broken_parts:{name}") for name in names})
    return tmp_path


@pytest.mark.slow  # a process a part, each of which imports torch
def test_a_part_that_breaks_off_leaves_the_others_be(parts, capsys):
    path = parts / "found.json"
    arguments = ["--only", *gpu_check.PARTS, "--json", str(path), "--archive", str(parts / "none.npz")]
    (parts / "none.npz").touch()  # stands for a cloud: none of these parts reads it
    assert gpu_check.main(arguments) == 1
    found = json.loads(path.read_text("utf-8"))
    rows = {name: [(row["verdict"], row["figure"]) for row in part["rows"]] for name, part in found["parts"].items()}
    assert rows["raises"] == [("ok", "seen"), ("FAILED", "broke off with status 1: ValueError: expected this")]
    assert [verdict for verdict, _ in rows["dies"]] == ["ok", "FAILED"]
    assert "status 7" in rows["dies"][1][1]
    assert rows["nothing"] == [("FAILED", "gave no row")]
    assert rows["works"] == [("measured", "cuda" if torch.cuda.is_available() else "cpu")]
    assert {"commit", "torch"} <= set(found["header"].split()) | set(found["hardware"])
    shown = capsys.readouterr().out
    assert shown.strip() == path.with_suffix(".txt").read_text("utf-8").strip()
    assert "6 rows: 2 ok, 3 FAILED, 1 measured" in shown


def test_a_part_that_takes_too_long_is_stopped(parts, monkeypatch):
    monkeypatch.setitem(gpu_check.PARTS, "sleeps", Part("it sleeps", "broken_parts:sleeps"))
    part = gpu_check.run_part("sleeps", parts / "none.npz", 0.2)
    assert [row["verdict"] for row in part["rows"]] == [gpu_check.OUT_OF_TIME]
    assert part["seconds"] < 30


def stored(folder, name, part, commit="abc1234"):
    """The JSON of a call of one part."""
    found = {"header": f"command  {name}\ndate     today\ncommit   {commit}", "hardware": {"gpu": "G"}, "cloud": "none"}
    row = {"what": part, "figure": "seen", "verdict": "ok", "numbers": {}}
    found["parts"] = {part: {"rows": [row], "seconds": 1.0, "cpu_seconds": 1.0}}
    path = folder / f"{name}.json"
    path.write_text(json.dumps(found), encoding="utf-8")
    return path


def test_several_calls_are_joined_in_the_order_of_the_parts(tmp_path, capsys):
    one, two = stored(tmp_path, "one", "training"), stored(tmp_path, "two", "kernels")
    out = tmp_path / "joined.json"
    assert gpu_check.main(["--join", str(one), str(two), "--json", str(out)]) == 0
    found = json.loads(out.read_text("utf-8"))
    assert list(found["parts"]) == ["kernels", "training"]
    assert found["header"].splitlines() == ["command  one", "command  two", "date     today", "commit   abc1234"]
    assert "2 rows: 2 ok" in capsys.readouterr().out


def test_calls_at_two_commits_are_not_joined(tmp_path):
    one, two = stored(tmp_path, "one", "training"), stored(tmp_path, "two", "kernels", commit="def5678")
    with pytest.raises(ValueError, match="one device and one commit; got 2"):
        gpu_check.joined([one, two])


def test_every_part_has_a_function_that_gives_rows():
    from importlib import import_module

    for part in gpu_check.PARTS.values():
        module, function = part.place.split(":")
        assert callable(getattr(import_module(module), function))
    assert json.loads(Row("a", "b", "ok", {"c": 1}).to_json()) == {
        "what": "a",
        "figure": "b",
        "verdict": "ok",
        "numbers": {"c": 1},
    }
