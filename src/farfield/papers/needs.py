"""Which numbers of which runs the claims compare: each is drawn with its sequences while a run is scored."""

from collections.abc import Iterator
from dataclasses import dataclass

from farfield.metrics.deciding import Scalar
from farfield.papers.claims import Claim, Claims, ClaimSide, Comparison
from farfield.papers.grid import ExperimentGrid, Score


@dataclass(frozen=True, kw_only=True)
class RequiredScore:
    """A number of a run.

    Args:
        run: The run.
        cloud: The cloud that it is scored on.
        table: The table whose ranges hold; empty where there are none.
        scalar: The number.
        matched: The two parts whose frames are made alike in their numbers of objects; none: all frames count.
    """

    run: str
    cloud: str
    table: str
    scalar: Scalar
    matched: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What it is called among a run's samples of a cloud."""
        alike = f"; matched {', '.join(self.matched)}" if self.matched else ""
        return f"{self.table}: {self.scalar}{alike}"


def needs_of(claims: Claims, grid: ExperimentGrid, score: Score) -> list[RequiredScore]:
    """All numbers that trained claims compare, each once."""
    found = (
        need_of(row, claim, metric, claims, grid, score)
        for claim in claims
        for metric in trained_metrics(claim, claims)
        for pair in (*claim.comparisons, *claim.controls)
        for row in (pair.a, pair.b)
        if row.run in grid.runs
    )
    return list(dict.fromkeys(found))


def need_of(
    row: ClaimSide, claim: Claim, metric: str, claims: Claims, grid: ExperimentGrid, score: Score
) -> RequiredScore:
    """The number that a row of a claim compares.

    Args:
        row: The row.
        claim: Its claim.
        metric: The metric, unless the row has one of its own.
        claims: All claims.
        grid: The grid.
        score: How runs are scored.
    """
    table = score.table(claim.table)
    return RequiredScore(
        run=row.run,
        cloud=cloud_of(row, grid),
        table=table,
        scalar=row.scalar(claims.metrics[row.metric or metric], score.parts(table)),
        matched=row.parts if row.matched else (),
    )


def cloud_of(row: ClaimSide, grid: ExperimentGrid) -> str:
    """The cloud that a row is scored on: the one it names, or the only one that its run learns from."""
    return row.cloud or next(iter(grid.runs[row.run].streams.values())).clouds[0]


def trained_metrics(claim: Claim, claims: Claims) -> tuple[str, ...]:
    """Metrics of a claim that are a protocol's figures."""
    return tuple(metric for metric in claim.metrics if claims.metrics[metric].protocol)


def pairs_of(claims: Claims) -> Iterator[tuple[Claim, Comparison]]:
    """All comparisons of all claims, controls among them."""
    for claim in claims:
        for pair in (*claim.comparisons, *claim.controls):
            yield claim, pair
