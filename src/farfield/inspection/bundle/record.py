"""The record of a bundle: what it says, as JSON that a person can read, and read back without trust."""

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from farfield.errors import FileFormatError
from farfield.files.json_text import parse_json
from farfield.files.limits import open_file

MAX_BUNDLE_BYTES = 1_000_000
"""Of a bundle, which is to be sent by mail."""
BUNDLE_VERSION = 1
_MARK = b'"farfield_bundle"'


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class FileForm(_Part):
    """A form that files of a group have: what it is, how many of those that were looked at, and some of them."""

    form: str
    files: int
    examples: tuple[str, ...] = ()


class FileFault(_Part):
    """A file that a reader refuses, and why."""

    file: str
    fault: str


class FileGroup(_Part):
    """The files of one suffix in one folder.

    Args:
        folder: The folder, from the data set's root on; ``.`` for itself.
        suffix: Their suffix.
        files: How many there are.
        bytes: Least, median and largest size.
        first: Name of the first one.
        last: Name of the last one.
        looked_at: How many were looked into.
        forms: Their forms, the most frequent first.
        figures: Least and largest of what is each file's own, such as its points.
        ranges: Least and largest number of each column, over those that were looked at.
        faults: Those that a reader refuses.
        odd_sizes: Files of another size where most have one, or that are no whole number of records.
        record_bytes: Bytes of a record of which most files' sizes are whole multiples; 0 where there is none.
    """

    folder: str
    suffix: str
    files: int
    bytes: tuple[int, int, int]
    first: str = ""
    last: str = ""
    looked_at: int = 0
    forms: tuple[FileForm, ...] = ()
    figures: dict[str, tuple[int | float, int | float]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    faults: tuple[FileFault, ...] = ()
    odd_sizes: tuple[str, ...] = ()
    record_bytes: int = 0


class GroupPair(_Part):
    """Two groups whose files bear the same names.

    Args:
        one: Folder and suffix of the larger.
        other: Folder and suffix of the smaller.
        both: Names that both have.
        only_one: How many only the larger has.
        only_other: How many only the smaller has.
        examples: Some of those.
    """

    one: str
    other: str
    both: int
    only_one: int
    only_other: int
    examples: tuple[str, ...] = ()


class BundleFinding(_Part):
    """A finding of the doctor on the data themselves."""

    severity: Literal["ok", "open", "warn", "fail"]
    topic: str
    what: str
    where: str = ""
    fix: str = ""


class Bundle(_Part):
    """What a data set is like, without its data.

    Args:
        farfield_bundle: Version of this record.
        read_me: What the file is, for whoever is asked to send it.
        farfield: Version of Farfield that wrote it.
        format: Format of the data set; empty where it was not recognised.
        masked: Whether names of files and stamps are masked.
        error: Why the data set could not be opened or examined; empty where it could.
        remarks: What its reader left out or took for granted.
        findings: The doctor's.
        facts: The doctor's figures: frames, classes, stamps.
        groups: The listing.
        pairs: Groups of the same names that do not match.
        left_out: What was left out for the file's size, or because there was too much.
    """

    farfield_bundle: int
    read_me: tuple[str, ...] = ()
    farfield: str = ""
    format: str = ""
    masked: bool = False
    error: str = ""
    remarks: tuple[str, ...] = ()
    findings: tuple[BundleFinding, ...] = ()
    facts: dict[str, Any] = {}
    groups: tuple[FileGroup, ...] = ()
    pairs: tuple[GroupPair, ...] = ()
    left_out: tuple[str, ...] = ()


def is_bundle(path: Path) -> bool:
    """Whether a file says of itself that it is a bundle."""
    with open_file(path, max_bytes=None) as handle:
        return _MARK in handle.read(200)


def read_bundle(path: Path) -> Bundle:
    """Read a bundle back.

    Args:
        path: The file that :func:`~farfield.inspection.bundle.write_bundle` wrote.

    Raises:
        FileFormatError: If it is larger than :data:`MAX_BUNDLE_BYTES`, damaged, or no bundle.
    """
    with open_file(path, max_bytes=MAX_BUNDLE_BYTES) as handle:
        tree = parse_json(handle.read(), path)
    try:
        bundle = Bundle.model_validate(tree)
    except ValidationError as error:
        where = ".".join(str(step) for step in error.errors()[0]["loc"]) or "the file"
        raise FileFormatError(
            path, where=where[:200], expected="a bundle of farfield doctor", got="another value"
        ) from error
    if bundle.farfield_bundle != BUNDLE_VERSION:
        expected, got = f"a bundle of version {BUNDLE_VERSION}", f"{bundle.farfield_bundle}"
        raise FileFormatError(path, where="farfield_bundle", expected=expected, got=got, fix="Update farfield.")
    return bundle
