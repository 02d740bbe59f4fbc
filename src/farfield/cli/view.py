"""``farfield view``."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, Reading, ReadingFlags, names
from farfield.cli._output import check_outputs

if TYPE_CHECKING:
    from farfield.datasets import Dataset


def run(
    data: Positional[Path | None] = None,
    *,
    detector: str = "",
    predictions: tuple[Path, ...] = (),
    format: Literal["boxes-csv", "kitti", "kitti-tracking", "nuscenes"] = "boxes-csv",
    protocol: str = "",
    threshold: float = 0.1,
    frame: str = "",
    where: str = "",
    reading: Reading = AS_THEY_ARE,
    reference: str = "",
    html: Path | None = None,
    port: int | None = None,
    browser: bool = True,
) -> int:
    """Look at a data set in the browser: clouds, radar, cameras, boxes, and what detectors make of it.

    examples:
      farfield view
      farfield view Cirrus_dataset1 --detector pointpillars-cirrus-sim
      farfield view data/kradar --detector runs/rtnh,runs/second --frame 33
      farfield view data/drives --predictions tracks.csv detections.csv --no-browser
      farfield view data/kradar --where 'weather == "sleet" and range_m > 50'
      farfield view data/drives --html two.html --frame 3,17

    Without a path it shows two small simulated frames, one of each kind of world. It listens on 127.0.0.1 only; over
    SSH it prints the line that makes the tunnel. Nothing is fetched from the network.

    Args:
        data: Folder of a data set or of clouds; its format is recognised.
        detector: Bundled names, runs' folders, weights or .onnx files, comma-separated: they run on the frames shown.
        predictions: Files of detections or tracks to show; sequence and frame pair them with the data.
        format: Format of the predictions.
        protocol: By which predictions are matched with the truth (default: the data set's own).
        threshold: Least score of a detector's boxes.
        frame: Frame to begin with: its number, or sequence/frame; with --html several, comma-separated.
        where: Only frames and annotated objects that fulfil a condition, such as 'range_m > 100 and label ==
            "vehicle"'; columns as of farfield evaluate.
        reading: How the data set's files are read.
        reference: Coordinates in which to show: K-Radar's os2-64 (as it is) or radar.
        html: Write the frames into one HTML file that opens from disk, and end; at most 20 frames.
        port: Port to listen on (default: the first free one from 8877 on).
        browser: Open the browser; never over SSH.
    """
    from farfield.errors import ConfigError
    from farfield.frame.where import Where
    from farfield.studio.options import DatasetOpener, StudioSettings
    from farfield.studio.serving.run import serve

    if data is None:
        reading.check_unused("a data set")
    check_outputs((data, *predictions, *names(detector), *reading.paths), files={"--html": html})
    if where:
        Where(where)  # says what is wrong with it before anything is read
        if data is None:
            raise ConfigError("--where: expected a data set, whose frames and objects it chooses")
    opening = DatasetOpener(data, partial(_open, reading, where) if where else reading.open, reference=reference)
    settings = StudioSettings(
        mode="view",
        title=opening.title,
        protocol=protocol,
        predictions=predictions,
        format=format,
        detectors=tuple(names(detector)),
        threshold=threshold,
        first="" if html is not None else frame,
    )
    if html is not None:
        from farfield.files.sizes import sized
        from farfield.studio.session.exporting import write_page

        write_page(opening(), settings, names(frame), html)
        print(f"written: {html} ({sized(html.stat().st_size)})")
        return 0
    return serve(opening, settings, port=port, browser=browser)


def _open(reading: ReadingFlags, where: str, path: Path, **options: Any) -> "Dataset":
    """The data set with the frames and objects that fulfil the condition."""
    from farfield.datasets.maps.where import fulfilling

    return fulfilling(reading.open(path, **options), where)
