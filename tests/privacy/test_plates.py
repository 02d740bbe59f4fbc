"""Number plates: maps decoded by hand, the sizes joined, weights that are refused, and the shipped network."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

torch = pytest.importorskip("torch")
safetensors = pytest.importorskip("safetensors.torch")

from farfield.errors import FarfieldError, FileFormatError
from farfield.privacy import AnonymizeOptions, detectors
from farfield.privacy.covering import box_mask, cover_boxes
from farfield.privacy.detectors import (
    PLATE_ASPECTS,
    PlateDetector,
    decode_plates,
    find_boxes,
    judge_plates,
    may_be_plate,
    merge_overlapping,
    picture_sizes,
)
from farfield.privacy.image_boxes import ImageBoxes, covered_share
from farfield.privacy.plate_network import (
    MAX_BYTES,
    PATCH_PX,
    PlateJudge,
    PlateNetwork,
    cut_patches,
    halved,
    judged_boxes,
    load_networks,
    save_networks,
)


def maps_with(rows: int, columns: int, *cells: tuple[int, int, float]) -> np.ndarray:
    """Maps in which some cells (row, column, score) hold a plate of 16 x 8 pixels, a quarter of a cell off."""
    maps = np.zeros((5, rows, columns))
    for row, column, score in cells:
        maps[:, row, column] = score, np.log(4), np.log(2), 0.25, 0.5
    return maps


def test_a_cell_becomes_a_box() -> None:
    hits = decode_plates(maps_with(10, 12, (3, 5, 0.9), (8, 1, 0.2)), 0.3)
    np.testing.assert_allclose(hits.box_px, [[21 - 8, 14 - 4, 21 + 8, 14 + 4]])
    assert hits.score.tolist() == [0.9]
    assert hits.kind.tolist() == ["plate"]


def test_only_the_best_of_neighbouring_cells_counts_and_wild_sizes_are_cut() -> None:
    assert decode_plates(maps_with(10, 12, (3, 5, 0.9), (3, 6, 0.8), (4, 5, 0.7)), 0.3).score.tolist() == [0.9]
    wild = maps_with(10, 12, (3, 5, 0.9))
    wild[1:] = 1e6
    assert np.isfinite(decode_plates(wild, 0.3).box_px).all()
    assert np.ptp(decode_plates(wild, 0.3).box_px[0, [0, 2]]) <= 256


class Firing:
    """Stands for the network: a plate in one cell of the picture at some of its widths."""

    def __init__(self, *widths_px: int) -> None:
        self.widths_px = widths_px

    def __call__(self, values: "torch.Tensor") -> "torch.Tensor":
        rows, columns = (side // 4 for side in values.shape[2:])
        cells = [(rows // 2, columns // 2, 0.9)] if values.shape[3] in self.widths_px else []
        told = maps_with(rows, columns, *cells)
        told[0] = np.log((told[0] + 1e-9) / (1 - told[0] + 1e-9))
        return torch.from_numpy(told)[None].float()


class Agreeing:
    """Stands for the judge: a plate in every box, where it is."""

    def __call__(self, patches: "torch.Tensor") -> "torch.Tensor":
        return torch.tensor([[3.0, 0, 0, 0, 0]]).repeat(len(patches), 1)


@pytest.mark.parametrize(("widths", "side"), [((256,), 16), ((128,), 32), ((64,), 64)])
def test_a_hit_in_a_smaller_picture_is_drawn_large(monkeypatch, widths, side) -> None:
    monkeypatch.setattr(detectors, "_load_plate_networks", lambda _: (Firing(*widths), Agreeing(), "digest"))
    hits = PlateDetector()(np.zeros((250, 250, 3), dtype=np.uint8))  # padded to 256
    grown = max(side * detectors._PLATE_GROWTH, side + 2 * detectors._PLATE_MARGIN_PX)
    assert len(hits) == 1
    assert np.ptp(hits.box_px[0, [0, 2]]) == pytest.approx(grown)
    middle = (hits.box_px[0, :2] + hits.box_px[0, 2:]) / 2
    np.testing.assert_allclose(middle, 128 + np.array([0.25, 0.5]) * side / 4)


def test_a_plate_seen_at_two_sizes_is_one(monkeypatch) -> None:
    """A box of 16 x 8 and one of 32 x 16 pixels about it: the second is four times as large and stays alone."""
    monkeypatch.setattr(detectors, "_load_plate_networks", lambda _: (Firing(256, 128), Agreeing(), "digest"))
    assert len(PlateDetector()(np.zeros((256, 256, 3), dtype=np.uint8))) == 2
    monkeypatch.setattr(detectors, "_LARGER", 4.1)
    monkeypatch.setattr(detectors, "_INSIDE", 0.2)  # a quarter of the larger one lies in the smaller one
    (hit,) = PlateDetector()(np.zeros((256, 256, 3), dtype=np.uint8)).box_px
    assert np.ptp(hit[[0, 2]]) == pytest.approx(32 * detectors._PLATE_GROWTH, abs=1)


def test_parts_of_a_plate_become_one_box_and_others_stay_apart() -> None:
    boxes = np.array([[0.0, 0, 40, 10], [25, 0, 60, 10], [36, 0, 76, 10], [0, 0, 90, 40], [200, 0, 240, 10]])
    hits = merge_overlapping(ImageBoxes.of_kind("plate", boxes, np.array([0.9, 0.2, 0.15, 0.3, 0.12])))
    np.testing.assert_allclose(hits.box_px, [[0, 0, 60, 10], [0, 0, 90, 40], [200, 0, 240, 10]])
    np.testing.assert_allclose(hits.score, [0.9, 0.3, 0.12])
    assert len(merge_overlapping(ImageBoxes())) == 0


def test_a_patch_shows_a_box_at_one_size_and_keeps_its_place() -> None:
    """A ramp along the columns: the patch's middle is the box's, and its width 1.8 times the larger of w and 2 h."""
    ramp = torch.arange(128.0).expand(1, 3, 64, 128)
    box_px = torch.tensor([[40.0, 30, 60, 34], [60, 20, 64, 44]])
    patches = cut_patches(halved(ramp.contiguous(), 2), torch.zeros(2, dtype=torch.long), box_px)
    assert patches.shape == (2, 3, *PATCH_PX)
    middle, width = patches[:, 0, 20].mean(dim=1) + 0.5, patches[:, 0, 20, -1] - patches[:, 0, 20, 0]
    torch.testing.assert_close(middle, torch.tensor([50.0, 62.0]), rtol=0, atol=0.6)
    torch.testing.assert_close(width, torch.tensor([36.0, 86.4]) * 79 / 80, rtol=0, atol=1.1)
    two = cut_patches(halved(torch.cat([ramp * 0, ramp]), 2), torch.tensor([1, 1]), box_px)
    torch.testing.assert_close(two, patches)


def test_a_judge_moves_edges_and_gives_the_score() -> None:
    box_px, judged = torch.tensor([[10.0, 10, 30, 20]]), torch.tensor([[0.0, 0.5, 0.0, 0.6931472, 0.0]])
    torch.testing.assert_close(judged_boxes(box_px, judged.float()), torch.tensor([[10.0, 10, 50, 20]]))
    sizes = picture_sizes(np.zeros((50, 70, 3), dtype=np.uint8))
    assert [tuple(pixels.shape[2:]) for pixels in sizes] == [(64, 128), (32, 64), (16, 32)]
    hits = judge_plates(Agreeing(), sizes, ImageBoxes.of_kind("plate", box_px.numpy(), np.array([0.1])))
    assert hits.score[0] == pytest.approx(1 / (1 + np.exp(-3.0)))
    np.testing.assert_allclose(hits.box_px, box_px)
    assert not len(judge_plates(Agreeing(), sizes, ImageBoxes()))


@pytest.mark.parametrize(
    ("width", "height", "is_one"),
    [
        (520, 110, True),
        (180, 200, True),
        (180 * 0.26, 200, True),
        (24, 12, True),
        (700, 110, False),
        (30, 200, False),
        (12, 6, False),
    ],
)
def test_what_no_published_size_can_look_like_is_none(width: float, height: float, is_one: bool) -> None:
    assert PLATE_ASPECTS[0] < 1 < PLATE_ASPECTS[1]
    assert may_be_plate(ImageBoxes.of_kind("plate", np.array([[0.0, 0, width, height]]), np.ones(1)))[0] == is_one


class Answering:
    """A detector that says the same of all pictures."""

    kind = digest = ""

    def __init__(self, boxes: ImageBoxes) -> None:
        self.boxes = boxes

    def __call__(self, image: np.ndarray) -> ImageBoxes:
        return self.boxes


def test_what_touches_a_sure_face_is_no_plate() -> None:
    """Three plates: on a sure face, on a doubtful one, beside both; a detector of each kind."""
    faces = ImageBoxes.of_kind("face", np.array([[0.0, 0, 20, 20], [100, 0, 120, 20]]), np.array([0.9, 0.4]))
    plates = np.array([[0.0, 15, 60, 30], [100, 15, 160, 30], [0, 40, 60, 60]])
    finders = [Answering(faces), Answering(ImageBoxes.of_kind("plate", plates, np.full(3, 0.8)))]
    boxes = find_boxes(np.zeros((64, 200, 3), dtype=np.uint8), finders)
    np.testing.assert_allclose(boxes.box_px[boxes.kind == "plate"], plates[1:])
    assert (boxes.kind == "face").sum() == 2


def test_weights_come_back_in_half_precision(tmp_path: Path) -> None:
    torch.manual_seed(0)
    finder, judge = PlateNetwork().eval(), PlateJudge().eval()
    save_networks(tmp_path / "a.safetensors", finder, judge)
    finder_again, judge_again, digest = load_networks(tmp_path / "a.safetensors")
    image, patches = torch.rand(1, 3, 32, 48), torch.rand(2, 3, *PATCH_PX)
    with torch.no_grad():
        assert finder(image).shape == (1, 5, 8, 12)
        assert judge(patches).shape == (2, 5)
        torch.testing.assert_close(finder_again(image), finder(image), rtol=0, atol=0.02)
        torch.testing.assert_close(judge_again(patches), judge(patches), rtol=0, atol=0.02)
    assert len(digest) == 64
    assert (tmp_path / "a.safetensors").stat().st_size < MAX_BYTES


@pytest.mark.parametrize("damage", ["cut", "large", "shape", "missing", "infinite"])
def test_damaged_weights_are_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.safetensors"
    save_networks(path, PlateNetwork(), PlateJudge())
    data = path.read_bytes()
    tensors = safetensors.load(data)
    name = sorted(tensors)[0]
    if damage == "cut":
        path.write_bytes(data[:-10])
    elif damage == "large":
        path.write_bytes(data + b" " * MAX_BYTES)
    else:
        if damage == "missing":
            del tensors[name]
        else:
            tensors[name] = torch.zeros(3) if damage == "shape" else tensors[name] * torch.inf
        path.write_bytes(safetensors.save(tensors))
    with pytest.raises(FileFormatError, match=r"a\.safetensors"):
        load_networks(path)


def test_a_flipped_bit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    save_networks(path, PlateNetwork(), PlateJudge())
    data = bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="digest"):
        load_networks(path)


def test_missing_weights_are_said_in_words(tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(FarfieldError, match=r"expected the plate networks' weights"):
        PlateDetector(weights=tmp_path / "none.safetensors")
    monkeypatch.setattr(detectors, "_PLATE_WEIGHTS", tmp_path / "none.safetensors")
    assert "which this installation lacks" in AnonymizeOptions().without_plates()
    assert not AnonymizeOptions(plates=False).without_plates()


def car_with_plate(text: str = "AB 123 CD") -> tuple[np.ndarray, np.ndarray]:
    """A grey car's rear with lamps and a plate, 320 x 240, and the plate's box."""
    image = Image.new("RGB", (320, 240), (96, 100, 104))
    pen = ImageDraw.Draw(image)
    pen.rectangle((0, 170, 320, 240), fill=(60, 60, 64))
    pen.rectangle((70, 60, 250, 200), fill=(120, 30, 36))
    pen.rectangle((90, 68, 230, 110), fill=(30, 36, 44))
    for left in (74, 222):
        pen.rectangle((left, 118, left + 24, 134), fill=(220, 40, 40))
    pen.rectangle((122, 146, 198, 162), fill=(238, 238, 232), outline=(20, 20, 20))
    pen.text((160, 154), text, fill=(10, 10, 14), font=font(13), anchor="mm")
    return np.array(image), np.array([122.0, 146.0, 199.0, 163.0])


def font(size: int) -> ImageFont.FreeTypeFont:
    import matplotlib

    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans-Bold.ttf"), size)


def test_the_shipped_network_finds_a_plate_at_several_sizes_and_none_on_grey() -> None:
    assert not detectors.why_no_plates()
    image, box = car_with_plate()
    for factor in (0.5, 1.0, 2.0, 3.0):
        size = (round(320 * factor), round(240 * factor))
        drawn = np.array(Image.fromarray(image).resize(size, Image.Resampling.BICUBIC))
        hits = PlateDetector()(drawn)
        assert covered_share(box_mask(hits, *size), box * factor) >= 0.9, factor
        assert box_mask(hits, *size).mean() < 0.06, factor
    assert not len(PlateDetector()(np.full((200, 300, 3), 120, dtype=np.uint8)))


CANDIDATES, TRIALS = 200, 600


def reading(seen: np.ndarray, templates: np.ndarray) -> int:
    """The candidate whose picture is most like what is seen."""
    return int(np.argmin(((templates - seen) ** 2).reshape(len(templates), -1).mean(axis=1)))


@pytest.mark.parametrize("how", ["pixelate", "blur", "fill"])
def test_a_covered_plate_cannot_be_read_by_trying_strings(rng, how) -> None:
    """The attacker knows font, place, light and way of covering, and tries all of 200 strings (chance 0.5 %)."""
    words = ["".join(rng.choice(list("ABCDEFGHKLMNPRSTUVWXYZ0123456789"), 7)) for _ in range(CANDIDATES)]
    plates_drawn = []
    for word in words:
        drawn = Image.new("RGB", (140, 34), (236, 236, 230))
        ImageDraw.Draw(drawn).text((70, 17), word, fill=(16, 16, 20), font=font(24), anchor="mm")
        plates_drawn.append(np.array(drawn))
    hits = ImageBoxes.of_kind("plate", np.array([[0.0, 0.0, 140.0, 34.0]]), np.ones(1))
    clear, rough = np.stack(plates_drawn).astype(float), (slice(None), slice(None, None, 8), slice(None, None, 7))
    before = after = 0
    model = np.stack([cover_boxes(each, hits, how, np.random.default_rng(0)) for each in plates_drawn]).astype(float)
    for trial in range(TRIALS):
        truth = int(rng.integers(CANDIDATES))
        seen = (clear[truth] + rng.normal(0, 25.0, clear[truth].shape)).clip(0, 255).astype(np.uint8)
        hidden = cover_boxes(seen, hits, how, np.random.default_rng([trial, 1])).astype(float)
        before += reading(seen[None][rough][0].astype(float), clear[rough]) == truth
        after += reading(hidden[None][rough][0], model[rough]) == truth
    assert before / TRIALS >= 0.8
    assert after / TRIALS <= 1 / CANDIDATES + 0.02
