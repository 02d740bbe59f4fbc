"""Each protocol's page has its own words, units, bins and legends, and none of another's."""

import html
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from farfield.evaluation.evaluating import part_figures
from farfield.evaluation.record import Evaluation, FrameView
from farfield.evaluation.report_data import annotated_objects
from farfield.frame import Cloud, Constant, Frame, Sensor
from farfield.metrics import PROTOCOLS, Bootstrap, Detections
from farfield.metrics.comparing import compare, read_results
from farfield.metrics.detections import presentation_of
from farfield.metrics.result import subject_of
from farfield.pages import evaluation_page
from farfield.radar.axes import CUBE_SHAPE
from farfield.testing.protocols import example

STILL = Bootstrap(replicates=3)
NAMES = ("dds", "nuscenes", "kitti", "kradar", "kradar-compat:revised_yaw_fixed")
WORDS = {
    "dds": ("DDS", "wDDS", "aIoU", "epsilon"),
    "nuscenes": ("translation error", "orientation error", "scale error", "rad)"),
    "kitti": ("R40", "R11", "moderate", "truncation"),
    "kradar": ("narrow corridor", "label version", "Radar map", "fog"),
    "centres": ("mAP", "within 2 m", "centre lies within", "within 0.5 m", "AP 0.5 m"),
    "overlaps": ("AP3D", "APBEV", "overlaps by more than", "(%)"),
    "far": ("70, 150 and 250 m", "150 to 250 m", "LiDAR point"),
    "near": ("20, 40, 60 and 80 m", "20 to 40 m", "radar cell"),
}
ITS_OWN = {
    "dds": {"dds", "centres", "far"},
    "nuscenes": {"nuscenes", "centres", "far"},
    "kitti": {"kitti", "overlaps", "far"},
    "kradar": {"kradar", "overlaps", "near"},
}


def found_of(name: str) -> Detections:
    """The example's detections with everything that one knows who scores by a protocol."""
    found = example()
    keys = [*found.annotations]
    weather = {key: {"weather": ("fog", "normal")[place % 2], "road": "urban"} for place, key in enumerate(keys)}
    given = {"detector": "pillars", "detector_digest": "ab" * 32, "data": "drives", "fingerprint": "cd" * 32}
    radar = name.startswith("kradar")
    annotations = {
        key: replace(
            a,
            visibility=("R", "L") * (len(a) // 2) if radar else None,
            details={}
            if radar
            else {
                "truncation": np.zeros(len(a)),
                "occlusion": np.zeros(len(a), dtype=np.int64),
                "box_px": np.tile([0.0, 0.0, 50.0, 50.0], (len(a), 1)),
            },
            boxes=a.boxes.replace(point_count=np.arange(len(a)) + 1),
        )
        for key, a in found.annotations.items()
    }
    conditions = weather if radar else {}
    return replace(found, annotations=annotations, conditions=conditions, cloud="radar" if radar else "lidar", **given)


def evaluation_of(name: str) -> Evaluation:
    found, protocol = found_of(name), PROTOCOLS[name]
    cloud, radar = str(found.cloud), name.startswith("kradar")
    drawn = {"bootstrap": STILL} if "bootstrap" in protocol.options() else {}
    result = found.score(protocol, **drawn).to_json()
    key = next(iter(found.annotations))
    points = np.random.default_rng(1).uniform((0, -20, -1), (240, 20, 1), (500, 3)).astype(np.float32)
    frame = Frame(
        sequence=key[0],
        frame_id=key[1],
        reference="radar" if radar else "lidar",
        clouds={cloud: Cloud(points)},
        sensors={cloud: Sensor(kind="radar" if radar else "lidar")},
        load_annotation=Constant(found.annotations[key]),
    )
    shown = presentation_of(result)
    view = FrameView(
        frame=frame,
        predictions={cloud: found.boxes[key]},
        radar_db=np.ones(CUBE_SHAPE[1:], dtype=np.float32) if radar else None,
    )
    return Evaluation(
        title="Pillars on drives",
        results={cloud: result},
        frames=[view],
        objects={
            cloud: annotated_objects(
                found.boxes, found.annotated, finding=shown.finding, kind=frame.sensors[cloud].kind
            )
        },
        parts={cloud: part_figures(found, protocol, {}, by_condition="conditions" not in result)},
        provenance={"simulated": False},
    )


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """All that figures say, instead of pictures of it."""
    said: list[str] = []

    def record(figure: Any, *rest: Any, **more: Any) -> str:
        figure.canvas.draw()
        said.extend(text.get_text() for text in figure.findobj(Text) if text.get_visible())
        return "data:image/png;base64,"

    for module in (evaluation_page,):
        monkeypatch.setattr(module, "figure_uri", record)
    return said


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_the_words_of_its_protocol_alone(name: str, drawn: list[str]) -> None:
    evaluation = evaluation_of(name)
    text = evaluation_page.render_report(evaluation)
    text = re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL) + "\n".join(drawn)
    own = ITS_OWN[name.partition(":")[0].removesuffix("-compat")]
    said = {word for words in WORDS.values() for word in words if re.search(rf"(?<!\w){re.escape(word)}", text)}
    assert {word for kind in own for word in WORDS[kind]} - said == set()
    foreign = {word for kind, words in WORDS.items() if kind not in own for word in words} & said
    assert foreign == set()
    assert str(next(iter(evaluation_page.report_text.subjects(evaluation.results)))) in text


def test_headlines_and_what_they_are_made_of() -> None:
    results = {name: next(iter(evaluation_of(name).results.values())) for name in NAMES}
    shown = {name: presentation_of(result) for name, result in results.items()}
    assert shown["dds"].main == "dds/0/dds"
    assert shown["dds"].beside == "dds/0/map"
    assert shown["nuscenes"].main == "map"
    assert set(shown["nuscenes"].parts) == {"errors/trans_err", "errors/scale_err", "errors/orient_err"}
    assert shown["kitti"].main == "ap/3d_r40/moderate"
    assert shown["kradar"].main == "ap/vehicle/3d/0.3"
    for name, result in results.items():
        assert all(panel.lines for panel in PROTOCOLS[name].presenter.curves(result)[:1]), name


def test_kradar_has_its_tables_by_weather_first_and_its_curves() -> None:
    text = evaluation_page.render_report(evaluation_of("kradar"))
    _, _, body = text.partition("</nav>")
    assert body.index("By weather") < body.index("Scores by range")
    assert "By road" in text
    assert "By visibility" in text
    assert "the LiDAR alone" in text
    assert "Radar map" in text
    assert "Nothing is annotated" not in text


@pytest.mark.parametrize("name", [*NAMES, "argoverse2", "waymo", "waymo-let", "tracking", "nuscenes-tracking"])
def test_line_json_page_row_and_repr_name_one_subject(name: str, drawn: list[str], tmp_path: Path) -> None:
    made = evaluation_of(name)
    (tree,) = made.results.values()
    subject = subject_of(tree)
    assert subject is not None
    assert (subject.detector, subject.data, subject.protocol) == ("pillars", "drives", name)
    assert subject.annotated
    made.save(tmp_path / "run")
    again = Evaluation.load(tmp_path / "run")
    assert subject_of(next(iter(again.results.values()))) == subject
    assert html.escape(str(subject)) in evaluation_page.render_report(again)
    (entry, *_) = read_results([tmp_path / "run"])
    assert entry.subject == subject
    assert entry.name == subject.name
    assert str(subject) in " ".join(compare([entry]).split())
    scored = found_of(name).score(name)
    assert str(subject) in repr(scored)
    assert str(subject) in " ".join(str(scored).split())
