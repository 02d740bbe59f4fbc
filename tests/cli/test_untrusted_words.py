"""Names of files, classes and sequences are text: none is Rich's markup, an emoji or a format."""

import shutil
from pathlib import Path

import pytest
from sources import sources
from wrong_inputs import own_folder, row, run, table

from farfield.cli._output import bar, console
from farfield.cli._training_report import BarReport, LineReport

NAMES = ("a[/]b", "a[bold]b", "[/bold]", "{x}:smile:", "[link=http://a]b", "a{0}[red]b", "[[/]")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "verb", ["doctor DATA --workers 1", "stats DATA --workers 1 --out OUT", "compare DATA COPY --workers 1 --out OUT"]
)
def test_a_name_is_printed_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, name: str) -> None:
    folder = tmp_path / "below" / name.replace("/", "")
    folder.parent.mkdir()
    data = own_folder(folder)
    (data / "labels.csv").write_text(table([row(number, label=name) for number in range(4)]))
    copy = shutil.copytree(data, tmp_path / "copy")
    words = [
        word.replace("DATA", str(data)).replace("OUT", str(tmp_path / "out")).replace("COPY", str(copy))
        for word in verb.split()
    ]
    status, text = run(capsys, *words)
    assert status in (0, 1), text
    joined = "".join(text.split())
    assert "MarkupError" not in text
    assert folder.name in joined or verb.startswith("stats"), text
    assert verb.startswith("compare") or name in joined, text


@pytest.mark.parametrize("name", NAMES)
def test_progress_and_reports_of_trainings_print_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert list(bar([1, 2], name)) == [1, 2]
    for kind in (LineReport, BarReport):
        report = kind(console(stderr=True, width=200), tmp_path / name.replace("/", ""), 1, f"next {name}")
        report.say(f"data: {name}")
        assert list(report.reading([1, 2], name)) == [1, 2]
        report.on_train_start(0, 2)
        report.step(1, {name: 0.5})
        if isinstance(report, BarReport):
            report.progress.stop()
    assert f"data: {name}" in capsys.readouterr().err


def test_rich_prints_in_one_way() -> None:
    """Its consoles are made in one place, and nothing else of it reads words as markup."""
    for path, text in sources().items():
        if "cli/_output" not in str(path):
            assert "Console(" not in text, path
            assert "rich.print" not in text, path
            assert "from_markup" not in text, path
            assert "from rich.progress import track" not in text, path
