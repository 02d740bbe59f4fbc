"""A paper's claims: rows of a table, what is compared of them, what the paper published; and how they are read."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from farfield.errors import ConfigError, FileFormatError, plain
from farfield.files.atomic import read_bytes
from farfield.files.yaml_text import MAX_BYTES, plain_yaml
from farfield.metrics.deciding import Hypothesis, Scalar, figure
from farfield.metrics.deciding.decision import Kind
from farfield.vocabulary.published_tables import OVERALL, PUBLISHED_TABLES, PublishedTable

_FOLDER = Path(__file__).resolve().parent
CLAIMS = ("cirrus", "kradar")
"""Names of the shipped files of claims."""
BUDGETS = ("laptop", "desk", "workstation", "gpu")
Budget = Literal["laptop", "desk", "workstation", "gpu"]


class DeclaredModel(BaseModel):
    """A part of a file that is declared before anything is run: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Metric(DeclaredModel):
    """What is measured: a figure of a protocol, or a statistic of the data."""

    words: str
    protocol: str = ""
    figure: str = Field("", description="name of the figure in the protocol's result")
    statistic: str = Field("", description="a statistic of the data, which needs no detector")

    @model_validator(mode="after")
    def _one_kind(self) -> "Metric":
        if bool(self.statistic) == bool(self.protocol) or bool(self.protocol) != bool(self.figure):
            raise ValueError("expected a protocol with a figure, or a statistic")
        return self


class ClaimRun(DeclaredModel):
    """A training of the grid, once a seed."""

    words: str
    least_budget: Budget = Field("laptop", description="smallest budget that runs it")


class ClaimSide(DeclaredModel):
    """One side of a comparison."""

    run: str = Field("", description="the training; none for a statistic of the data")
    cloud: str = Field("", description="the cloud that it is scored on, where there are several")
    part: str = Field(OVERALL, description="the part of the result: overall, near, weather/fog")
    minus: str = Field("", description="a part that is subtracted: what is lost from one to the other")
    metric: str = Field("", description="its metric if not that of the claim")
    matched: bool = Field(False, description="frames weighed so that both parts have as many objects a frame")
    published: str = Field("", description="table and row of the paper: 'I gaussian'")

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of the result that it takes."""
        return (self.part, self.minus) if self.minus else (self.part,)

    def scalar(self, metric: Metric, parts: dict[str, str] | None = None) -> Scalar:
        """The number that is compared, of a result of the metric's protocol.

        Args:
            metric: The metric.
            parts: What the result calls the parts: ``{"near": "0-70"}``; others keep their names.
        """
        names = [(parts or {}).get(part, part) for part in self.parts]
        scalar = figure(metric.figure, names[0])
        return scalar - figure(metric.figure, names[1]) if self.minus else scalar

    def figure_published(self, paper: str, metric: str) -> float | None:
        """The paper's figure; None where it prints none."""
        if not self.published:
            return None
        table, row = _address(paper, self.published)
        values = [table.at(row, part, self.metric or metric) for part in self.parts]
        if any(value is None for value in values):
            return None
        return sum(sign * (value or 0.0) for sign, value in zip((1, -1), values, strict=False))


class Comparison(DeclaredModel):
    """Two rows, of which the first is claimed to lie above the second unless ``kind`` says otherwise."""

    a: ClaimSide
    b: ClaimSide
    kind: Kind = "above"
    margin: float = Field(0.0, ge=0)
    excludes: str = Field("", description="of a control: what explains the difference if this one does not hold")
    paper: str = Field("", exclude=True)

    @model_validator(mode="after")
    def _can_be_decided(self) -> "Comparison":
        try:
            _ = self.hypothesis
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def hypothesis(self) -> Hypothesis:
        """What is claimed of the difference."""
        return Hypothesis(kind=self.kind, margin=float(self.margin))

    def published(self, metric: str) -> float | None:
        """The paper's difference A - B; None where the paper does not print both."""
        values = [row.figure_published(self.paper, metric) for row in (self.a, self.b)]
        return None if values[0] is None or values[1] is None else values[0] - values[1]


class Claim(DeclaredModel):
    """One claim of a paper: it holds where each of its comparisons does."""

    id: str
    words: str
    table: str = Field(description="the paper's table or figure")
    metrics: tuple[str, ...] = Field(min_length=1, description="the first decides, the others stand beside it")
    comparisons: tuple[Comparison, ...] = Field(min_length=1)
    controls: tuple[Comparison, ...] = Field((), description="what stands beside: the same without the claimed cause")
    by_construction: bool = Field(False, description="whether the metric's definition alone makes it hold")
    note: str = ""

    @property
    def pairs(self) -> tuple[Comparison, ...]:
        """Its comparisons, then its controls."""
        return (*self.comparisons, *self.controls)

    @property
    def runs(self) -> tuple[str, ...]:
        """The trainings that it needs, its controls' too."""
        rows = [row for pair in self.pairs for row in (pair.a, pair.b)]
        return tuple(dict.fromkeys(row.run for row in rows if row.run))

    def verdict(self, verdicts: Sequence[str]) -> str:
        """The verdict on the claim: it holds where all its comparisons do, and fails where one fails.

        Args:
            verdicts: Those of its comparisons in one metric, controls left out; ``"not run"`` for one without.
        """
        if not verdicts or all(verdict in ("not run", "no decision") for verdict in verdicts):
            return "not run" if "not run" in verdicts or not verdicts else "no decision"
        if "holds not" in verdicts:
            return "holds not"
        if all(verdict == "holds" for verdict in verdicts):
            return "holds by construction" if self.by_construction else "holds"
        return "undecided"


class Document(DeclaredModel):
    """A file of claims."""

    paper: Literal["cirrus", "kradar"]
    metrics: dict[str, Metric]
    runs: dict[str, ClaimRun]
    claims: tuple[Claim, ...]

    @model_validator(mode="before")
    @classmethod
    def _give_comparisons_their_paper(cls, tree: Any) -> Any:
        """Give each comparison the paper whose tables its rows name."""
        if not isinstance(tree, dict):
            return tree
        claims = [claim for claim in tree.get("claims") or () if isinstance(claim, dict)]
        pairs = [pair for claim in claims for kind in ("comparisons", "controls") for pair in claim.get(kind) or ()]
        for pair in pairs:
            if isinstance(pair, dict):
                pair["paper"] = tree.get("paper", "")
        return tree

    @model_validator(mode="after")
    def _check_names(self) -> "Document":
        ids = [claim.id for claim in self.claims]
        if len(set(ids)) < len(ids):
            raise ValueError(f"expected each id once, got {', '.join(ids)}")
        for claim in self.claims:
            for pair in claim.pairs:
                for row in (pair.a, pair.b):
                    _check_row(self, claim, row)
        return self


def _check_row(document: Document, claim: Claim, row: ClaimSide) -> None:
    for metric in (*claim.metrics, *filter(None, [row.metric])):
        if metric not in document.metrics:
            raise ValueError(f"{claim.id}: expected a metric among {', '.join(document.metrics)}; got {metric!r}")
    trained = bool(document.metrics[row.metric or claim.metrics[0]].protocol)
    if trained != bool(row.run) or (row.run and row.run not in document.runs):
        raise ValueError(
            f"{claim.id}: expected a run among {', '.join(document.runs)}, none for a statistic of the data; "
            f"got {row.run!r}"
        )
    if row.published:
        try:
            table, name = _address(document.paper, row.published)
            missing = [part for part in row.parts if part not in table.figures.get(name, {})]
            table.at(name, row.part, "")
        except ConfigError as error:
            raise ValueError(f"{claim.id}: {error}") from None
        if missing:
            raise ValueError(f"{claim.id}: Table {table.number} has no part {', '.join(missing)} of {name}")


def _address(paper: str, published: str) -> tuple[PublishedTable, str]:
    """The table and the row of ``"I gaussian"``."""
    number, _, row = published.partition(" ")
    tables = PUBLISHED_TABLES[paper]
    if number not in tables:
        raise ConfigError(f"published: expected a table among {', '.join(tables)} and a row, got {published!r}")
    return tables[number], row


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
        claims = {declared.id: declared for declared in self.document.claims}
        if claim not in claims:
            raise ConfigError(f"claim: expected one of {', '.join(claims)}; got {claim!r}")
        return claims[claim]

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

    @property
    def pairs(self) -> list[tuple[Claim, Comparison]]:
        """All comparisons of all claims, controls among them."""
        return [(claim, pair) for claim in self for pair in claim.pairs]


def load(name_or_path: str | Path) -> Claims:
    """Read claims: the shipped ones by name, or a file.

    Args:
        name_or_path: ``"cirrus"``, ``"kradar"`` or the path of a YAML file.

    Raises:
        ConfigError: If there is no such file.
        FileFormatError: If it declares something that is not there or cannot be decided.
    """
    path = declared_path(name_or_path, "claims", _FOLDER)
    document, sha256 = read_declared(path, Document, "declared claims")
    return Claims(document=document, sha256=sha256, path=path)


def declared_path(name_or_path: str | Path, kind: str, folder: Path) -> Path:
    """The file of a paper's name, or a path.

    Args:
        name_or_path: One of :data:`CLAIMS`, or a path.
        kind: What the file declares, for the message.
        folder: Where the shipped files stand.

    Raises:
        ConfigError: If there is no such file.
    """
    path = folder / f"{name_or_path}.yaml" if name_or_path in CLAIMS else Path(name_or_path)
    if not path.is_file():
        raise ConfigError(f"{kind}: expected one of {', '.join(CLAIMS)} or a YAML file, got {name_or_path!s}")
    return path


Model = TypeVar("Model", bound=BaseModel)


def read_declared(
    path: Path, model: type[Model], expected: str, changes: Mapping[str, Any] | None = None
) -> tuple[Model, str]:
    """Read a declared YAML file, and the SHA-256 of its bytes.

    Args:
        path: The file.
        model: What it declares.
        expected: The same in words, for messages.
        changes: Keys of the file that are replaced.

    Raises:
        FileFormatError: If it is no YAML, or declares something that is not there.
    """
    data = read_bytes(path, max_bytes=MAX_BYTES)
    try:
        tree = plain_yaml(data)
        document = model.model_validate({**tree, **changes} if changes and isinstance(tree, dict) else tree)
    except ValidationError as error:
        raise FileFormatError(path, where="keys", expected=expected, got=plain(error)) from None
    except yaml.YAMLError as error:
        raise FileFormatError(path, where="the file", expected="YAML", got=plain(error)) from None
    return document, hashlib.sha256(data).hexdigest()
