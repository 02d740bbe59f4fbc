"""Write docs/formats.md: every format that is registered, with its facts, from the code.

python tools/formats.py            print the page
python tools/formats.py --write    write it
"""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from farfield.datasets.convert import CAPACITIES, TARGETS
from farfield.datasets.losses import ITEMS, Capacity
from farfield.inspection.formats import FormatEntry, format_catalogue
from farfield.metrics import PROTOCOLS

PAGE = Path(__file__).resolve().parents[1] / "docs" / "formats.md"
HEAD = """# Formats

Printed by `tools/formats.py` from what the code registers; `farfield formats` prints the same, `farfield formats NAME`
all that is known of one, and `farfield formats velodyne` (any sensor, suffix, data set or tool) what is read of it. A
folder's format is recognised from what it holds; `--format NAME` overrules it. Options of a reader without a flag are
given as `--reader NAME=VALUE`, such as `--reader whole_scenes=true`.

**No real file seen** means that the reader follows the format's description, and that the files in its tests were
written by that description too: look at the first frames with `farfield show DATA`. What is checked on the way in
stands in [checks](checks.md), what one file may cost in [limits](limits.md), how own data are laid out in [own
data](own-data.md).
"""
TARGETS_HEAD = """`farfield convert DATA OUT --to TARGET` writes another layout. What the target does not hold of what
the frames say is said before anything is written, a line each; `--dry-run` says it too, and the folder's
`.farfield_losses.jsonl` keeps it. The lines are of up to five frames that are spread over the set. A box is its centre,
sizes and yaw in every target: roll and pitch were left out, or refused, when the source was read. A cache stands beside
its source and loses nothing; a radar store holds radar products alone and is opened together with its source."""
TOOLS = """What the pages of annotation tools say of their files, what they leave open, and how Farfield takes it. Of none
of these files but SUSTechPOINTS' and KITTI's was a real one seen; who has some should look at a few boxes with `farfield show`
first. Tracks that a tool names rather than numbers keep their names in the annotation's `track_name`, and texts, numbers
and flags of a box go from tool to tool where the target has a place for them.

| tool | what its page says | what it leaves open |
|---|---|---|
| labelCloud (`labelcloud`), <https://ch-sa.github.io/labelCloud>, its README, and a whole file in <https://github.com/ch-sa/labelCloud/issues/1> | `centroid_rel`: rotations in radians from -pi to pi; `centroid_abs`: degrees from 0 to 360; `vertices`: eight corners, bottom before top, left back, left front, right front, right back, the arrow on the right side. The length lies along x; rotations are counter-clockwise | No file names its form: negative rotations show radians, those beyond 3.15 degrees, file by file; a file that may be either follows the others or `--label-angles`, else it is refused. The README adds that a rotation runs from positive x to negative y, which is clockwise: the conventions are followed, the assumption is said, and `vertices`, which know no rotation, are written. No tracks: those of the studio stay in its journal |
| CVAT (`cvat`, `supervisely`), <https://docs.cvat.ai/docs/manual/advanced/formats/> | Three exports of a task of point clouds: Datumaro, KITTI raw with `tracklet_labels.xml`, Sly Point Cloud | Datumaro's boxes have their length along x; what the tracklets' numbers stand for is told from their writer's marks or by `--tracklets` |
| Supervisely (`supervisely`), <https://developer.supervisely.com/getting-started/supervisely-annotation-format/point-cloud-episodes> | Position is the centre; x of the dimensions is the width, y the length; without rotation a box heads along +y. `frame_pointcloud_map.json` orders an episode's clouds. Its example has a list around the episode, its SDK writes none: both are read, none is written | `ann/` of CVAT has the same keys with the length along x: the longer sides of vehicles and bicycles tell which, or `--label-axes`. Tags are of objects, so that what changes over time has no place in them. Images are not read |
| Xtreme1 (`xtreme1`), <https://docs.xtreme1.io/xtreme1-docs/export-data/data-annotation-result> and its pages "upload dataset" and "coordinate system" | Centre, sizes and Euler angles in the cloud's coordinates, z up; `cameraExternal` brings a point into the camera, by rows unless `rowMajor` is false | That x of the sizes is the length is taken from the example. Of several sources the people's counts (`Ground Truth`, `Without Task`) |
| OpenLABEL (`openlabel`), <https://www.asam.net/standards/detail/openlabel/> | `val` of a cuboid has ten numbers (a quaternion, x y z w) or nine (Euler angles) | Boxes stand in their cloud's coordinates: other `coordinate_systems` are not turned |
| SUSTechPOINTS (`sustechpoints`), <https://github.com/naurril/SUSTechPOINTS> | Position, scale and rotation of a box in the LiDAR's coordinates | |
| Scale (`scale`), <https://docs.scale.com/reference/lidar-callback-format>, <https://docs.scale.com/reference/data-types-and-the-frame-objects> (today <https://scale.com/docs/api-reference/sensor-fusion-lidar-reference>; of these pages the beginnings were at hand), the code of Scale's own writer <https://pypi.org/project/scale-lidar-io> 1.2.5 (Apache 2.0), of the callback <https://scale.com/docs/api-reference/callbacks>, and of the same cuboids <https://github.com/scaleapi/pandaset-devkit> and <https://github.com/scaleapi/nucleus-python-client> (MIT) | The answer is a list with the `cuboids` of each frame; their centres stand in the world, yaw 0 looks along +y and counts counter-clockwise. PandaSet's page: that vector points at the length's side, so y of the dimensions is the length; `stationary` is of the whole scene; a `uuid` stays over time. Nucleus' metrics add pi/2 to yaw by "the internal Scale convention"; the words beside Nucleus' own cuboids call x the length, which is of Nucleus' uploads and not of answers. A callback holds the `task` with its `params`. A point's `i` is between 0 and 1, `d` the number of its device, `t` nanoseconds. The writer: points, `device_position` and cameras stand in the world, headings are quaternions w, x, y, z, a camera looks along its z with y down, absent numbers may be `null`; its template has `meters_per_unit` | Which answer is of which frame: by a task's own JSON (`attachments`) beside them, else by the names' order, numbers by their size; other counts or names are refused. Units: `meters_per_unit` of the task, else metres (`--reader metres_per_unit=`). Unit of a frame's and an image's time: nanoseconds as of points (`--reader time_unit=`). Intensities beyond 1 want `--reader intensity_scale=`. How pitch and roll turn a box: left out up to 0.5 rad, else refused. A device without pose, or one whose z does not point up, is refused; where its x looks no page says, so that axes stay as its heading has them. Skew, fisheye and omnidirectional lenses have no place here: their pictures are shown without calibration. Not written: no page at hand says that Scale takes an answer back, and an answer without its uploaded frames says nothing of clouds; not edited either |
| Segments.ai (`segments_ai`), <https://docs.segments.ai/reference/label-types> and its pages on samples, categories and releases | Position in world coordinates, x of the dimensions the length, yaw counter-clockwise from +x; `ego_pose` is the pose of the sensor that took the cloud | Read, not written or edited: a release is made by the service. Clouds go by the ends of their addresses |"""  # noqa: E501
PICTURES = {
    "none": "",
    "first": "the image of the calibrated camera that looks ahead, else the first image",
    "front": "the image of the calibrated camera that looks ahead",
    "calibrated": "the images of calibrated cameras",
}
KINDS = {"labels": "Labels", "results": "Results", "clouds": "Single clouds"}


def cell(text: str) -> str:
    """A text that stands in one cell of a table; addresses and pages of these docs become links."""
    return " ".join(map(_word, text.split()))


def _word(word: str) -> str:
    bare = word.rstrip(",.;")
    rest = word[len(bare) :]
    if bare.startswith("https://"):
        return f"<{bare}>{rest}"
    if bare.startswith("docs/") and bare.endswith(".md"):
        return f"[{bare[5:-3]}]({bare[5:]}){rest}"
    return word.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;").replace("_", "\\_").replace("[", "\\[")


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first cell of each row is a name."""
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    lines += [f"| `{first}` | {' | '.join(map(cell, rest))} |" for first, *rest in rows]
    return "\n".join(lines)


def section(entry: FormatEntry) -> str:
    """All that is known of a data set's format."""
    facts = entry.facts
    if facts is None:
        return ""
    lines = [
        f"**Read**: {cell(facts.read)}.",
        f"**Real files**: {cell(facts.real_files)}.",
        f"**Open it**: `{facts.opens}`" + (f', after `pip install ".[{facts.extra}]"`.' if facts.extra else "."),
        f"**Recognised by**: {cell(entry.looked_for)}.",
        f"**Smallest useful download**: {cell(facts.download or 'not known')}.",
        f"**Licence of the data**: {cell(facts.licence or 'not known')}.",
        f"**Described in**: {cell(facts.source)}.",
    ]
    return f"### {entry.name}\n\n{facts.title}\n\n" + "\n".join(f"- {line}" for line in lines)


def page() -> str:
    """The whole page; formats of other packages are left out."""
    catalogue = format_catalogue()
    own = [entry for entry in catalogue.datasets if entry.origin == "farfield"]
    rows = []
    for entry in own:
        real_files = entry.facts.real_files if entry.facts is not None else ""
        saved = "yes" if entry.saved else ""
        rows.append((entry.name, real_files, ", ".join(entry.written), saved, entry.scored))
    parts = [HEAD.rstrip(), "## Data sets"]
    protocols = ", ".join(f"`{name}`" for name in PROTOCOLS.builtin)
    parts.append(f"The last column is the protocol of `farfield evaluate` unless another is named: {protocols}.")
    parts.append(table(("data set", "real files", "written by", "labels saved in place", "scored by"), rows))
    parts += [section(entry) for entry in own]
    for kind, title in KINDS.items():
        forms = [form for form in catalogue.forms if form.kind == kind]
        rows_of_kind = [
            (form.name, form.facts.holds, ", ".join(form.uses), form.facts.real_files, form.facts.source)
            for form in forms
        ]
        parts += [f"## {title}", table((kind, "holds", "used by", "real files", "described in"), rows_of_kind)]
    targets = [
        (CAPACITIES[name].words or name, CAPACITIES[name].title, held(CAPACITIES[name]))
        for name in TARGETS
        if name not in ("cache", "radar-store")  # which have no boxes and are no copy
    ]
    parts += ["## Conversions", TARGETS_HEAD, table(("target", "what it is", "what it holds beside boxes"), targets)]
    parts += ["## Annotation tools", TOOLS]
    return "\n\n".join(parts) + "\n"


def held(capacity: Capacity) -> str:
    """What a target holds, in words."""
    several = "clouds of LiDARs and radars" if capacity.chosen is not None else "one cloud"
    words = [" and ".join(capacity.together) or several] if capacity.one_cloud else []
    words += [PICTURES[capacity.pictures], *sorted(capacity.attributes)]
    words += ["texts, numbers and flags of a box"] if capacity.any_attributes else []
    words += [text for item, text in ITEMS.items() if item in capacity.holds]
    return ", ".join(filter(None, words))


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
