"""Simulated K-Radar as its users have it: archives by modality, one of them empty, one cut."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

CUT_BYTES = 2000


def pack(path: Path, root: Path, patterns: Iterable[str], *, below: str = "") -> None:
    """Pack some files of a tree, by their names from ``below`` on."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for pattern in patterns:
            for file in sorted(root.glob(pattern)):
                if file.is_file():
                    archive.write(file, file.relative_to(root / below).as_posix())


def pack_downloads(tree: Path, folder: Path) -> Path:
    """Pack a tree of two sequences by modality: the sweeps of the first are cut, those of the second an empty file.

    Args:
        tree: The tree, as ``farfield simulate kradar-sim`` writes it.
        folder: Folder of the archives, made here.
    """
    folder.mkdir(parents=True)
    first, second = sorted(path.name for path in tree.iterdir() if path.name.isdigit())
    beside = ("info_calib/*", "info_label/*", "description.txt")
    pack(folder / "rdr_polar_3d.zip", tree, ("rdr_polar_3d/*/*",))
    pack(folder / f"{first}.zip", tree, [f"{first}/{name}" for name in ("radar_tesseract/*", *beside)], below=first)
    pack(folder / f"{second}_meta.zip", tree, [f"{second}/{name}" for name in beside])
    if any(tree.glob(f"{second}/radar_tesseract/*")):
        below = f"{second}/radar_tesseract"
        pack(folder / f"{second}_missing_tesseract.zip", tree, (f"{below}/*",), below=below)
    pack(folder / "revised_labels.zip", tree, ("kradar_revised_label*/**/*.txt",))
    pack(folder / f"{first}_lpc.zip", tree, (f"{first}/os2-64/*",))
    (folder / f"{first}_lpc.zip").write_bytes((folder / f"{first}_lpc.zip").read_bytes()[:CUT_BYTES])
    (folder / f"{second}_lpc.zip").write_bytes(b"")
    return folder
