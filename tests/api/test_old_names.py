"""Public names of before work for one version, with a warning."""

import importlib

import pytest

import farfield as ff
from farfield._old_paths import HOMES

OLD = [
    ("farfield", "joined", "merge_clouds"),
    ("farfield", "moved", "transform_frame"),
    ("farfield", "dataset", "register_dataset"),
    ("farfield.datasets.edits", "Change", "CellEdit"),
    ("farfield.detectors", "Kind", "DetectorSpec"),
    ("farfield.jobs", "Bulk", "JobOptions"),
    ("farfield.privacy", "Private", "Anonymized"),
]


@pytest.mark.parametrize(("module", "old", "new"), OLD)
def test_an_old_name_works_and_warns(module: str, old: str, new: str) -> None:
    home = importlib.import_module(module)
    with pytest.warns(DeprecationWarning, match=new):
        assert getattr(home, old) is getattr(home, new)
    with pytest.raises(AttributeError, match="no_such_name"):
        home.no_such_name  # noqa: B018


@pytest.mark.parametrize("old", HOMES)
def test_an_old_path_works_and_warns(old: str) -> None:
    module, _, name = old.rpartition(".")
    today, _, attribute = HOMES[old].partition(":")
    home = importlib.import_module(module)
    with pytest.warns(DeprecationWarning, match=f"{today}.{attribute}"):
        assert getattr(home, name) is getattr(importlib.import_module(today), attribute)
    with pytest.raises(ImportError, match="no_such_name"):
        exec(f"from {module} import no_such_name")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("farfield.no_such_module")


def test_an_old_keyword_works_and_warns() -> None:
    detections = ff.Detections(boxes={}, annotations={})
    with pytest.warns(DeprecationWarning, match="detections"):
        tracks = ff.track(found=detections)
    assert tracks.boxes == ff.track(detections).boxes
