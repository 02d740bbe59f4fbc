"""``farfield export``: a trained detector as an ONNX file that runs without torch."""

from pathlib import Path

from tyro.conf import Positional

from farfield.cli._output import check_outputs


def run(
    detector: Positional[str], out: Positional[Path], *, score_threshold: float | None = None, licence: str = ""
) -> int:
    """Write a trained detector as an ONNX file with a card, checked against the network on five clouds.

    examples:
      farfield export pointpillars-cirrus-sim pointpillars.onnx
      farfield export runs/second second.onnx --score-threshold 0.2 --licence "CC BY 4.0"
      farfield predict second.onnx scan.pcd

    The file holds the network from point features to decoded boxes; voxelisation and suppression run in numpy. Every
    verb takes it as a detector, without torch. A file whose outputs differ from the network's is not written.

    Args:
        detector: A bundled detector's name, a run's folder, or a weights file.
        out: The file to write, .onnx; its card stands beside it, .md.
        score_threshold: Boxes of a lower score are not given (default: the weights' own).
        licence: Under which the weights may be used, for the card.
    """
    from farfield.errors import ConfigError
    from farfield.jobs.folders import held

    if out.suffix != ".onnx":
        raise ConfigError(f"Expected a target that ends in .onnx, got {out}.")
    check_outputs((detector,), files={"out": out, "the card": out.with_suffix(".md")})
    from farfield.api import export

    with held(out, file=True):
        done = export(detector, out, licence=licence, score_threshold=score_threshold)
    print("parity: largest difference of an output over its largest number; boxes within 1 mm and 1e-4 rad")
    for row in done.parity:
        print(f"  {row.cloud:<14}{row.points:>9,} points  {row.largest:.1e}  {row.same:8.2%} of {row.boxes} boxes")
    print(f"exported: {done.path} ({done.size / 1e6:.1f} MB, {done.seconds:.0f} s); card: {done.card}")
    return 0
