"""What the doctor finds, and how it prints."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Severity = Literal["ok", "warn", "fail"]


def counted(number: int, thing: str) -> str:
    """Write a number with its noun.

    >>> counted(1, "frame"), counted(3, "box")
    ('1 frame', '3 boxes')
    """
    plural = f"{thing}es" if thing.endswith("x") else f"{thing}s"
    return f"{number} {thing if number == 1 else plural}"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing found.

    Args:
        severity: ``"ok"``, ``"warn"`` (training runs, look at it) or ``"fail"`` (training would fail or score zero).
        topic: Short name, such as ``"size order"``.
        what: What was found.
        where: File or frame.
        mend: How to mend it.
        absent: Whether it says no more than that something is not there, which nothing needs.
    """

    severity: Severity
    topic: str
    what: str
    where: str = ""
    mend: str = ""
    absent: bool = False


@dataclass(frozen=True, kw_only=True)
class DoctorReport:
    """All findings about one data set.

    Args:
        path: Root of the data set.
        format: Name of its format.
        findings: In the order of the examination.
        facts: Figures by name, for programs: counts, orders, classes by range.
    """

    path: str
    format: str
    findings: tuple[Finding, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether training would fail or score zero."""
        return any(finding.severity == "fail" for finding in self.findings)

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings about what is there, or should be."""
        return tuple(finding for finding in self.findings if not finding.absent)

    @property
    def absent(self) -> tuple[str, ...]:
        """Topics of what is not there and need not be."""
        return tuple(finding.topic for finding in self.findings if finding.absent)

    def to_json(self) -> dict[str, Any]:
        """Return plain values: path, format, failed, facts, findings."""
        findings = [asdict(finding) for finding in self.findings]
        return {"path": self.path, "format": self.format, "failed": self.failed, "facts": self.facts} | {
            "findings": findings
        }

    def __str__(self) -> str:
        lines = [f"{self.path}: {self.format}"]
        for finding in self.present:
            where = f" [{finding.where}]" if finding.where else ""
            mend = f"\n       mend: {finding.mend}" if finding.mend else ""
            lines.append(f"{finding.severity:>5}  {finding.topic}: {finding.what}{where}{mend}")
        return "\n".join([*lines, *([f"not there: {', '.join(self.absent)}"] if self.absent else [])])
