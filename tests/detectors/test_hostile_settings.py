"""Settings and checkpoints from strangers: no detector divides by zero, grows without bound or computes for minutes."""

import io
import json
import time
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")

import their_forward as their
from pydantic import ValidationError

from farfield.detectors import DETECTORS
from farfield.detectors.openpcdet import import_openpcdet
from farfield.detectors.torch_files import load_torch
from farfield.errors import FarfieldError, FileFormatError


@pytest.mark.parametrize("name", sorted(DETECTORS))
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("grid", "cell_m"), 0),
        (("grid", "cell_m"), 1e-200),
        (("grid", "cell_m"), 1e200),
        (("grid", "cell_m"), [1e-200, 1e-200, 0.1]),
        (("grid", "range_m"), 1e308),
        (("grid", "range_m"), -1),
        (("grid", "z_max_m"), -1e9),
        (("widths",), []),
        (("widths",), [1] * 100_000),
        (("depths",), []),
        (("strides",), [16] * 6),
        (("strides",), [0, 0, 0]),
        (("out_stride",), 1 << 40),
        (("out_stride",), 3),
        (("pyramid_widths",), []),
        (("pyramid_widths",), [1] * 5000),
        (("vfe_widths",), [2] * 5000),
        (("anchors",), {}),
        (("anchors",), {f"class {n}": {"size_m": [4, 2, 1.5], "z_m": 0} for n in range(5000)}),
        (("anchors",), {"a": {"size_m": [1e-9, 2, 1.5], "z_m": 0}}),
        (("anchors",), {"a": {"size_m": [4, 2, 1e9], "z_m": 0}}),
    ],
)
def test_settings_that_no_network_has_are_refused(name: str, path: tuple[str, ...], value: Any) -> None:
    config = DETECTORS[name].config_class
    tree = json.loads(config().model_dump_json())
    holder = tree
    for key in path[:-1]:
        holder = holder.get(key, {})
    if path[-1] not in holder:
        pytest.skip(f"{name} has no {'.'.join(path)}")
    holder[path[-1]] = value
    if value == 3 and max(json.loads(config().model_dump_json())["strides"]) == 1:
        pytest.skip("any output fits")
    began = time.process_time()
    with pytest.raises(ValidationError):
        config.model_validate(tree)
    assert time.process_time() - began < 2


def test_blocks_of_different_numbers_and_gigantic_images_are_refused() -> None:
    config = DETECTORS["pointpillars"].config_class
    for settings, fault in (
        ({"widths": (8, 8)}, "1 to 8 widths"),
        ({"widths": (8,) * 9, "depths": (1,) * 9, "strides": (1,) * 9, "out_stride": 1}, "1 to 8 widths"),
        ({"strides": (16, 16, 16)}, "multiply to at most 1024"),
        ({"out_stride": 3}, "divides"),
        ({"grid": {"range_m": 2000, "half_width_m": 1000, "cell_m": 0.3}}, "an image of at most"),
    ):
        with pytest.raises(ValidationError, match=fault):
            config(**settings)


NORM, BLOCK, NECK = (
    "vfe.pfn_layers.0.norm.weight",
    "backbone_2d.blocks.0.1.weight",
    "backbone_2d.deblocks.0.0.weight",
)


class _Hoard:
    """A pickle that asks for 100 GB."""

    def __reduce__(self) -> tuple[Any, ...]:
        return bytearray, (10**11,)


@pytest.mark.parametrize(
    ("key", "make", "fault"),
    [
        (NORM, lambda: torch.empty(64, device="meta"), "a tensor without numbers"),
        (NORM, lambda: torch.rand(64).to_sparse(), "a sparse or nested tensor"),
        (BLOCK, lambda: torch.rand(64, 9).to_sparse_csr(), "a sparse or nested tensor"),
        (NORM, lambda: torch.rand(1).expand(2_000_000_000), r"shape \(2000000000,\) that repeats 4 bytes"),
        (BLOCK, lambda: torch.rand(1).expand(64, 64, 20_000, 20_000), "that repeats 4 bytes"),
        ("dense_head.anchors", lambda: torch.rand(1).expand(10**12), "that repeats 4 bytes"),
        (NORM, lambda: torch.rand(64, dtype=torch.complex64), "a tensor of complex64"),
        (NORM, lambda: torch.ones(64).to(torch.float8_e4m3fn), "a tensor of float8_e4m3fn"),
        (NORM, lambda: torch.ones(64).to(torch.uint64), "a tensor of uint64"),
        (NECK, lambda: torch.rand(4, 4, 0, 0), r"expected numbers, got none, of shape \(4, 4, 0, 0\)"),
        ("backbone_2d.deblocks.1.0.weight", lambda: torch.rand(4, 4, 0, 0), "expected numbers, got none"),
        ("backbone_2d.blocks.0." + "9" * 5000, lambda: torch.rand(1), "unknown: backbone_2d.blocks.0.999"),
        ("backbone_2d.blocks.0.999999999.weight", lambda: torch.rand(1), "unknown: backbone_2d.blocks.0.999"),
        ("backbone_2d.blocks.5.x", lambda: torch.rand(1), "backbone_2d.blocks.5.1.weight"),
        ("\ud800", lambda: torch.rand(1), "a name that is no text"),
        ("hoard", _Hoard, "an array of bytes"),
    ],
)
def test_tensors_that_no_weights_are_made_of_are_refused(
    tmp_path: Path, key: str, make: Callable[[], Any], fault: str
) -> None:
    path = tmp_path / "their.pth"
    with warnings.catch_warnings(action="ignore"):  # of kinds of tensors that are new
        torch.save({"model_state": {**their.pillar_weights(), key: make()}}, path)
    began = time.process_time()
    with pytest.raises(FarfieldError, match=fault):
        import_openpcdet(path)
    assert time.process_time() - began < 5


def test_quantized_numbers_are_refused(tmp_path: Path) -> None:
    with warnings.catch_warnings(action="ignore"):
        torch.save({"a": torch.quantize_per_tensor(torch.rand(64), 0.1, 0, torch.qint8)}, tmp_path / "a.pth")
    with pytest.raises(FileFormatError, match="a tensor of qint8 at 'a'"):
        load_torch(tmp_path / "a.pth", expected="weights", fix="Save them.")


def test_what_shares_its_numbers_is_counted(tmp_path: Path) -> None:
    """Ten thousand views of a megabyte are not ten gigabytes; the same tensor twice is one."""
    tensor, path = torch.rand(1 << 18), tmp_path / "a.pth"
    torch.save({str(number): tensor for number in range(10_000)}, path)
    assert len(load_torch(path, expected="weights", fix="Save them.")) == 10_000
    torch.save({str(number): tensor[1:] for number in range(1000)}, path)
    with pytest.raises(FileFormatError, match="more than the file holds"):
        load_torch(path, expected="weights", fix="Save them.")
    laughs: list[Any] = [1]
    for _ in range(60):
        laughs = [laughs, laughs]
    torch.save({"optimizer": laughs}, path)
    assert "optimizer" in load_torch(path, expected="weights", fix="Save them.")


def test_a_packed_archive_is_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    torch.save({"a": torch.zeros(1 << 20)}, buffer)
    with zipfile.ZipFile(buffer) as stored, zipfile.ZipFile(tmp_path / "a.pth", "w", zipfile.ZIP_DEFLATED) as packed:
        for member in stored.namelist():
            packed.writestr(member, stored.read(member))
    with pytest.raises(FileFormatError, match="compressed numbers at"):
        load_torch(tmp_path / "a.pth", expected="weights", fix="Save them.")


def test_an_archive_that_python_cannot_open_is_refused(tmp_path: Path) -> None:
    """Deflated members of a version that zipfile does not read: torch would unpack them unseen."""
    torch.save({"a": torch.zeros(8)}, tmp_path / "whole.pth")
    data = bytearray((tmp_path / "whole.pth").read_bytes())
    at = data.index(b"PK\x01\x02")
    data[at + 6] = 64
    (tmp_path / "other.pth").write_bytes(data)
    with pytest.raises(FileFormatError, match="cannot be opened"):
        load_torch(tmp_path / "other.pth", expected="a checkpoint", fix="")


@pytest.mark.parametrize("packed", [True, False])
def test_memory_that_a_pickle_asks_for_by_a_number_is_refused(tmp_path: Path, packed: bool) -> None:
    torch.save({"a": torch.zeros(8)}, tmp_path / "whole.pth")
    blank = b"\x80\x02cbuiltins\nbytearray\n" + b"\x8a\x05" + (30_000_000_000).to_bytes(5, "little") + b"\x85R."
    if packed:
        with zipfile.ZipFile(tmp_path / "whole.pth") as old, zipfile.ZipFile(tmp_path / "blank.pth", "w") as new:
            for name in old.namelist():
                new.writestr(name, blank if name.endswith("data.pkl") else old.read(name))
    else:
        (tmp_path / "blank.pth").write_bytes(blank)
    with pytest.raises(FileFormatError, match="an array of bytes"):
        load_torch(tmp_path / "blank.pth", expected="a checkpoint", fix="")
