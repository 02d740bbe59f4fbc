"""A film of the frames made from the page: the file that the browser gets opens and has them."""

import itertools

import numpy as np
import pytest

pytest.importorskip("starlette")
from _studio_scenes import write_folder
from _studio_screen import screen
from PIL import Image
from studio.live import studio

from farfield.datasets import open_dataset

FRAMES = 6


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    folder = write_folder(tmp_path_factory.mktemp("film") / "drive", FRAMES, 12_000)
    with studio(lambda: open_dataset(folder), notes=folder.parent) as running:
        yield running


def filmed(chromium, live, folder, *, first: int) -> Image.Image:
    """The file that a click on Film brings."""
    with screen(chromium, live, frame=first, downloads=folder) as page:
        assert page.tell("colours()") > 60
        main = page.page.locator("#main").bounding_box()
        with page.page.expect_download(timeout=60_000) as waiting:
            page.page.get_by_role("button", name="Film").click()
        assert waiting.value.suggested_filename.endswith(".gif")
        waiting.value.save_as(folder / "film.gif")
        assert page.errors == []
        assert page.tell("state.frame") == first  # back where the person was
    film = Image.open(folder / "film.gif")
    assert film.format == "GIF"
    assert film.size == pytest.approx((main["width"], main["height"]), abs=2)
    return film


def test_a_film_has_every_frame_from_here_on_each_another_picture(chromium, live, tmp_path):
    with filmed(chromium, live, tmp_path, first=0) as film:
        assert film.n_frames == FRAMES
        pictures = []
        for place in range(film.n_frames):
            film.seek(place)
            assert film.info["duration"] == 100  # at 10 Hz
            pictures.append(np.asarray(film.convert("RGB"), dtype=np.int16))
        assert all(len(np.unique(each.reshape(-1, 3), axis=0)) > 60 for each in pictures)
        assert all(np.any(a != b) for a, b in itertools.pairwise(pictures))


def test_a_film_begins_at_the_frame_that_is_shown(chromium, live, tmp_path):
    with filmed(chromium, live, tmp_path, first=FRAMES - 2) as film:
        assert film.n_frames == 2
