"""What a claim is made of: rows of a table, what is compared of them, and what the paper published."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from farfield.errors import ConfigError
from farfield.metrics.deciding import Hypothesis, Scalar, figure
from farfield.metrics.deciding.decision import Kind
from farfield.vocabulary.published_tables import OVERALL, PUBLISHED_TABLES, PublishedTable

BUDGETS = ("laptop", "desk", "workstation", "gpu")
Budget = Literal["laptop", "desk", "workstation", "gpu"]


class _ClaimModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Metric(_ClaimModel):
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


class ClaimRun(_ClaimModel):
    """A training of the grid, once a seed."""

    words: str
    least_budget: Budget = Field("laptop", description="smallest budget that runs it")


class ClaimSide(_ClaimModel):
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
        found = figure(metric.figure, names[0])
        return found - figure(metric.figure, names[1]) if self.minus else found

    def figure_published(self, paper: str, metric: str) -> float | None:
        """The paper's figure; None where it prints none."""
        if not self.published:
            return None
        table, row = _address(paper, self.published)
        found = [table.at(row, part, self.metric or metric) for part in self.parts]
        if any(value is None for value in found):
            return None
        return sum(sign * (value or 0.0) for sign, value in zip((1, -1), found, strict=False))


class Comparison(_ClaimModel):
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
        """The paper's difference A - B; None where the paper prints not both."""
        values = [row.figure_published(self.paper, metric) for row in (self.a, self.b)]
        return None if values[0] is None or values[1] is None else values[0] - values[1]


class Claim(_ClaimModel):
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
    def runs(self) -> tuple[str, ...]:
        """The trainings that it needs, its controls' too."""
        rows = [row for pair in (*self.comparisons, *self.controls) for row in (pair.a, pair.b)]
        return tuple(dict.fromkeys(row.run for row in rows if row.run))


class Document(_ClaimModel):
    """A file of claims."""

    paper: Literal["cirrus", "kradar"]
    metrics: dict[str, Metric]
    runs: dict[str, ClaimRun]
    claims: tuple[Claim, ...]

    @model_validator(mode="before")
    @classmethod
    def _knows_its_paper(cls, tree: Any) -> Any:
        """Give each comparison the paper whose tables its rows name."""
        if not isinstance(tree, dict):
            return tree
        claims = [each for each in tree.get("claims") or () if isinstance(each, dict)]
        pairs = [pair for claim in claims for kind in ("comparisons", "controls") for pair in claim.get(kind) or ()]
        for pair in pairs:
            if isinstance(pair, dict):
                pair["paper"] = tree.get("paper", "")
        return tree

    @model_validator(mode="after")
    def _names_what_there_is(self) -> "Document":
        ids = [claim.id for claim in self.claims]
        if len(set(ids)) < len(ids):
            raise ValueError(f"expected each id once, got {', '.join(ids)}")
        for claim in self.claims:
            for pair in (*claim.comparisons, *claim.controls):
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
