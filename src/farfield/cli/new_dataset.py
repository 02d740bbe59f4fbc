"""``farfield new-dataset``."""

from pathlib import Path

from tyro.conf import Positional

from farfield.cli._output import check_outputs


def run(folder: Positional[Path], *, seed: int = 0) -> None:
    """Write an example of a data set of your own: sweeps, boxes, detections, and a text that says what is what.

    examples:
      farfield new-dataset my-sweeps
      farfield new-dataset my-sweeps && farfield doctor my-sweeps
      farfield score my-sweeps/detections.csv my-sweeps/labels.csv

    Put your own files in place of these. The example shows the layout and is no data to learn from.

    Args:
        folder: Where to write; absent or empty.
        seed: Another seed draws other points.
    """
    from farfield.datasets.example import write_example

    check_outputs((), folders={"folder": folder})
    files = write_example(folder, seed=seed)
    print("\n".join(str(path) for path in files))
    print(f"next: farfield doctor {folder}")
