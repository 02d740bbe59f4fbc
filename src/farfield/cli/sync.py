"""``farfield sync``: match the streams of a recording to one of them, and say what their clocks do."""

from pathlib import Path
from typing import Literal

import tyro

from farfield.cli._output import check_outputs, would_write


def run(
    path: tyro.conf.Positional[Path],
    /,
    *,
    to: str | None = None,
    tolerance_ms: float | None = None,
    unit: Literal["auto", "s", "ms", "us", "ns"] = "auto",
    stamp: Literal["header", "log"] = "header",
    out: Path | None = None,
    dry_run: bool = False,
) -> int:
    """Match the streams of a recording to one of them, and say what their clocks do.

    examples:
      farfield sync fog_6_0 --to Navtech_Polar
      farfield sync 2011_09_26 --to velodyne_points --out runs/sync
      farfield sync stamps/ --to lidar --tolerance-ms 17
      farfield sync drive.mcap --to /os/points

    Reads KITTI raw's timestamps, folders of lists of stamps (RADIATE's, dates, numbers, CSV; one file a stream),
    ROS 2 bags, and the times of the data sets that open_dataset opens. Logs of ptp4l and phc2sys beside the lists are
    read too. Writes matches.csv (one a drive), sync.json and sync.html.

    Args:
        path: Folder of the recording, or of several.
        to: The stream to which the others are matched (default: the slowest that shares time with most).
        tolerance_ms: Largest distance (default: half the period of the faster stream of each pair).
        unit: Unit of plain numbers that do not say theirs.
        stamp: Stamps of a bag's messages: their headers', or log, when they were recorded.
        out: Folder to write into (default: runs/sync-NAME).
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.errors import ConfigError
    from farfield.files.atomic import readable
    from farfield.pages.sync_page import write_synchronised
    from farfield.sync.sources import recordings
    from farfield.sync.synchronising import describe, reference_of
    from farfield.vocabulary.counts import count_of

    if tolerance_ms is not None and not 0 <= tolerance_ms < 1e9:
        raise ConfigError(f"--tolerance-ms: expected 0 or more milliseconds, got {tolerance_ms:g}")
    name = readable(path.resolve().name)
    tolerance_ns = None if tolerance_ms is None else round(tolerance_ms * 1e6)
    folder = out or Path("runs") / f"sync-{name}"
    check_outputs((path,), folders={"--out": folder})
    read = recordings(path, unit=unit, stamp=stamp)
    if dry_run:
        streams = [describe(recording) for recording in read]
        for recording, described in zip(read, streams, strict=True):
            reference_of(recording.name, described, to)
        messages = sum(health.count for described in streams for health in described.values())
        held = f"{count_of(messages, 'message')} of {count_of(sum(map(len, streams)), 'stream')}"
        would_write(f"the matches of {held}", folder)
        return 0
    synchronised = write_synchronised(
        folder,
        read,
        to=to,
        tolerance_ns=tolerance_ns,
        title=f"Synchronisation of {name}",
    )
    for drive in synchronised:
        print(
            f"{drive.name}: matched to {drive.reference}, {count_of(drive.streams[drive.reference].count, 'message')}"
        )
        for stream, pair in drive.pairs.items():
            clock = pair.clock
            drift = "" if clock is None else f", drift {clock.drift_ppm:+.3f} ± {clock.drift_se_ppm:.3f} ppm"
            usual = f", {pair.usual} than {drive.reference}, worst {pair.worst_ns / 1e6:.3f} ms" if pair.matched else ""
            print(f"  {stream}: {pair.matched:,} matched{usual}{drift}")
        print("".join(f"  note: {finding}\n" for finding in drive.findings), end="")
    print(f"report: {(folder / 'sync.html').resolve()}")
    return 0
