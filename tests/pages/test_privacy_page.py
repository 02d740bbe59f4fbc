"""What the page shows of covered pictures: surroundings large enough, whole at the edges, with the box marked."""

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from farfield.pages.privacy_page import write_privacy_page
from farfield.privacy import PictureSummary


@pytest.mark.parametrize(
    ("box", "inside"),
    [
        ((4.0, 6.0, 14.0, 18.0), (4, 6)),  # ten pixels wide, in a corner
        ((300.0, 200.0, 420.0, 360.0), (360, 280)),
        ((626.0, 470.0, 640.0, 480.0), (632, 475)),
    ],
)
def test_a_cut_is_whole_sharp_and_marks_the_box(
    tmp_path: Path, box: tuple[float, ...], inside: tuple[int, int]
) -> None:
    picture = np.full((480, 640, 3), 90, dtype=np.uint8)
    picture[inside[1] - 2 : inside[1] + 2, inside[0] - 2 : inside[0] + 2] = (0, 0, 255)
    Image.fromarray(picture).save(tmp_path / "street.png")
    rows = ({"kind": "face", "box_px": box, "score": 0.2, "track": 1, "how": "found"},)
    summary = PictureSummary(file="street.png", size_px=(640, 480), share=0.01, rows=rows)
    write_privacy_page(tmp_path / "page.html", tmp_path, [summary], title="Covered")
    (data,) = re.findall(r"data:image/jpeg;base64,([^\"]+)", (tmp_path / "page.html").read_text())
    cut = np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(int)
    assert cut.shape[0] == cut.shape[1]
    assert cut.shape[0] >= 264, "smaller than it is shown: the browser blurs it"
    blue = (cut[..., 2] > 200) & (cut[..., 0] < 60)
    orange = (cut[..., 0] > 200) & (cut[..., 2] < 90)
    assert blue.any(), "the box is not in the cut"
    assert orange.any(), "the box is not marked"
    marked = np.argwhere(orange)
    assert (np.argwhere(blue).mean(0) >= marked.min(0) - 12).all()
    assert (np.argwhere(blue).mean(0) <= marked.max(0) + 12).all()
