"""The progress bar of the verbs."""

from collections.abc import Iterator

import pytest

from farfield.cli import _output
from farfield.cli._output import bar


class Lazy:
    """Items with a length, each made when its turn comes."""

    def __init__(self) -> None:
        self.made = 0

    def __len__(self) -> int:
        return 3

    def __iter__(self) -> Iterator[int]:
        for item in range(3):
            self.made += 1
            yield item


@pytest.mark.parametrize("items", [range(3), [0, 1, 2], iter(range(3))], ids=["range", "list", "generator"])
def test_all_items_pass_through_and_nothing_goes_to_standard_output(
    items: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list(bar(items, "counting")) == [0, 1, 2]  # type: ignore[arg-type]
    assert capsys.readouterr().out == ""


def test_what_has_a_length_is_made_item_by_item() -> None:
    items = Lazy()
    assert next(iter(bar(items, "making"))) == 0  # type: ignore[arg-type]
    assert items.made < 3


def test_a_pipe_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert list(bar(range(4), "counting")) == [0, 1, 2, 3]
    assert capsys.readouterr().err == "", "short work says nothing"
    monkeypatch.setattr(_output, "EVERY_S", 0.0)
    assert list(bar(range(4), "counting")) == [0, 1, 2, 3]
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(", about ")[0] for line in lines] == [f"counting: {number} of 4" for number in (1, 2, 3)]
    assert lines[0].endswith("minutes left")
