"""The house style: fonts, colours, new figures, without global changes."""

import contextlib
import io
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import matplotlib
import numpy as np
from matplotlib.animation import Animation, FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from ..base.checks import one_of, positive, refuse
from ..base.files import target, write
from ..base.types import Count, Scalar
from ..base.units import SCALED, SI
from ..base.units.names import known_unit, readable

AxesOrNone: TypeAlias = Axes | None
"""Axes to draw into, `None` for a new figure."""

# Okabe and Ito (2008): blue, vermilion, green, orange, sky, purple, black
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#000000")
DASHES = ("-", "--", "-.", ":")
FAINT = "0.55"
HERTZ = known_unit("Hz")
# A label that ends with a unit.
BRACKET = re.compile(r"(.*\S)\s*[([]([^)\]]+)[)\]]\s*$")
OMEGA = r"angular frequency $\omega$"
# Numbers may lie beyond a colour bar by this fraction of its range, because of rounding.
ROUNDING = 1e-6
# The width of a letter of a legend [points].
LETTER = 4.6
# The width of a handle of a legend, in letters.
HANDLE = 5
# A legend with more rows than this has smaller letters.
ROWS = 3
# The size of these letters over the usual one.
SMALLER = 0.75

_STYLE = {
    "font.size": 10.0,
    "axes.labelsize": 10.0,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "figure.dpi": 100.0,
    "savefig.dpi": 200.0,
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Set the house style in a context: `with gx.plots.style(): ...` for your own Axes.

    **Example:**

    >>> with gx.plots.style():
    ...     ax = plt.figure().add_subplot()
    >>> ax.spines["top"].get_visible()
    False
    """
    # matplotlib's own context would undo the settings of a notebook backend that is loaded inside.
    kept = {name: matplotlib.rcParams[name] for name in _STYLE}
    matplotlib.rcParams.update(_STYLE)
    try:
        yield
    finally:
        matplotlib.rcParams.update(kept)


def figure(width: Scalar = 5.0, height: Scalar = 3.6) -> Figure:
    """Return an empty figure without a window; fill it by `.subplots(rows, columns)` in `style()`.

    **Arguments:** `width`, `height` [inch]. **Returns:** a matplotlib `Figure` with automatic
    layout. **Raises** ValueError for sizes that are not above zero.
    """
    size = float(positive("width", width)), float(positive("height", height))
    with style():
        made = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(made)
    return made


def save(made: Any, path: str | Path, *, dpi: Scalar = 200) -> Path:
    """Write a plot in the format of the path's ending (png, pdf, svg; gif, mp4 for animations).

    **Arguments:** `made`: a figure, Axes, or several Axes of one figure in an array, a list or a
    dict: the whole figure is written. Or a matplotlib animation; mp4 needs ffmpeg. `dpi`: dots per
    inch. **Returns:** the path. No partial file is left. **Raises** ValueError for Axes of several
    figures, another ending, or a path that cannot be written; OSError if writing fails
    (a full disk).

    **Example:**

    >>> ax = gx.plots.transmission([0.3, 0.6, 1.0], [0.6, 0.2, 1.0])
    >>> gx.plots.save(ax, "square.png").name
    'square.png'
    """
    path = target("path", path)
    return write(path, drawn(made, path.suffix, dpi=dpi))


def drawn(made: Any, ending: str, *, dpi: Scalar = 200) -> bytes:
    """Return the bytes of a `save` file with this ending: `".png"`, `".pdf"`, `".svg"`."""
    dpi = float(positive("dpi", dpi))
    if isinstance(made, Animation):
        return _moving(made, ending, dpi)
    picture = _figure(made)
    known = [f".{name}" for name in picture.canvas.get_supported_filetypes()]
    kind = one_of("ending", ending.lower(), known)[1:]
    buffer = io.BytesIO()
    with style():
        picture.savefig(buffer, format=kind, dpi=dpi, facecolor="white")
    return buffer.getvalue()


def _moving(made, ending, dpi):
    # An animation's bytes, by a temporary file, since its writers need one.
    writers = {".gif": "pillow"} | {
        end: "ffmpeg" for end in (".mp4", ".webm") if FFMpegWriter.isAvailable()
    }
    ending = one_of("ending", ending.lower(), list(writers))
    with tempfile.TemporaryDirectory(prefix="granjax-") as folder:
        place = Path(folder) / f"animation{ending}"
        with style():
            made.save(str(place), writer=writers[ending], dpi=dpi)
        return place.read_bytes()


def _figure(made):
    if isinstance(made, dict):
        made = list(made.values())
    # The figure of a part of a figure is the whole.
    found = {artist.figure.figure for artist in np.ravel(np.asarray(made, object))}
    if len(found) != 1:
        refuse("made", "Axes of one figure", f"of {len(found)} figures", "Save them one by one.")
    return found.pop()


def axes_or_new(
    ax: Axes | Sequence[Axes] | np.ndarray | None,
    width: Scalar,
    height: Scalar,
    rows: Count = 1,
    columns: Count = 1,
    **how: Any,
) -> Axes | np.ndarray:
    """Return the given Axes, several as an array, or those of a new pyplot figure."""
    if isinstance(ax, str):
        remedy = "Other arguments have names, such as quantity='u'."
        refuse("ax", "Axes of matplotlib to draw into", repr(ax), remedy)
    if ax is not None:
        return ax if rows * columns == 1 else np.asarray(ax, dtype=object)
    import matplotlib.pyplot as plt

    with style():
        return plt.subplots(rows, columns, figsize=(width, height), layout="constrained", **how)[1]


def add_legend(ax: Axes, handles: Sequence[Artist] | None = None, *, inside: bool = False) -> None:
    """Add a legend in as many columns as fit, above the Axes or `inside` at their top.

    Inside, the upper limit of the Axes is raised for it; they may then have a title.
    """
    handles = ax.get_legend_handles_labels()[0] if handles is None else handles
    if not handles:
        return
    width, height = ax.get_window_extent().size / ax.figure.dpi * 72
    letters = max(len(str(handle.get_label())) for handle in handles) + HANDLE
    for share in (1.0, SMALLER):
        size = share * _STYLE["legend.fontsize"]
        columns = max(1, int(width / (share * LETTER) / letters))
        if len(handles) <= ROWS * columns:
            break
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    if inside:
        place = {"loc": "upper left"}
        share = 1.5 * size * (1 + -(-len(handles) // columns)) / height
        low, high = ax.get_ylim()
        ax.set_ylim(low, low + (high - low) / (1 - min(share, 0.6)))
    look = {"handlelength": 1.6, "columnspacing": 1.2, "fontsize": size}
    with style():
        ax.legend(handles=handles, ncols=min(columns, len(handles)), **place, **look)


def new_label(ax: Axes, name: str | None) -> str | None:
    """Return a label, or `None` where the legend of the Axes already has it."""
    return None if name in ax.get_legend_handles_labels()[1] else name


def colour(i: Count) -> str:
    """Return the i-th line colour, cyclically."""
    return COLOURS[i % len(COLOURS)]


def add_colour_bar(ax: Axes, image: Any, label: str, data: Any = None) -> Any:
    """Add a colour bar, pointed where the image's numbers (or `data`) exceed its ends."""
    data = np.ma.compressed(image.get_array() if data is None else data)
    norm = image.norm
    beyond = ROUNDING * (norm.vmax - norm.vmin)
    low = np.nanmin(data) < norm.vmin - beyond
    high = np.nanmax(data) > norm.vmax + beyond
    extend = ("neither", "max", "min", "both")[int(high) + 2 * int(low)]
    bar = ax.figure.colorbar(image, ax=ax, pad=0.02, extend=extend, extendfrac=0.03)
    bar.set_label(label, size=ax.yaxis.label.get_size())
    # Axes that share an axis with others may have no tick labels there.
    letters = [*ax.yaxis.get_majorticklabels(), *ax.xaxis.get_majorticklabels()]
    if letters:
        bar.ax.tick_params(labelsize=letters[0].get_size())
    return bar


def log_ticks(axis: Axis, x: Any) -> None:
    """Add ticks at 2 and 5 if the numbers of a logarithmic axis span less than two decades."""
    x = np.asarray(x)
    x = x[np.isfinite(x) & (x > 0)]
    if x.size and x.max() < 100 * x.min():
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


class Shown(NamedTuple):
    """The scale of an axis: the factor of its numbers, its label, its unit ("" for none).

    Call it with numbers to get those that are drawn.
    """

    factor: float
    label: str
    unit: str

    @property
    def after(self) -> str:
        """Text after a number: its unit, or "(scaled)"."""
        return self.unit or f"({SCALED})" * self.label.endswith(f"({SCALED})")

    def __call__(self, x: Any) -> np.ndarray | float:
        return self.factor * np.asarray(x, float)


def units_of(*results: Any) -> str | None:
    """Return the units of results (`None` for none): "SI", "scaled", or `None` if unknown.

    **Raises** ValueError where one is in SI and another scaled.
    """
    found = {getattr(x, "units", None) for x in results} & {SI, SCALED}
    if len(found) > 1:
        sentence = "One picture takes results that are all in SI or all scaled; got some of each."
        raise ValueError(sentence)
    return found.pop() if found else None


def said_by(x: Any, unit: str | None, units: str | None) -> tuple[str | None, str | None]:
    """Return the unit and unit system of numbers, first from the attributes of a variable."""
    own = getattr(x, "attrs", {}).get("units")
    return (unit, units) if own is None else (own, SCALED if own == SCALED else SI)


def shown(label: str, x: Any, unit: str | None = None, units: str | None = None) -> Shown:
    """Choose one prefix for an axis from the range of its numbers.

    **Arguments:** `label`: without the unit; or with an SI unit, "force (N)", where `unit` is
    `None`. `x`: the numbers, or the largest of them; a dataset variable has its own unit. `unit`:
    the SI unit of the numbers; "" for pure numbers, `None` if unknown. `units`: from `units_of`.

    A base unit of SI gets a prefix, and rad/s become Hz; any other unit is unchanged.
    """
    unit, units = said_by(x, unit, units)
    bracket = BRACKET.match(label)
    if unit is None and bracket:
        label = bracket[1]
        unit = bracket[2]
        known = known_unit(unit)
        # "force (N)" of a scaled result is scaled; any other unit is unchanged.
        units = units if units and known and known.size in (1.0, HERTZ.size) else SI
    if unit == "" or units is None:
        return Shown(1.0, label, "")
    if units == SCALED:
        return Shown(1.0, f"{label} ({SCALED})", "")
    known = unit and known_unit(unit)
    if not known:
        return Shown(1.0, f"{label} ({unit})" if unit else label, unit or "")
    chosen = known
    if known.size in (1.0, HERTZ.size):
        numbers = np.abs(np.asarray(x, float))
        largest = numbers[np.isfinite(numbers)].max(initial=0.0) * known.size
        chosen = readable(known, float(largest))
    if "Hz" in chosen.name:
        label = re.sub(r"angular frequency( \$\\omega[^$]*\$)?", "frequency", label)
    return Shown(known.size / chosen.size, f"{label} ({chosen.label})", chosen.label)
