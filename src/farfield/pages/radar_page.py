"""Radar frames as one self-contained page, and as a PNG each."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from farfield.figures.radar import STANDING_M_S, frame_words, radar_picture
from farfield.figures.style import data_uri, figure_bytes
from farfield.files.atomic import write_bytes, write_text
from farfield.inspection.radar_frame import RadarLook
from farfield.jobs.folders import held
from farfield.pages.template import PageImage, render_template
from farfield.vocabulary.counts import count_of

_DPI = 130


def write_radar(folder: Path | str, looks: Sequence[RadarLook], *, title: str) -> tuple[Path, list[Path]]:
    """Write ``radar.html`` and a PNG a frame into a folder, each all or nothing.

    Args:
        folder: Made if absent.
        looks: The frames.
        title: Title of the page.

    Returns:
        The page, and the pictures.
    """
    folder = Path(folder)
    with held(folder):
        folder.mkdir(parents=True, exist_ok=True)
        pictures, paths = [], []
        for look in looks:
            content = figure_bytes(radar_picture(look), "png", dpi=_DPI)
            paths.append(folder / f"radar-{look.key[0]}-{look.key[1]}.png")
            write_bytes(paths[-1], content)
            heading = frame_words(look)
            alt = f"Camera, radar power, Doppler and detected echoes of {heading}"
            pictures.append(PageImage(data_uri(content, "image/png"), alt, caption(look), heading))
        page = render_template(
            "radar.html", title=title, pictures=pictures, any_simulated=any(look.simulated for look in looks)
        )
        write_text(folder / "radar.html", page)
    return folder / "radar.html", paths


def caption(look: RadarLook) -> str:
    """What was found in a frame, in sentences."""
    echoes = look.views.echoes
    if echoes is None:
        return "A cube has power alone: no Doppler, and no polar map to search for echoes."
    echoes_left, over_ground = ~echoes.side_lobe, look.over_ground_m_s
    text = (
        f"{count_of(len(echoes), 'cell', spec=',')} detected, "
        f"{int(echoes.side_lobe.sum()):,} of which may be side lobes"
    )
    text += f"; {int((echoes.peak & echoes_left).sum()):,} peaks."
    if look.velocity_m_s is None or over_ground is None:
        return text + " Nothing says how the car moved: velocities are wrapped. Give its speed to unwrap them."
    moving = int((echoes_left & (np.abs(over_ground) > STANDING_M_S)).sum())
    speed = float(np.linalg.norm(look.velocity_m_s))
    return text + (
        f" The radar moved at {speed:.1f} m/s ({look.velocity_from}); "
        f"{count_of(moving, 'cell does', 'cells do', spec=',')} not fit what stands still. "
        "What moves over the ground by more than half the radar's span gets a wrong multiple of it."
    )
