"""``farfield annotate``."""

import getpass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, Reading, names
from farfield.cli._output import check_outputs


def run(
    data: Positional[Path | None] = None,
    *,
    annotator: str = "",
    classes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME:LENGTH,WIDTH,HEIGHT ...")] = (),
    extent: Literal["", "full", "visible"] = "",
    out: Path | None = None,
    to: str = "",
    write: bool = False,
    save_at_exit: bool = False,
    detector: str = "",
    predictions: tuple[Path, ...] = (),
    format: Literal["boxes-csv", "kitti", "kitti-tracking", "nuscenes"] = "boxes-csv",
    protocol: str = "",
    threshold: float = 0.1,
    frame: str = "",
    reading: Reading = AS_THEY_ARE,
    edits: Path | None = None,
    port: int | None = None,
    browser: bool = True,
) -> int:
    """Annotate a data set in the browser: boxes, tracks, checks; every edit is on the disk before it is acknowledged.

    examples:
      farfield annotate
      farfield annotate data/kradar --annotator kim --out data/kradar-mine
      farfield annotate my-clouds --classes car:4.6,1.9,1.7 person:0.8,0.7,1.75 --extent full
      farfield annotate Cirrus_dataset1 --detector pointpillars-cirrus-sim --write

    The data set's label files stay untouched unless --write is given; then the first write of each keeps a copy beside
    the journal. Undo reaches back to the first edit, also after a restart.

    Args:
        data: Folder of a data set or of clouds; its format is recognised.
        annotator: Who annotates (default: the login name). Undo takes back one's own edits.
        classes: The classes to offer and their usual sizes in metres (default: the data set's own).
        extent: What the boxes hold: whole bodies (full) or visible parts (visible) (default: the page asks once).
        out: Folder into which labels are saved (default: beside the journal).
        to: Format of the saved labels (default: the data set's own).
        write: Save into the data set's own label files.
        save_at_exit: Write the labels also when the studio ends; else what was not saved stays in the journal.
        detector: Bundled names, runs' folders or weights files, comma-separated: their boxes can be proposed.
        predictions: Files of boxes to compare with.
        format: Format of the predictions.
        protocol: By which predictions are matched with the truth (default: the data set's own).
        threshold: Least score of a detector's boxes.
        frame: Frame to begin with: its number, or sequence/frame.
        reading: How the data set's files are read.
        edits: Folder of the journal (default: .farfield-studio beside the labels).
        port: Port to listen on (default: the first free one from 8877 on).
        browser: Open the browser; never over SSH.
    """
    from farfield.studio.options import DatasetOpener, StudioSettings
    from farfield.studio.serving.run import serve

    if data is None:
        reading.check_unused("a data set")
    check_outputs((data, *predictions, *names(detector), *reading.paths), folders={"--out": out, "--edits": edits})
    opening = DatasetOpener(data, reading.open)
    settings = StudioSettings(
        mode="annotate",
        title=opening.title,
        annotator=annotator or getpass.getuser(),
        protocol=protocol,
        predictions=predictions,
        format=format,
        detectors=tuple(names(detector)),
        threshold=threshold,
        first=frame,
        classes=classes,
        extent=extent or None,
        out=out,
        to=to,
        write=write,
        save_at_exit=save_at_exit,
        edits=edits,
    )
    return serve(opening, settings, port=port, browser=browser)
