"""``farfield report``: an evaluation as one self-contained HTML page."""

from pathlib import Path

from tyro.conf import Positional


def run(evaluation: Positional[Path], *, out: Path | None = None, title: str = "", shown_score: float = 0.3) -> int:
    """Turn an evaluation into one self-contained HTML page.

    examples:
      farfield report runs/pillars/evaluation
      farfield report runs/pillars/evaluation/evaluation.json --out pillars.html
      farfield report scores.json --out scores.html --title "My detector on my data"

    Args:
        evaluation: Folder or evaluation.json of `farfield evaluate`, or the JSON of `farfield score --json`.
        out: The page to write; by default beside the evaluation, with the suffix .html.
        title: Title of the page; by default the evaluation's own.
        shown_score: Predictions below this score are left out of the pictures.
    """
    from farfield.errors import ConfigError
    from farfield.reports.evaluation import Evaluation
    from farfield.reports.page import write_report

    if not evaluation.exists():
        raise ConfigError(f"evaluation: expected a folder or a JSON file, found nothing at {evaluation}")
    content = Evaluation.load(evaluation)
    if out is None:
        out = evaluation / "report.html" if evaluation.is_dir() else evaluation.with_suffix(".html")
    path = write_report(
        out,
        title=title or content.title,
        results=content.results,
        frames=content.frames,
        settings=content.settings,
        provenance=content.provenance,
        objects=content.objects,
        parts=content.parts,
        shown_score=shown_score,
    )
    print(f"report: {path.resolve()} ({path.stat().st_size / 1e6:.1f} MB)")
    return 0
