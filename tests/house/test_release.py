"""The checks before a release: the changelog's form, and the packages of an extra."""

import subprocess
import sys
from pathlib import Path

import pytest
from platforms import APART, extras, needed, pins
from release_check import SMOKE, FailedCheckError, changelog_sections, readme_blocks

ROOT = Path(__file__).resolve().parents[2]


def test_the_changelog_has_its_form() -> None:
    assert "Unreleased" in changelog_sections((ROOT / "CHANGELOG.md").read_text("utf-8"))
    text = "# Changelog\n\n## [Unreleased]\n\n### Added\n\n## [0.2.0] - 2026-12-01\n\n## [0.1.0] - 2026-11-01\n"
    assert changelog_sections(text) == ["Unreleased", "0.2.0", "0.1.0"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("## 0.1.0\n", "expected ## "),
        ("## [0.1.0]\n", "expected ## "),
        ("## [Unreleased] - 2026-12-01\n", "expected ## "),
        ("## [0.1.0] - soon\n", "expected ## "),
        ("### New\n", "expected a heading of Added"),
        ("## [0.1.0] - 2026-11-01\n## [0.2.0] - 2026-12-01\n", "newest version first"),
    ],
)
def test_a_changelog_of_another_form_is_refused(text: str, words: str) -> None:
    with pytest.raises(FailedCheckError, match=words):
        changelog_sections(text)


def test_each_extra_has_a_line_that_tries_it() -> None:
    assert set(SMOKE) == set(extras())
    assert readme_blocks()


def test_an_extra_needs_what_its_packages_need_and_all_is_pinned() -> None:
    groups = {name: needed(texts) for name, texts in extras().items() if name not in APART}
    assert {"numpy", "pydantic-core"} <= groups[""]
    assert {"torch", "onnxruntime", "protobuf"} <= groups["export"]
    assert "torch" not in groups["onnx"]
    others = set().union(*(group for name, group in groups.items() if name not in ("", "all")))
    assert groups["all"] == others
    assert groups["all"] | groups[""] <= pins().keys()


@pytest.mark.slow
@pytest.mark.parametrize("extra", sorted(set(SMOKE)))
def test_the_line_of_an_extra_runs_where_its_packages_are(extra: str, tmp_path: Path) -> None:
    """The release check runs each in an environment of its own: one failed there after half an hour."""
    done = subprocess.run(
        [sys.executable, "-c", SMOKE[extra]], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    if "No module named" in done.stderr and "No module named 'farfield" not in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
