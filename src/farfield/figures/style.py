"""Colours and type shared by every figure and by the page, and figures as bytes that a page can hold."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from farfield.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, RULE, PAPER = "#17212b", "#5d6b7a", "#d8dee5", "#ffffff"
ANNOTATED, PREDICTED = "#0b6e99", "#d9480f"  # blue and orange stay apart for every common colour blindness
POINT = "#8a97a5"
PATTERNS = ("#0b6e99", "#c2255c", "#2b8a3e", "#e67700")  # one colour a result: Gaussian, uniform, ...
SIDES = ("#0b6e99", "#d9480f")  # of two data sets side by side
THRESHOLDS = ("#9fb6c9", "#5f8fb3", "#0b6e99", "#063a52")  # 0.5, 1, 2, 4 m: light to dark

Kind = Literal["svg", "png", "jpg"]
_KINDS: dict[str, Kind] = {".svg": "svg", ".png": "png", ".jpg": "jpg"}

_RC: Any = {
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 8.5,
    "text.color": INK,
    "axes.labelcolor": MUTED,
    "axes.edgecolor": RULE,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # not measured: nothing of ours stands above an axes but its title
    "axes.axisbelow": True,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "grid.color": "#e9edf1",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "svg.hashsalt": "farfield",
    "svg.fonttype": "path",
}


@contextmanager
def house_style() -> Iterator[None]:
    """Within the block, matplotlib draws in the house's style."""
    import matplotlib as mpl

    with mpl.rc_context(_RC):
        yield


def new_figure(width_in: float, height_in: float, *, fixed: bool = False) -> "Figure":
    """Return an empty figure that belongs to no window and no global state.

    Args:
        width_in: Its width, inches.
        height_in: Its height.
        fixed: Leave the axes where they are put, instead of measuring every text to find room, which takes half of the
            time of drawing.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout=None if fixed else "constrained")
    FigureCanvasAgg(figure)
    return figure


def figure_bytes(figure: "Figure", kind: Kind = "svg", *, dpi: int = 170) -> bytes:
    """Draw a figure into bytes; equal figures give equal bytes.

    Args:
        figure: The figure.
        kind: ``"svg"`` (points inside stay raster where the figure marks them so), ``"png"`` or ``"jpg"``.
        dpi: Pixels an inch of raster parts.
    """
    buffer = io.BytesIO()
    _plain_logarithms(figure)
    metadata = {"svg": {"Date": None, "Creator": "Farfield"}, "png": {"Software": "Farfield"}, "jpg": None}[kind]
    with house_style():
        if kind == "svg":
            _draw_svg(figure, buffer, dpi, metadata)
        else:
            figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def _plain_logarithms(figure: "Figure") -> None:
    """Write the numbers between powers of ten as 2, 3, 6: a short logarithmic axis labels them, as 6 x 10^0."""
    from matplotlib.ticker import LogFormatter, LogFormatterSciNotation

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log" and isinstance(axis.get_minor_formatter(), LogFormatterSciNotation):
                axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))


def _draw_svg(figure: "Figure", buffer: io.BytesIO, dpi: int, metadata: Any) -> None:
    """Draw once: ``savefig`` draws everything twice, to know the extent of what it then draws whole."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    before, canvas = figure.dpi, figure.canvas
    figure.dpi = dpi
    try:
        FigureCanvasSVG(figure).print_svg(buffer, metadata=metadata)
    finally:
        figure.dpi = before
        figure.set_canvas(canvas)


def data_uri(content: bytes, mime: str) -> str:
    """Return bytes as a ``data:`` address, so that a page needs no file beside it."""
    return f"data:{mime};base64,{base64.b64encode(content).decode('ascii')}"


def figure_uri(figure: "Figure", kind: Kind = "svg", *, dpi: int = 170) -> str:
    """Return a figure as a ``data:`` address."""
    mime = {"svg": "image/svg+xml", "png": "image/png", "jpg": "image/jpeg"}[kind]
    return data_uri(figure_bytes(figure, kind, dpi=dpi), mime)


def save_figure(path: Path, figure: "Figure", *, dpi: int) -> None:
    """Draw a figure into a file of any kind that matplotlib writes, all or nothing; its folder is made.

    Raises:
        ConfigError: If the kind of picture that the file's suffix names is not known.
    """
    from farfield.files.atomic import open_atomic

    kind = path.suffix.lower().removeprefix(".") or "png"
    kinds = figure.canvas.get_supported_filetypes()
    if kind not in kinds:
        raise ConfigError(f"picture: expected a name that ends with one of {', '.join(sorted(kinds))}, got {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_atomic(path) as handle:
        figure.savefig(handle, format=kind, dpi=dpi)


def check_picture(path: Path) -> None:
    """Refuse a picture whose kind is not known.

    Raises:
        ConfigError: If the file's name does not end with .svg, .png or .jpg.
    """
    picture_kind(path)


def picture_kind(path: Path) -> Kind:
    """The kind of a picture, by the suffix of its file.

    Raises:
        ConfigError: If the suffix is not .svg, .png or .jpg.
    """
    if path.suffix.lower() not in _KINDS:
        raise ConfigError(f"picture: expected a name that ends with {', '.join(_KINDS)}, got {path.name}")
    return _KINDS[path.suffix.lower()]
