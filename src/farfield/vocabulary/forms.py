"""What is known of forms of files beside data sets, by the names of their registries: labels, results, single clouds.

`farfield formats` takes the names from the registries themselves, so that one without facts here is an error.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FormFacts:
    """What a user wants to know of a file format.

    Args:
        title: What people call it.
        holds: What stands in it.
        real_files: Real files that were read, which; else "no real file seen".
        source: Where it is described: an address, or a page of these docs.
        extra: The optional extra that reading it needs; empty: none.
    """

    title: str
    holds: str
    real_files: str
    source: str
    extra: str = ""


_OWN = "this package's own: written and read by it"

LABEL_FORMS: Mapping[str, FormFacts] = {
    "boxes-csv": FormFacts(
        title="boxes as CSV",
        holds="boxes, classes, tracks, velocities, scores, counts of points; a row a box",
        real_files=_OWN,
        source="docs/score-boxes.md",
    ),
    "openlabel": FormFacts(
        title="OpenLABEL",
        holds="boxes, classes, tracks, attributes, times; one file a sequence",
        real_files="no real file seen",
        source="https://www.asam.net/standards/detail/openlabel/",
    ),
    "sustechpoints": FormFacts(
        title="SUSTechPOINTS",
        holds="boxes, classes, tracks; one file a frame",
        real_files="labels of four sweeps of the tool's own scene",
        source="https://github.com/naurril/SUSTechPOINTS",
    ),
    "cvat": FormFacts(
        title="CVAT (Datumaro)",
        holds="boxes, classes, tracks, attributes; one file a sequence",
        real_files="no real file seen",
        source="https://docs.cvat.ai/docs/manual/advanced/formats/",
    ),
    "xtreme1": FormFacts(
        title="Xtreme1",
        holds="boxes, classes, tracks, attributes; one file a frame",
        real_files="no real file seen",
        source="https://docs.xtreme1.io/xtreme1-docs/export-data/data-annotation-result",
    ),
    "labelcloud": FormFacts(
        title="labelCloud",
        holds="boxes and classes; one file a frame, written as vertices",
        real_files="no real file seen",
        source="https://ch-sa.github.io/labelCloud",
    ),
}
"""By the names of :mod:`farfield.datasets.labels.formats`."""

RESULT_FORMS: Mapping[str, FormFacts] = {
    "boxes-csv": LABEL_FORMS["boxes-csv"],
    "kitti": FormFacts(
        title="KITTI, a file a frame",
        holds="boxes in the camera's axes, classes, scores, 2D boxes",
        real_files="labels of 17 frames of the object benchmark",
        source="https://www.cvlibs.net/datasets/kitti/eval_object.php",
    ),
    "kitti-tracking": FormFacts(
        title="KITTI, a file a sequence",
        holds="boxes in the camera's axes, classes, scores, tracks",
        real_files="detections and labels of ten sequences",
        source="https://www.cvlibs.net/datasets/kitti/eval_tracking.php",
    ),
    "nuscenes": FormFacts(
        title="nuScenes' results",
        holds="boxes in the world, classes, scores, velocities, attributes or tracks; one JSON",
        real_files="28,022 real detections, scored as the devkit scores them to 2e-14",
        source="https://www.nuscenes.org/object-detection",
    ),
    "argoverse2": FormFacts(
        title="Argoverse 2's submissions",
        holds="boxes in the ego vehicle's coordinates, categories, scores, stamps; one feather table",
        real_files="test data of av2-api: three sweeps; annotations of two real sweeps",
        source="https://github.com/argoverse/av2-api/blob/main/src/av2/evaluation/detection/eval.py",
    ),
    "waymo": FormFacts(
        title="Waymo's Objects and Submission",
        holds="boxes in the vehicle's coordinates, types, scores, levels, points; protobuf",
        real_files="Waymo's own metric test: 1,010 annotated and 2,263 predicted boxes",
        source="https://github.com/waymo-research/waymo-open-dataset",
    ),
    "kradar": FormFacts(
        title="folders of K-Radar's kit by condition",
        holds="boxes, classes, scores, annotated boxes, time, road and weather; KITTI's columns with exchanged axes",
        real_files="no real file seen",
        source="https://github.com/kaist-avelab/K-Radar/blob/main/utils/util_pipeline.py",
    ),
    "openpcdet": FormFacts(
        title="OpenPCDet's result texts",
        holds="boxes in the camera's axes, classes, scores, 2D boxes; a file a frame",
        real_files="no real file seen",
        source="https://github.com/open-mmlab/OpenPCDet/blob/master/pcdet/datasets/kitti/kitti_dataset.py",
    ),
    "mmdetection3d": FormFacts(
        title="mmdetection3d's inferencer JSON",
        holds="boxes of the LiDAR or the camera, numbered classes, scores, velocities; a file a frame",
        real_files="no real file seen",
        source="https://github.com/open-mmlab/mmdetection3d/blob/main/mmdet3d/apis/inferencers/base_3d_inferencer.py",
    ),
}
"""By the names of :mod:`farfield.metrics.box_files` and :mod:`farfield.datasets.result_files`."""

CLOUD_FORMS: Mapping[str, FormFacts] = {
    ".pcd": FormFacts(
        title="PCD",
        holds="points with named columns; text, binary and packed",
        real_files="files of SensorsCalibration, PandaSet and SUSTechPOINTS",
        source="https://pointclouds.org/documentation/tutorials/pcd_file_format.html",
    ),
    ".bin": FormFacts(
        title="float32 rows",
        holds="x, y, z, intensity and more; columns are decided from the data",
        real_files="sweeps of KITTI, View-of-Delft and TJ4DRadSet",
        source="docs/own-data.md",
    ),
    ".npy": FormFacts(
        title="NumPy",
        holds="rows of x, y, z and intensity, or an array of named columns",
        real_files=_OWN,
        source="https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html",
    ),
    ".npz": FormFacts(
        title="NumPy's archive",
        holds="one array of rows, or an array a column by its name",
        real_files="no real file seen",
        source="https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html",
    ),
    ".xyz": FormFacts(
        title="text",
        holds="a point a line: x, y, z, perhaps intensity and more",
        real_files="Luminar sweeps in Cirrus' layout",
        source="docs/own-data.md",
    ),
    ".ply": FormFacts(
        title="PLY",
        holds="the numbers of an element vertex; text, binary of either order",
        real_files="a sweep of Argoverse 1",
        source="https://paulbourke.net/dataformats/ply/",
    ),
    ".las": FormFacts(
        title="LAS",
        holds="points with named columns, versions 1.0 to 1.4, point formats 0 to 10, in metres",
        real_files="no real file seen",
        source="https://github.com/ASPRSorg/LAS",
    ),
    ".laz": FormFacts(
        title="LAZ, packed LAS (extra las)",
        holds="as LAS",
        real_files="50 sweeps of aiMotive",
        source="https://laszip.org",
    ),
    ".ffcloud": FormFacts(
        title="Farfield's cache", holds="all columns, binary", real_files=_OWN, source="docs/own-data.md"
    ),
}
"""By the suffixes of :data:`farfield.frame.cloud.CLOUD_SUFFIXES`."""
