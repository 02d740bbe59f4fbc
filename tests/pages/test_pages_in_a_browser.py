"""The pages that are one file, in a browser: axe-core finds nothing, light or dark; nothing is cut; contents lead."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("playwright")
pytest.importorskip("starlette")

from blocks_of_houses import drive
from drive import frame
from PIL import Image
from studio.browser.conftest import chromium  # noqa: F401
from studio.browser.layout import SIZES, axe_faults, layout_faults

from farfield import cli
from farfield.datasets.kradar import KRadarWriter
from farfield.evaluation.record import Evaluation
from farfield.frame import Boxes, Cloud, Frame
from farfield.pages.evaluation_page import write_report
from farfield.pages.privacy_page import write_privacy_page
from farfield.pages.training_pages import AdaptedPage, CoursePage, PseudoLabelFrame, write_adapted, write_course
from farfield.privacy import PictureSummary

pytestmark = pytest.mark.slow

START = 1_700_000_000_000_000_000


def report(folder: Path, evaluation: Evaluation) -> Path:
    write_report(folder / "report.html", evaluation)
    return folder / "report.html"


def sync(folder: Path, evaluation: Evaluation) -> Path:
    (folder / "rig").mkdir()
    for name, later in (("lidar", 0), ("camera", 4_000_000), ("radar", -7_000_000)):
        np.savetxt(folder / "rig" / f"{name}.txt", START + later + np.arange(60) * 100_000_000, fmt="%d")
    assert cli.main(["sync", str(folder / "rig"), "--to", "lidar", "--out", str(folder / "out")]) == 0
    return folder / "out" / "sync.html"


def privacy(folder: Path, evaluation: Evaluation) -> Path:
    rng = np.random.default_rng(3)
    Image.fromarray(rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)).save(folder / "street.png")
    boxes = [(4.0, 6.0, 14.0, 18.0), (300.0, 200.0, 420.0, 360.0), (600.0, 460.0, 636.0, 474.0)]
    rows = tuple({"kind": "face", "box_px": box, "score": 0.2, "track": 1, "how": "found"} for box in boxes)
    left = ({"kind": "plate", "box_px": boxes[2], "score": 0.1},)
    summary = PictureSummary(file="street.png", size_px=(640, 480), share=0.01, rows=rows, left=left)
    write_privacy_page(folder / "anonymized.html", folder, [summary], title="Covered: street")
    return folder / "anonymized.html"


def statistics(folder: Path, evaluation: Evaluation) -> Path:
    samples = resources.files("farfield.studio") / "samples" / "kradar"
    assert cli.main(["stats", str(samples), "--out", str(folder / "out")]) == 0
    return folder / "out" / "statistics.html"


def comparison(folder: Path, evaluation: Evaluation) -> Path:
    samples = resources.files("farfield.studio") / "samples" / "kradar"
    assert cli.main(["compare", str(samples), "open-sweeps", "--frames", "1", "--out", str(folder / "out")]) == 0
    return next((folder / "out").glob("*.html"))


def odometry(folder: Path, evaluation: Evaluation) -> Path:
    (folder / "street").mkdir()
    for number, sweep in enumerate(drive(4, points=2000)[0]):
        np.save(folder / "street" / f"{number:04d}.npy", sweep.points_m.astype(np.float32))
    out = folder / "out"
    assert cli.main(["odometry", str(folder / "street"), "--out", str(out), "--workers", "1"]) == 0
    return out / "odometry.html"


def radar(folder: Path, evaluation: Evaluation) -> Path:
    rng = np.random.default_rng(3)
    polar = np.stack([rng.gamma(63, 0.008 / 63, (256, 107, 37)), rng.normal(0, 0.1, (256, 107, 37))]).astype(np.float32)
    writer = KRadarWriter(folder / "data", columns=512)
    writer.write(frame(1, radar={"polar3d": polar}))
    writer.finish()
    assert cli.main(["radar", str(folder / "data"), "--frames", "0", "--out", str(folder / "out")]) == 0
    return folder / "out" / "radar.html"


def course(folder: Path, evaluation: Evaluation) -> Path:
    page = CoursePage(
        title="run",
        steps=9,
        rows=ROWS,
        signs=["the rank falls"],
        settings={"detector": "second", "training.checkpoint_every_s": 60.0},
    )
    return write_course(folder / "course.html", page)


def adapted(folder: Path, evaluation: Evaluation) -> Path:
    box = Boxes(
        centre_m=np.array([[20.0, 0, 0]]), size_m=np.array([[4.5, 2, 1.6]]), yaw_rad=np.zeros(1), score=np.array([0.7])
    )
    cloud = Cloud(np.random.default_rng(3).uniform([0, -20, -2], [100, 20, 1], (500, 3)).astype(np.float32))
    sweep = Frame(sequence="s", frame_id="0", clouds={"lidar": cloud})
    page = AdaptedPage(
        title="second adapted to a street",
        classes=("vehicle",),
        edges_m=[0.0, 70.0, 150.0],
        before={("s", "0"): box},
        after={("s", "0"): box},
        positive={"vehicle": 0.6},
        negative={"vehicle": 0.3},
        source_rate=7.25,
        measured=("vehicle",),
        changes=[PseudoLabelFrame(sweep, "lidar", box, box)],
        rows=ROWS,
        signs=["the rank falls"],
        labels="The target is annotated.",
        simulated={"source": True, "target": False},
        settings={"rounds": 2},
    )
    return write_adapted(folder / "adapted.html", page)


ROWS = [{"step": step, "loss": 2.0 / step, "validation": 0.5, "rank_source": 9.0} for step in range(1, 5)]
WIDER_THAN_THEIR_ROOM = (
    "[...document.querySelectorAll('dt')].filter((one) => one.scrollWidth > one.clientWidth + 1)"
    ".map((one) => one.textContent)"
)
PAGES = [report, sync, privacy, statistics, comparison, odometry, radar, course, adapted]


@pytest.mark.parametrize("make", PAGES)
def test_a_page_is_whole_and_axe_finds_nothing(
    make: Callable[[Path, Evaluation], Path],
    tmp_path: Path,
    evaluation: Evaluation,
    chromium: Any,  # noqa: F811
) -> None:
    file = make(tmp_path, evaluation)
    context = chromium.new_context()
    page = context.new_page()
    page.goto(file.as_uri())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for width, height in SIZES[::3]:
            page.set_viewport_size({"width": width, "height": height})
            assert layout_faults(page) == [], (width, height)
            assert page.evaluate(WIDER_THAN_THEIR_ROOM) == [], (width, height)
        assert "\n".join(axe_faults(page)) == ""
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate("getComputedStyle(document.body).color") == "rgb(23, 33, 43)"
    page.emulate_media(media="screen")
    tall = page.evaluate("document.documentElement.scrollHeight / innerHeight")
    links = page.evaluate("[...document.querySelectorAll('nav a')].map((one) => one.getAttribute('href'))")
    assert links or tall < 3, f"a page of {tall:.0f} screens has no contents"
    assert page.evaluate("(links) => links.every((one) => document.querySelector(one))", links)
    context.close()
