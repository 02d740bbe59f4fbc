"""``farfield experiments``."""

from tyro.conf import Positional

from farfield.cli._output import console


def run(name: Positional[str] = "", /) -> int:
    """List the experiments that ship with farfield, or print one as YAML.

    examples:
      farfield experiments
      farfield experiments pointpillars-cirrus-sim
      farfield experiments pointpillars-cirrus-sim > mine.yaml
      farfield train pointpillars-cirrus-sim

    `farfield train NAME` trains one. Missing simulated data are generated in a folder below the current one; the path
    of a real data set is set with -o data.path=FOLDER.

    Args:
        name: Print this experiment's YAML file: a start for one's own.
    """
    from farfield.experiments.catalogue import find, shipped

    if name:
        print(find(name).read_text(encoding="utf-8"), end="")
        return 0
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("experiment", "detector", "data", "steps", "what it is"):
        table.add_column(column, justify="right" if column == "steps" else "left", no_wrap=column == "experiment")
    for entry in shipped():
        data = f"{entry.data} ({entry.simulated})" if entry.simulated else entry.data
        table.add_row(entry.name, entry.detector, data, f"{entry.steps:,}", entry.title)
    console(width=200).print(table)
    print("\ntrain one: farfield train NAME [-o data.path=FOLDER]\nas YAML: farfield experiments NAME")
    return 0
