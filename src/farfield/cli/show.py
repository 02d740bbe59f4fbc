"""``farfield show``: one frame as a picture."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from farfield.cli._flags import AS_THEY_ARE, OWN_BOXES, Reading, ShownBoxes, names
from farfield.cli._output import check_outputs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from farfield.frame import Boxes, Frame


def run(
    data: Positional[Path],
    /,
    *,
    frame: int = 0,
    radar: bool = False,
    camera: str | None = None,
    detector: str = "",
    cloud: Annotated[str | None, tyro.conf.arg(aliases=["--clouds"])] = None,
    boxes: ShownBoxes = OWN_BOXES,
    reading: Reading = AS_THEY_ARE,
    out: Path | None = None,
) -> int:
    """Draw one frame from above, with its annotated boxes and those of a detector, into a PNG.

    examples:
      farfield show Cirrus_dataset1
      farfield show data/kradar --radar --frame 12
      farfield show data/kitti --camera image_2
      farfield show data/sim --detector pointpillars-cirrus-sim --score-threshold 0.3 --out frame.png

    Args:
        data: The data set; its format is recognised.
        frame: Number of the frame, counted from 0.
        radar: Draw the radar's power instead of a cloud: of a tesseract, a cube, a polar map or the store's cells, else
            the radar's points.
        camera: Draw the picture of this camera instead, with the boxes projected into it, and the boxes that were
            annotated in it dotted.
        detector: A bundled detector's name, a run's folder, a weights file or an .onnx file, whose boxes are drawn too.
        cloud: Which cloud (default: the first, or the first that suits the detector).
        boxes: Which of the detector's boxes are drawn; without --score-threshold those of score 0.3 or more.
        reading: How the files are read.
        out: The PNG (default: runs/show-DATA-NUMBER.png).
    """
    from farfield.api import load_detector
    from farfield.errors import ConfigError
    from farfield.evaluation import as_trained, suitable_clouds
    from farfield.figures.style import save_figure
    from farfield.frame.provenance import is_simulated
    from farfield.jobs.folders import held

    path = out or Path("runs") / f"show-{data.resolve().name}-{frame}.png"
    check_outputs((data, *names(detector), *reading.paths), files={"--out": path})
    opened, predicted = reading.open(data), None
    if radar and opened.name == "kradar":
        opened = reading.open(data, reference="radar")
    if not 0 <= frame < len(opened):
        raise ConfigError(f"--frame: expected a number from 0 to {len(opened) - 1}, got {frame}")
    shown = opened[frame]
    if detector:
        loaded = load_detector(detector, **boxes.options)
        shown = as_trained(opened, loaded.info)[frame]
        cloud = cloud or suitable_clouds(loaded.info, shown)[0]
        predicted = loaded.with_cloud(cloud)(shown)
    if camera is None:
        figure = _drawn(shown, predicted, radar, cloud, boxes.score_threshold)
    else:
        figure = _pictured(shown, camera, predicted, boxes.score_threshold)
    with held(path, file=True):
        save_figure(path, figure, dpi=150)
    print("simulated data\n" if is_simulated(opened.root) else "", end="")
    title = figure.axes[0].get_title(loc="left") or figure.axes[0].get_title()
    print(f"{title}\npicture: {path.resolve()}")
    return 0


def _pictured(shown: "Frame", camera: str, predicted: "Boxes | None", least: float | None) -> "Figure":
    from farfield.errors import ConfigError
    from farfield.evaluation.report_data import shown_predictions
    from farfield.figures.camera import camera_picture
    from farfield.frame.image_marks import image_marks
    from farfield.vocabulary.counts import count_of
    from farfield.vocabulary.scores import SHOWN_SCORE

    if camera not in shown.images:
        raise ConfigError(
            f"--camera: expected one of {', '.join(shown.images) or 'none, there is no image'}, got {camera!r}"
        )
    marks = image_marks(shown)
    marks = marks if marks is not None and marks.camera == camera else None
    boxes = shown_predictions(predicted, SHOWN_SCORE if least is None else least)[0]
    of_image = "" if marks is None else f", {count_of(len(marks), 'box', 'boxes')} of the image dotted"
    return camera_picture(
        shown.images[camera],
        shown.cameras.get(camera),
        annotated=shown.boxes,
        predicted=boxes,
        marks=marks,
        title=f"{shown.sequence} {shown.frame_id}, {camera}{of_image}".strip(),
    )


def _drawn(shown: "Frame", predicted: "Boxes | None", radar: bool, cloud: str | None, least: float | None) -> "Figure":
    from farfield.evaluation.report_data import shown_predictions
    from farfield.figures.birds_eye import birdseye
    from farfield.figures.radar import radar_map
    from farfield.vocabulary.scores import SHOWN_SCORE

    shown_score = SHOWN_SCORE if least is None else least
    if radar:
        return radar_map(shown, shown_predictions(predicted, shown_score)[0])
    return birdseye(shown, predicted, cloud=cloud, shown_score=shown_score)
