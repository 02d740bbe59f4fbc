"""``farfield anonymize``."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from farfield.cli._flags import ALL_CORES, Jobs
from farfield.cli._output import check_outputs, from_files, would_write
from farfield.vocabulary.counts import count_of


def run(
    path: Positional[Path],
    out: Positional[Path],
    *,
    how: Literal["fill", "pixelate", "blur"] = "fill",
    series: Literal["time", "single"] = "time",
    stereo: tuple[str, ...] = (),
    side_by_side: tuple[str, ...] = (),
    small_faces: bool = False,
    plates: bool = True,
    jobs: Jobs = ALL_CORES,
    dry_run: bool = False,
) -> None:
    """Cover faces and number plates in all pictures and films below a folder; originals are only read.

    examples:
      farfield anonymize Cirrus_dataset1 covered
      farfield anonymize data/kitti_raw covered --stereo image_02:image_03
      farfield anonymize photos covered --series single --how pixelate
      farfield anonymize street.jpg covered --small-faces
      farfield anonymize dash.mp4 covered
      farfield anonymize photos covered --no-plates

    Writes them under the same names without metadata or sound, anonymized.jsonl, which lists what was covered where and
    why, and anonymized.html with the doubtful cases. After an interruption the same command resumes.

    Args:
        path: A folder, such as a data set's, or one picture (.jpg, .png) or film (.mp4, ...: extra video).
        out: Folder to write into; not the first, nor below it.
        how: Fill with the colour around, or keep a few cells, with or without edges; none can be undone.
        series: Whether the pictures of a folder follow one another, so that a face that is missed once stays covered.
        stereo: Folders of two eyes, LEFT:RIGHT; the names that KITTI, RADIATE and Argoverse give them are known.
        side_by_side: Folders whose pictures hold both eyes beside each other; K-Radar's are known.
        small_faces: Look at twice the size too: finds faces below 15 pixels, in five times the time.
        plates: Cover number plates too (extra detect).
        jobs: Who does the work.
        dry_run: Say what would be written, and write nothing.
    """
    from farfield.errors import ConfigError
    from farfield.pages.privacy_page import write_privacy_page
    from farfield.privacy import AnonymizeOptions, anonymise, check_apart
    from farfield.privacy.anonymising import count_covers
    from farfield.privacy.detectors import PLATES_MISSED
    from farfield.privacy.image_boxes import FACE, PLATE
    from farfield.privacy.sources import PAIRS, SIDE_BY_SIDE, find_side_by_side, find_sources, find_stereo_pairs

    named = [tuple(pair.split(":")) for pair in stereo]
    if any(len(pair) != 2 for pair in named):
        raise ConfigError(f"--stereo: expected LEFT:RIGHT, the names of two folders; got {' '.join(stereo)}")
    eyes = (*((pair[0], pair[1]) for pair in named), *PAIRS)
    check_outputs((path,), folders={"out": out})
    sources = find_sources(path)
    chosen = AnonymizeOptions(how=how, small_faces=small_faces, plates=plates, together=series == "time")
    if chosen.without_plates():
        print(f"Number plates stay as they are: {chosen.without_plates()}")
    if dry_run:
        check_apart(sources.root, out)
        pictures = [sources.root / file for folder in sources.folders for file in folder.files]
        films = [sources.root / file for file in sources.films]
        counts = (
            f"{count_of(len(pictures), 'picture')} of {count_of(len(sources.folders), 'folder')} "
            f"and {len(films)} films, covered,"
        )
        would_write(counts, out, from_files([*pictures, *films]))
        return
    summaries = anonymise(
        sources,
        out,
        chosen,
        pairs=find_stereo_pairs(sources.folders, eyes),
        both=find_side_by_side(sources.folders, (*side_by_side, *SIDE_BY_SIDE)),
        find=jobs.options("finding"),
        cover=jobs.options("covering"),
    )
    write_privacy_page(out / "anonymized.html", out, summaries, title=f"Covered: {path.name or path}")
    if series == "time" and not all(folder.stamped for folder in sources.folders):
        print("Names are no stamps: pictures of a folder count as 0.1 s apart, or give --series single.")
    print(
        f"{count_of(len(summaries), 'picture', spec=',')} and frames; one cover "
        f"is one box in one of them: {out / 'anonymized.html'}"
    )
    with_plates = plates and not chosen.without_plates()
    for kind, name in ((FACE, "Faces"), (PLATE, "Number plates"))[: 1 + with_plates]:
        tracks, covers = count_covers(summaries, kind, together=chosen.together)
        doubtful = sum(row["kind"] == kind for summary in summaries for row in summary.doubtful)
        print(
            f"{name}: {tracks:,} followed over time, {count_of(covers, 'cover', spec=',')}, "
            f"{doubtful:,} of them doubtful"
        )
    if not with_plates:
        print("Number plates: left as they are, all of them")
        return
    missed, measured = PLATES_MISSED
    print(
        f"Known to be missed: {missed} of {measured} number plates in photographs ({missed / measured:.0%}); "
        "measured in benchmarks/results/privacy.txt (docs/privacy.md). Look through the pictures before you show them."
    )
