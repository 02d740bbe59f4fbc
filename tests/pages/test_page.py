import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from farfield.cli import main
from farfield.evaluation.record import Evaluation
from farfield.pages.evaluation_page import render_report, write_report
from farfield.vocabulary.studio import STUDIO_PORT

VOID = {"meta", "img", "br", "link"}


class _Page(HTMLParser):
    """Collects what a page loads, its texts, and whether its tags are balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.alts: list[str | None] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.sources += [
            value or "" for name, value in attrs if name in ("src", "href") and not (value or "").startswith("#")
        ]
        if tag == "img":
            self.alts.append(found.get("alt"))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.texts.append(data)


@pytest.fixture(scope="module")
def page_text(evaluation: Evaluation) -> str:
    return render_report(evaluation)


def test_page_is_one_well_formed_file_that_loads_nothing(page_text: str) -> None:
    page = _Page(page_text)
    assert page.open == []
    assert page.sources
    links = [source for source in page.sources if source.startswith(f"http://127.0.0.1:{STUDIO_PORT}/?frame=")]
    assert links  # followed by a person, into a studio that runs
    assert all(source.startswith("data:image/") for source in page.sources if source not in links)
    assert "<script" not in page_text
    assert not re.search(r"url\(|@import", page_text)
    assert all(page.alts)


def test_page_shows_scores_as_the_results_have_them(page_text: str, evaluation: Evaluation) -> None:
    words = " ".join(" ".join(_Page(page_text).texts).split())
    result = evaluation.results["gaussian"]
    for part in (result, result["ranges"]["0-70"], result["ranges"]["150-250"]):
        for epsilon in ("0", "0.003", "0.006", "0.009"):
            assert f"{part['dds'][epsilon]['dds']:.3f}" in words
    assert "wDDS 0.006" in words
    assert "150 to 250 m" in words
    assert "2 frames with 6 annotated objects" in words
    assert "Simulated frames" in words
    assert "trained on nothing" in words
    assert "range (m)" in words


def test_names_from_data_cannot_become_markup(page_text: str) -> None:
    assert "Frame &lt;0&gt;" in page_text
    assert "A &amp; B" in page_text


def test_page_counts_found_objects(page_text: str) -> None:
    assert (
        page_text.count(
            "2 of 3 annotated objects of vehicle and large_vehicle found within 2 m, 0 predictions without one"
        )
        == 2
    )


def test_equal_evaluations_give_equal_pages(evaluation: Evaluation, page_text: str) -> None:
    assert render_report(evaluation) == page_text


def test_page_without_pictures_and_without_annotation(tmp_path: Path) -> None:
    empty = {"protocol": "dds", "dds": {"0": {"dds": None}}, "ap": {"0.5": None}, "ranges": {"0-70": None}}
    path = write_report(tmp_path / "deep" / "page.html", Evaluation(title="empty", results={"none": empty}))
    text = path.read_text()
    assert "Nothing is annotated" in text
    assert "does not say whether" in text
    assert _Page(text).open == []


def test_other_protocols_have_pages_too() -> None:
    kitti = {
        "protocol": "kitti",
        "label": "Car",
        "dds": {},
        "ap": {"3d_r40": {"hard": 0.5, "moderate": 0.75}, "bev_r11": {"hard": 0.25}},
        "settings": {"dontcare": "none"},
    }
    text = render_report(Evaluation(results={"mine": kitti}))
    assert "AP3D R40 moderate of Car, all ranges together (100 is perfect): 75.0 on mine." in text
    assert "What the score is made of" not in text


def test_report_command(evaluation: Evaluation, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluation.save(tmp_path / "run")
    assert main(["report", str(tmp_path / "run"), "--title", "Again"]) == 0
    assert "Again" in (tmp_path / "run" / "report.html").read_text()
    assert "report.html" in capsys.readouterr().out


def test_report_command_takes_the_json_of_score(evaluation: Evaluation, tmp_path: Path) -> None:
    scores = tmp_path / "scores.json"
    scores.write_text(json.dumps(evaluation.results["gaussian"]))
    assert main(["report", str(scores), "--out", str(tmp_path / "scores.html")]) == 0
    assert "Precision and recall" in (tmp_path / "scores.html").read_text()


NO_CURVE = '{"overall": {"0": {"2.0": {"recall": [0, 1], "precision": [1]}}}}'


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{}",
        '{"results": 3}',
        '{"results": {}, "settings": {}}',
        '{"protocol": "dds", "settings": {}, "dds": {"0": {"dds": "high"}}}',
        '{"protocol": "dds", "settings": {}, "curves": ' + NO_CURVE + "}",
    ],
)
def test_report_command_refuses_other_files(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.json").write_text(content)
    assert main(["report", str(tmp_path / "x.json")]) == 1
    error = capsys.readouterr().err
    assert "x.json" in error or "result, " in error
    assert not (tmp_path / "x.html").exists()
    assert main(["report", str(tmp_path / "absent")]) == 1
