"""Flags of one name are one thing in every verb; what is written much can be said without writing it."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from farfield.cli import VERBS, main
from farfield.cli._completion import SHELLS, arguments_of, flags_of, script


def types_of(flag: str) -> dict[str, set[str]]:
    """The verbs in which a flag is of each type; positional arguments are left out."""
    types: dict[str, set[str]] = {}
    for verb in VERBS:
        for argument in arguments_of(verb):
            if argument.option_strings and argument.dest.rpartition(".")[2].replace("-", "_") == flag:
                kind = str(argument.metavar or type(argument).__name__).removeprefix("{None}|")
                types.setdefault(kind, set()).add(verb)
    return types


@pytest.mark.parametrize(
    "flag", ["json", "clouds", "replicates", "out", "reference", "columns", "dry_run", "workers", "overwrite"]
)
def test_a_flag_has_one_type(flag: str) -> None:
    assert len(types_of(flag)) == 1, types_of(flag)


def test_the_flags_stand_where_they_belong() -> None:
    verbs = {flag: set().union(*types_of(flag).values()) for flag in ("json", "dry_run", "clouds", "cloud")}
    assert verbs["json"] >= {"doctor", "score", "evaluate", "stats", "compare", "detectors"}
    assert verbs["dry_run"] >= {"train", "simulate", "convert", "depth"}
    for verb in (verbs["clouds"] | verbs["cloud"]) - {"detectors"}:
        assert {"--cloud", "--clouds"} <= set(flags_of(verb)), f"{verb} takes either spelling"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "own").mkdir()
    rows = np.random.default_rng(0).uniform([2, -20, -2, 0], [60, 20, 0, 1], (300, 4)).astype(np.float32)
    for name in "01":
        np.save(tmp_path / "own" / f"{name}.npy", rows)
    return tmp_path / "own"


def test_doctor_and_detectors_write_json_to_a_path_or_the_output(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["doctor", str(own), "--json", str(tmp_path / "d.json")])
    table = capsys.readouterr().out
    assert "finding" in table or "Ready" in table
    told = json.loads((tmp_path / "d.json").read_text())
    main(["doctor", str(own), "--json", "-", "--frames", "0"])
    assert json.loads(capsys.readouterr().out).keys() == told.keys()


def test_stats_writes_its_json_where_it_is_asked(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["stats", str(own), "--json", "mine.json", "--sweeps", "0"]) == 0
    assert (tmp_path / "mine.json").read_bytes() == (tmp_path / "runs/stats-own/statistics.json").read_bytes()


def test_dry_runs_write_nothing(own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("embreex")
    assert main(["convert", str(own), str(tmp_path / "kitti"), "--to", "kitti", "--dry-run"]) == 0
    assert f"would write 2 frames of folder as kitti to {tmp_path / 'kitti'}" in capsys.readouterr().out
    assert main(["simulate", "cirrus-sim-mini", str(tmp_path / "sim"), "--frames", "3", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "3 frames" in said
    assert "nothing is written" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["own"]


def test_verbose_shows_where_an_error_came_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["doctor", str(tmp_path / "absent")]
    assert main(words) == 1
    assert "Traceback" not in capsys.readouterr().err
    for asked in ([*words, "-v"], ["-v", *words], [*words, "--verbose"]):
        assert main(asked) == 1
        said = capsys.readouterr().err
        assert "Traceback" in said
        assert "farfield doctor:" in said


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    import farfield

    for flag in ("--version", "-V"):
        assert main([flag]) == 0
        assert capsys.readouterr().out == f"farfield {farfield.__version__}\n"


@pytest.mark.parametrize("shell", SHELLS)
def test_completion_knows_every_verb_and_flag(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", shell]) == 0
    text = capsys.readouterr().out
    assert text == script(shell, VERBS)
    assert all(verb in text for verb in VERBS)
    assert "--score-threshold" in text if shell == "bash" else "score-threshold" in text
    assert main(["--completion", "tcsh"]) == 2
    assert "bash, zsh, fish" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        (["farfield", "pre"], {"predict"}),
        (["farfield", "predict", "--score-th"], {"--score-threshold"}),
        (["farfield", "convert", "--to", "cv"], {"cvat"}),
        (["farfield", "--ver"], {"--version", "--verbose"}),
    ],
)
def test_bash_completes(typed: list[str], wanted: set[str], tmp_path: Path) -> None:
    (tmp_path / "complete.bash").write_text(script("bash", VERBS))
    words = " ".join(f"'{word}'" for word in typed)
    lines = f"source {tmp_path / 'complete.bash'}; COMP_WORDS=({words}); COMP_CWORD={len(typed) - 1}; _farfield"
    done = subprocess.run(
        ["bash", "-c", f'{lines}; printf "%s\\n" "${{COMPREPLY[@]}}"'], capture_output=True, text=True
    )
    assert done.stderr == ""
    assert set(done.stdout.split()) == wanted


def test_evaluate_prints_the_table_that_score_prints(own: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip("torch")
    from farfield.datasets.folder import write_boxes
    from farfield.frame import Boxes

    rows = ["frame,label,x,y,z,l,w,h,yaw_rad"]
    for name in "01":
        car = Boxes(
            centre_m=np.array([[20.0, 1, -1]]), size_m=np.array([[4.4, 1.9, 1.6]]), yaw_rad=np.zeros(1), label="vehicle"
        )
        write_boxes(own / f"{name}.json", car)
        rows.append(f"{name},vehicle,20,1,-1,4.4,1.9,1.6,0")
    (tmp_path / "truth.csv").write_text("\n".join(rows) + "\n")
    common = ["--range-bins-m", "0,30,60", "--replicates", "0", "--json"]
    words = ["evaluate", "pointpillars-cirrus-sim", str(own), "--out", str(tmp_path / "e"), "--no-report"]
    assert main([*words, *common, str(tmp_path / "e.json")]) == 0
    evaluated = capsys.readouterr().out
    words = ["predict", "pointpillars-cirrus-sim", str(own), "--out", str(tmp_path / "found.csv")]
    assert main(words) == 0
    capsys.readouterr()
    words = ["score", str(tmp_path / "found.csv"), str(tmp_path / "truth.csv"), "--label", "vehicle"]
    assert main([*words, *common, str(tmp_path / "s.json")]) == 0
    scored = capsys.readouterr().out
    table = [line for line in scored.splitlines() if line.startswith("---") or re.search(r" \d\.\d{4}( |$)", line)]
    assert len(table) > 3
    assert not [line for line in table if line not in evaluated.splitlines()]
    ours, theirs = (json.loads((tmp_path / name).read_text()) for name in ("e.json", "s.json"))
    assert ours["dds"] == theirs["dds"], "predict and score give what evaluate gives"


def test_the_demo_says_how_long_it_takes(monkeypatch, tmp_path, capsys) -> None:
    from farfield.cli import demo

    monkeypatch.setattr(
        "farfield.simulation.recording.record", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    assert main(["demo", "--out", str(tmp_path / "d")]) == 130
    said = capsys.readouterr().out.splitlines()[0]
    assert "20 frames" in said
    assert "minute" in said
    assert demo.seconds_of(60) > 2 * demo.seconds_of(20)
