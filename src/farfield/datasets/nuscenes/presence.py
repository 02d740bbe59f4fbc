"""Which files of the nuScenes schema are there: archives are unpacked one by one, and many hold but some scenes."""

from pathlib import Path, PurePosixPath

from farfield.datasets.nuscenes.dialects import TableFolder
from farfield.errors import DatasetError, FileFormatError

_PARTS = {
    "v1.0-trainval": "of nuScenes one of v1.0-trainval01_blobs to v1.0-trainval10_blobs",
    "v1.0-test": "of nuScenes v1.0-test_blobs",
}


def path_within(root: Path, name: str, *, table: Path, where: str, column: str) -> Path:
    """The place of a file that a table names, whose text must not lead out of the folder.

    Links on the disk are their owner's: files and folders may be links to wherever they are kept, as in the caches of
    Hugging Face, DVC and git-annex.

    Args:
        root: The data set's folder.
        name: What the table says.
        table: The table.
        where: The record.
        column: The column.

    Raises:
        FileFormatError: If the text is no relative path within the folder.
    """
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name:
        expected = f"{column} to be a path within the data set"
        raise FileFormatError(table, where=where, expected=expected, got=repr(name)[:80])
    return root / path


def check_there(path: Path, folder: TableFolder) -> None:
    """Refuse a file that is not there, with what to unpack.

    Args:
        path: The file.
        folder: Where the data set stands.

    Raises:
        DatasetError: If the file is not there, or is a link that leads nowhere or to itself.
    """
    if path.exists():
        return
    link = next((step for step in (path, *path.parents) if step.is_symlink() and not step.exists()), None)
    if link is not None:
        raise DatasetError(
            f"{path}: expected a file, got a link that leads nowhere{'' if link == path else f' ({link})'}: fetch what "
            "it stands for (git annex get, dvc pull, huggingface-cli download), or copy the file there"
        )
    if path.exists():
        raise DatasetError(
            f"{path}: expected a regular file, got {'a folder' if path.is_dir() else 'a device or pipe'}"
        )
    raise DatasetError(f"{path}: expected a file that the tables name, found none. {what_to_unpack(path, folder)}")


def what_to_unpack(path: Path, folder: TableFolder) -> str:
    """Which archive holds a missing file, and what goes without it, as one sentence without a full stop."""
    channel = path.relative_to(folder.root).parent.as_posix()
    parts = _PARTS.get(folder.version)
    archive = "the archive that holds it" if parts is None else f"the archive that holds it ({parts})"
    sweeps = ", or read key frames alone (sweeps=1)" if channel.split("/")[0] == "sweeps" else ""
    return f"Unpack {archive}, so that {channel} stands in {folder.root}{sweeps}"


def far_apart(count: int, first: int) -> dict[int, None]:
    """All indices in an order in which the first ones are spread over the whole.

    Args:
        count: Number of indices.
        first: How many there are about at the largest distance.
    """
    step = max(1, count // first)
    order = dict.fromkeys(range(0, count, step)[:first])
    while step > 1:
        step = max(1, step // 16)
        order |= dict.fromkeys(range(0, count, step))
    return order | dict.fromkeys(range(count))
