"""Reading a file of claims, with the hash of its bytes."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from pydantic import ValidationError

from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.papers.claims.schema import Claim, ClaimRun, Document, Metric

_FOLDER = Path(__file__).resolve().parent
_MAX_BYTES = 1 << 20
CLAIMS = ("cirrus", "kradar")
"""Names of the shipped files of claims."""


@dataclass(frozen=True, kw_only=True)
class Claims:
    """The claims of a paper.

    Args:
        document: What the file declares.
        sha256: Hash of the file's bytes: claims that were changed after a run have another.
        path: The file.
    """

    document: Document
    sha256: str
    path: Path

    def __iter__(self) -> Iterator[Claim]:
        return iter(self.document.claims)

    def __len__(self) -> int:
        return len(self.document.claims)

    def __getitem__(self, claim: str) -> Claim:
        found = {each.id: each for each in self.document.claims}
        if claim not in found:
            raise ConfigError(f"claim: expected one of {', '.join(found)}; got {claim!r}")
        return found[claim]

    @property
    def paper(self) -> str:
        """``"cirrus"`` or ``"kradar"``."""
        return self.document.paper

    @property
    def metrics(self) -> dict[str, Metric]:
        """What is measured, by name."""
        return self.document.metrics

    @property
    def runs(self) -> dict[str, ClaimRun]:
        """The trainings of the grid, by name."""
        return self.document.runs


def load(name_or_path: str | Path) -> Claims:
    """Read claims: the shipped ones by name, or a file.

    Args:
        name_or_path: ``"cirrus"``, ``"kradar"`` or the path of a YAML file.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it declares something that is not there or cannot be decided.
    """
    path = _FOLDER / f"{name_or_path}.yaml" if name_or_path in CLAIMS else Path(name_or_path)
    if not path.is_file():
        raise ConfigError(f"claims: expected one of {', '.join(CLAIMS)} or a YAML file, got {name_or_path!s}")
    data = read_bytes(path, max_bytes=_MAX_BYTES)
    try:
        document = Document.model_validate(yaml.safe_load(data.decode("utf-8")))
    except ValidationError as error:
        raise FileFormatError(path, where="keys", expected="declared claims", found=plain(error)) from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise FileFormatError(path, where="the file", expected="YAML", found=plain(error)) from None
    return Claims(document=document, sha256=hashlib.sha256(data).hexdigest(), path=path)
