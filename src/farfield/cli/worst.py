"""``farfield worst``: the frames and objects on which an evaluation lost most."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, Reading, names
from farfield.cli._output import check_outputs, console, write_json


def run(
    evaluation: Positional[Path],
    *,
    where: str = "",
    kind: Literal["all", "missed", "false", "unsure"] = "all",
    by: str = "class,range",
    top: int = 10,
    data: Path | None = None,
    rotate_deg: float = 0.0,
    out: Path | None = None,
    json: Path | None = None,
    reading: Reading = AS_THEY_ARE,
    dry_run: bool = False,
) -> int:
    """List the frames and objects on which an evaluation lost most, and draw them.

    examples:
      farfield worst runs/evaluation-second-kitti
      farfield worst runs/eval --kind missed --where 'range_m > 100 and weather == "sleet"'
      farfield worst runs/eval --data data/kradar --out worst.html
      farfield worst runs/eval --by weather,points --top 30

    The loss is 1 for a missed object, the score for a false box, 1 - score for a detected object; a frame's loss is
    their sum. With --data the page shows each object from above, from the side and in the camera; its links open the
    frame where `farfield view` shows the data.

    Args:
        evaluation: Folder of `farfield evaluate`.
        where: Only objects that fulfil a condition, such as 'range_m > 100 and label == "vehicle"'. Columns: sequence,
            frame, weather, road, time, label, range_m, bearing_deg, points, x_m, y_m, z_m, length_m, width_m, height_m,
            yaw_deg.
        kind: Only missed objects, false boxes, or objects found by an unsure box.
        by: Sum losses by these, comma-separated: class, range, points, weather, road, time, sequence.
        top: Frames and objects to list.
        data: The data that were evaluated, to draw the objects.
        rotate_deg: Turn every frame counter-clockwise about z, as the evaluation did.
        out: Page to write; beside the evaluation as worst.html where --data is given.
        json: Write the rows into this file; - prints them.
        reading: How the files are read.
        dry_run: Say what would be written, and write nothing.
    """
    from rich.table import Table
    from rich.text import Text

    from farfield.cli._output import would_write
    from farfield.errors import ConfigError
    from farfield.evaluation.lost import KINDS, LOST, read_lost
    from farfield.frame.where import Where
    from farfield.pages.worst_page import frame_table, headline, object_table, sum_table, write_worst

    if top < 1:
        raise ConfigError(f"--top: expected 1 or more, got {top}")
    condition = Where(where) if where else None
    folder = evaluation if evaluation.is_dir() else evaluation.parent
    page = out or (folder / "worst.html" if data is not None else None)
    check_outputs(
        (data, folder / LOST, folder / "evaluation.json", *reading.paths), files={"--out": page, "--json": json}
    )
    whole = read_lost(evaluation)
    parts = [lost.where(condition, KINDS if kind == "all" else (kind,)) for lost in whole]
    if not any(lost.objects for lost in parts) and (where or kind != "all"):
        classes = sorted({name for lost in whole for name in lost.classes if lost.other_classes})
        alone = (
            f". The evaluation is of {' and '.join(classes)} alone: farfield evaluate --label CLASS" if classes else ""
        )
        raise ConfigError(
            f"--where {where or '(none)'} --kind {kind}: expected objects that were lost, found none such{alone}"
        )
    if dry_run:
        would_write("the worst frames and objects", page or json or "the output")
        return 0
    printed = console(width=120)
    for lost in parts:
        printed.print(headline(lost))
        for name, heads, rows in (
            frame_table(lost, top),
            object_table(lost, top),
            *(sum_table(lost, word) for word in names(by)),
        ):
            table = Table(title=name, title_justify="left")
            for number, head in enumerate(heads):
                table.add_column(head, justify="right" if number else "left", overflow="fold")
            for _, cells in rows:
                table.add_row(*map(Text, cells))
            printed.print(table)
    if json is not None:
        rows_of = {lost.cloud: {"frames": lost.frames[:top], "objects": lost.objects[:top]} for lost in parts}
        write_json(json, rows_of)
    if page is not None:
        opened = None if data is None else reading.open(data, rotate_deg=rotate_deg)
        title = f"Worst of {folder.resolve().name}" + (f", where {where}" if where else "")
        write_worst(page, parts, title=title, top=top, by=names(by), data=opened)
        print(f"page: {page.resolve()}")
    return 0
