"""Commands of the pages go through the command line's own parser, and names in their Python are there."""

from pathlib import Path

import page_blocks
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
WHOLE = sorted([*(ROOT / "docs").glob("from-*.md"), *(ROOT / "docs" / f"{name}.md" for name in ("faq", "tutorial"))])
"""Pages whose commands within sentences and tables are whole ones, too."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_parser_takes_the_commands_of_a_page(page: Path) -> None:
    code = "\n".join(block for _, block in page_blocks.blocks_of(page.read_text("utf-8"), "bash"))
    refused = {" ".join(words): page_blocks.refusal(words) for words in page_blocks.commands_in(code)}
    assert {command: why for command, why in refused.items() if why} == {}


@pytest.mark.parametrize("page", WHOLE, ids=lambda page: page.name)
def test_the_parser_takes_the_commands_in_the_sentences_of_a_page(page: Path) -> None:
    commands = [code for code in page_blocks.inline_code(page.read_text("utf-8")) if code.startswith("farfield ")]
    commands = [code for code in commands if len(code.split()) > 2]  # `farfield doctor` names a verb
    assert len(commands) > (0 if page.stem == "tutorial" else 2)
    refused = {code: page_blocks.refusal(words) for code in commands for words in page_blocks.commands_in(code)}
    assert {code: why for code, why in refused.items() if why} == {}


def test_a_command_that_the_parser_does_not_take_is_noticed() -> None:
    code = "farfield doctor data  # looks\nfarfield score a b \\\n  --protocol dds | head\n"
    code += "farfield train x && farfield show y\n"
    words = page_blocks.commands_in(code)
    assert words == [["doctor", "data"], ["score", "a", "b", "--protocol", "dds"], ["train", "x"], ["show", "y"]]
    assert [page_blocks.refusal(command) for command in words] == [""] * 4
    for wrong in ("score a", "score a b --no-such 1", "score a b --replicates many", "view a --format no", "ask a"):
        assert page_blocks.refusal(wrong.split()), wrong


@pytest.mark.parametrize("page", WHOLE, ids=lambda page: page.name)
def test_names_in_the_python_of_a_page_are_there(page: Path) -> None:
    text = page.read_text("utf-8")
    lines = [code for code in page_blocks.inline_code(text) if code.lstrip("@").startswith("ff.")]
    blocks = [block for _, block in page_blocks.blocks_of(text, "python")]
    for code in [*(line.lstrip("@").replace("...", "None") for line in lines), *blocks]:
        assert page_blocks.unknown_names(code) == [], code


def test_a_name_that_is_not_there_is_noticed() -> None:
    assert page_blocks.unknown_names("import farfield as ff\nff.Boxes.from_numpy(rows, label='a')") == []
    for wrong in (
        "ff.open_data('a')",
        "ff.Boxes.from_rows(rows)",
        "ff.evaluate(d, data, protokol='dds', cloud='a') if ff.load_detector('x', devise='cpu') else 0",
        "from farfield.geometry.iou import no_iou",
        "from farfield.no_room import anything",
    ):
        assert page_blocks.unknown_names(wrong), wrong
