"""All published label files of K-Radar v2.1 opened and saved again by the studio: the same bytes but for the edit."""

import hashlib
import tarfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from edited_drives import ANN

from farfield.annotation.edits import set_box
from farfield.annotation.saving import save_copy, save_in_place
from farfield.annotation.schema import schema_of
from farfield.annotation.store import Store, undo
from farfield.datasets.edits import journal_folder
from farfield.datasets.kradar.label_format import KRadarLabelFormat
from farfield.datasets.kradar.reader import KRadar
from farfield.vocabulary.classes import SMALL_KINDS, VEHICLE_KINDS


def _unpacked(real: Path, root: Path, *, every: int = 1) -> dict[str, str]:
    """Unpack the label files (some sequences of them); the digest of each by its name."""
    found = {}
    with tarfile.open(real / "kradar" / "labels_v2_1.tar.gz") as archive:
        for member in archive:
            parts = Path(member.name).parts
            if not member.isfile() or (every > 1 and int(parts[-2]) % every):
                continue
            file = archive.extractfile(member)
            assert file is not None
            data = file.read()
            path = root / "KRadar_revised_visibility" / Path(*parts[-2:])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            found["/".join(parts[-2:])] = hashlib.sha256(data).hexdigest()
    return found


def _digests(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*.txt") if ".farfield-studio" not in path.parts)
    return {"/".join(path.parts[-2:]): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _opened(root: Path) -> Store:
    data = KRadar(root)
    return Store(
        data, KRadarLabelFormat(data), journal_folder(root), schema_of(VEHICLE_KINDS | SMALL_KINDS, None, "full")
    )


def _saved_again(real: Path, tmp_path: Path, every: int) -> int:
    """Saves all files anew, moves five boxes and takes that back; the number of files that came back to the byte."""
    root = tmp_path / "data"
    before = _unpacked(real, root, every=every)
    with _opened(root) as store:
        assert len(store.keys) == len(before)
        save_copy(store, ANN, "s0", tmp_path / "copy")
        assert _digests(tmp_path / "copy") == before
        assert len(KRadar(tmp_path / "copy")) == len(before)  # a data set of its own: sequences in their folders
        rng = np.random.default_rng(1)
        with_boxes = [key for key in store.keys if store.rows(key)]
        for number, place in enumerate(rng.choice(len(with_boxes), 5, replace=False).tolist()):
            key = with_boxes[place]
            path = store.files.path_of[key]
            old = path.read_bytes().split(b"\n")
            row = store.rows(key)[-1]
            value = {"box": [row.label.box[0] + 0.5, *row.label.box[1:]]}
            plan = partial(set_box, key=key, name=row.label.id, base=row.version, value=value)
            store.edit(ANN, f"e{number}", "box.set", plan)
            assert save_in_place(store, ANN, f"s{number + 1}").files == (path,)
            changed = [pair for pair in zip(old, path.read_bytes().split(b"\n"), strict=True) if pair[0] != pair[1]]
            assert len(changed) == 1
        differ = {name for name, digest in _digests(root).items() if digest != before[name]}
        assert len(differ) == 5
        for number in range(5):
            undo(store, ANN, f"u{number}")
        save_in_place(store, ANN, "s9")
    assert _digests(root) == before
    return len(before)


def test_one_sequence_opened_and_saved_again(shared_real: Path, tmp_path: Path) -> None:
    assert _saved_again(shared_real, tmp_path, 58) == 598


@pytest.mark.slow
@pytest.mark.whole
def test_all_sequences_opened_and_saved_again(shared_real: Path, tmp_path: Path) -> None:
    assert _saved_again(shared_real, tmp_path, 1) == 34_994
