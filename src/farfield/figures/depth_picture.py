"""A depth map beside the camera's picture."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, UInt8

from farfield.depth.maps import DepthMap
from farfield.figures.style import figure_bytes, house_style, new_figure, picture_kind
from farfield.files.atomic import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = "turbo_r"
_TICKS_M = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 400)


def depth_picture(
    depth: DepthMap, image: UInt8[np.ndarray, "height width 3"] | None = None, *, title: str = ""
) -> "Figure":
    """Draw the picture with its measured points, the depth over it (fainter where it is less sure), the uncertainty.

    Args:
        depth: The map.
        image: The camera's picture, if there is one.
        title: What stands above.
    """
    from matplotlib.colors import LogNorm

    height, width = depth.depth_m.shape
    known = depth.depth_m[np.isfinite(depth.depth_m)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 100.0)
    norm = LogNorm(low, max(high, low * 1.01))
    sure = np.isfinite(depth.uncertainty_m).any()
    rows = 3 if sure else 2
    with house_style():
        figure = new_figure(10.0, rows * 9.0 * height / width + 0.9)
        axes = figure.subplots(rows, 1)
        grey = np.full((height, width), 0.15, np.float32) if image is None else image[..., :3].mean(axis=2) / 510
        for ax in axes:
            ax.set_axis_off()
        axes[0].imshow(grey if image is None else image, cmap="gray", vmin=0, vmax=1)
        v, u = np.nonzero(depth.measured)
        axes[0].scatter(u, v, c=depth.depth_m[v, u], s=1.2, lw=0, cmap=_COLOURS, norm=norm)
        axes[0].set_title(f"{title}{len(v):,} measured depths", fontsize=9)
        axes[1].imshow(grey, cmap="gray", vmin=0, vmax=1)
        shown = axes[1].imshow(depth.depth_m, cmap=_COLOURS, norm=norm, alpha=_certainty(depth), interpolation="none")
        filled = np.isfinite(depth.depth_m).mean()
        axes[1].set_title(f"{depth.method}: {filled:.0%} of the pixels, fainter where less sure", fontsize=9)
        ticks = [tick for tick in _TICKS_M if low <= tick <= high]
        bar = figure.colorbar(shown, ax=list(axes[:2]), label="depth in m", ticks=ticks, format="%g", shrink=0.8)
        bar.minorticks_off()
        if sure:
            doubt = axes[2].imshow(depth.uncertainty_m, cmap="magma", norm=LogNorm(0.02, 20), interpolation="none")
            axes[2].set_title("how far it may be off", fontsize=9)
            figure.colorbar(doubt, ax=axes[2], label="m", format="%g", shrink=0.8)
        for ax in axes:
            ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return figure


def write_depth_picture(
    path: Path | str, depth: DepthMap, image: UInt8[np.ndarray, "height width 3"] | None = None, *, title: str = ""
) -> None:
    """Write :func:`depth_picture` as SVG, PNG or JPEG, by the file's name.

    Raises:
        ConfigError: If it has another ending.
    """
    path = Path(path)
    kind = picture_kind(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, figure_bytes(depth_picture(depth, image, title=title), kind))


def _certainty(depth: DepthMap) -> Float32[np.ndarray, "h w"]:
    """1 where the uncertainty is a hundredth of the depth or unknown, towards 0.3 where it is as large as the depth."""
    share = np.nan_to_num(depth.uncertainty_m / depth.depth_m, nan=0.0, posinf=1.0)
    return np.where(np.isfinite(depth.depth_m), np.clip(1 - 0.7 * share, 0.3, 1), 0).astype(np.float32)
