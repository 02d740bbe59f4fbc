"""``farfield depth``: dense depth maps of a data set's cameras from its LiDAR."""

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, AS_THEY_ARE, Jobs, Reading
from farfield.cli._output import check_outputs, from_data, leave_card, would_write
from farfield.vocabulary.counts import count_of


def run(
    data: Positional[Path],
    *,
    out: Path,
    cloud: Annotated[str | None, tyro.conf.arg(aliases=["--clouds"])] = None,
    camera: str | None = None,
    method: Literal["auto", "rings", "delaunay", "ip-basic", "nearest", "sparse"] = "auto",
    scale: Literal["auto", "256", "128"] = "auto",
    uncertainty: bool = False,
    max_uncertainty: float = 0.0,
    max_gap_deg: float = 5.0,
    picture: Path | None = None,
    format: str | None = None,
    reading: Reading = AS_THEY_ARE,
    jobs: Jobs = ALL_CORES,
    overwrite: bool = False,
    dry_run: bool = False,
) -> None:
    """Write a dense depth map for every frame: 16-bit PNG in KITTI's convention.

    examples:
      farfield depth data/kitti --out depth/
      farfield depth data/kitti --out depth/ --uncertainty --picture first.png
      farfield depth data/kradar --cloud os2-64 --camera cam-front --out depth/ --max-uncertainty 2
      farfield depth Cirrus_dataset1 --mapping calibrated.yaml --cloud uniform --out depth/ --workers 2

    Depth is the distance along the optical axis: value / 256 in metres, 0 where there is none. Files of scale 128 note
    it in the text chunk depth_scale; depth.json has the scale of all. Depths beyond the scale's end are left out and
    counted. An interrupted run resumes.

    Args:
        data: Folder of the data set; its format is recognised.
        out: Folder to write into: depth/, uncertainty/ and depth.json.
        cloud: Which cloud (default: the first of a LiDAR).
        camera: Which camera (default: the first calibrated one).
        method: How gaps are filled: in the sensor's own rings, by a Delaunay mesh, by IP-Basic's rules, by the nearest
            pixel, or not at all; auto takes rings where they are known or can be told from the order of the points.
        scale: Steps a metre. auto takes 256, which ends at 255.996 m, unless a point of any frame lies beyond it.
        uncertainty: Write the uncertainty too.
        max_uncertainty: Leave out pixels that may be off by more metres than that; 0 keeps all.
        max_gap_deg: Neighbours further apart than this are not joined.
        picture: SVG, PNG or JPEG of the first frame's map to write.
        format: Format of the data, if it is not to be recognised.
        reading: How the files are read.
        jobs: Who does the work.
        overwrite: Make every map anew.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.depth.writing import DepthSettings, write_depth_maps

    check_outputs((data, *reading.paths), files={"--picture": picture}, folders={"--out": out})
    dataset = reading.open(data, format=format)
    settings = DepthSettings(
        cloud=cloud,
        camera=camera,
        method=method,
        scale=scale,
        max_uncertainty_m=max_uncertainty,
        uncertainty=uncertainty,
        max_gap_deg=max_gap_deg,
    )
    if picture is not None:
        from farfield.figures.style import check_picture

        check_picture(picture)
    if dry_run:
        cameras = [settings.camera] if settings.camera else list(dataset[0].cameras if len(dataset) else ())
        would_write(
            f"{count_of(len(dataset), 'frame')} of {', '.join(cameras) or 'no camera'}", out, from_data(dataset)
        )
        return
    written = write_depth_maps(
        dataset,
        out,
        settings,
        survey=jobs.options("looking for the farthest point"),
        bulk=jobs.options("writing"),
        overwrite=overwrite,
    )
    leave_card(out, "Depth maps", dataset)
    print(_said(written.outcome.written, written.outcome.skipped, written.summary))
    if picture is not None and len(dataset):
        _draw(dataset[0], settings, picture)
        print(f"picture: {picture}")


def _said(written: int, skipped: int, summary: dict[str, Any]) -> str:
    methods = ", ".join(f"{name} {count}" for name, count in summary["methods"].items())
    lines = [
        f"{written} written, {skipped} had been written before.",
        f"{summary['filled']:.0%} of the pixels filled ({methods}).",
        f"depth in metres = value / {summary['depth_scale']}, to {summary['end_m']:g} m; 0: none.",
    ]
    if summary["beyond_end"]:
        lines.append(f"{summary['beyond_end']} pixels lie beyond that and were left out; --scale 128 keeps more.")
    return "\n".join(lines)


def _draw(frame: Any, settings: Any, picture: Path) -> None:
    from farfield.depth import frame_depth
    from farfield.figures.camera import depth_picture
    from farfield.figures.style import figure_bytes, picture_kind
    from farfield.files.atomic import write_bytes

    kind = picture_kind(picture)
    depth = frame_depth(
        frame,
        cloud=settings.cloud,
        camera=settings.camera,
        method=settings.method,
        max_gap_deg=settings.max_gap_deg,
    )
    name = settings.camera or next(iter(frame.cameras))
    if settings.max_uncertainty_m:
        depth = depth.surer_than(settings.max_uncertainty_m)
    figure = depth_picture(
        depth.depth_m,
        depth.measured,
        depth.uncertainty_m,
        frame.images.get(name),
        method=depth.method,
        title=f"{'/'.join(frame.key)}: ",
    )
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(picture, figure_bytes(figure, kind))
