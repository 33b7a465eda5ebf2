"""Common parts of all figures: making, layout, style and saving, axes of dates, and units of lengths.

Figures are made without pyplot: nothing global changes, no window opens, they work without a display, and in a notebook
each shows itself as the last line of a cell. matplotlib is imported when the first figure is made.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from radioloc.constants import UNIX_JD
from radioloc.errors import FontWarning, InputError, visible
from radioloc.text_files import replaced_file
from radioloc.time import Epochs
from radioloc.vectors import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.legend import Legend

_P = ParamSpec("_P")
_R = TypeVar("_R")

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours for all kinds of colour vision (Okabe and Ito 2008)."""

SCALE_95 = math.sqrt(-2.0 * math.log(0.05))
"""Ratio of the axes of the 95 % ellipse to those of one sigma."""

DPI = 200
"""Dots per inch of raster files."""
_MIN_LOG_RATIO = 4.0
"""Least ratio of the largest value to the smallest; a smaller span may lack ticks at 1, 2, 5, 10 ..."""
_UNITS = ((1e-3, 1e3, "mm"), (0.5, 1e2, "cm"), (1e3, 1.0, "m"), (float("inf"), 1e-3, "km"))
_MISSING_GLYPH = re.compile(r"Glyph (\d+) .*missing from")
_UNDATED = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
"""Metadata that suppress the time of writing."""


class NothingToDrawError(InputError):
    """A result lacks the content of a figure, such as a determined position."""


def draws_names_literally(plot: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a function that draws names, so that a dollar sign does not start a formula."""

    @wraps(plot)
    def draw(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        from matplotlib import rc_context

        literal: Any = {"text.parse_math": False, "text.usetex": False, "axes.formatter.use_mathtext": False}
        with rc_context(literal), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            drawn = plot(*args, **kwargs)
            _escape_control_characters(drawn)
        _repeat_warnings(caught)
        return drawn

    return draw


def _escape_control_characters(drawn: Any) -> None:
    """Replace control characters of texts by escapes, as SVG files cannot contain them."""
    from matplotlib.artist import Artist
    from matplotlib.text import Text

    figure = drawn.figure if isinstance(drawn, Artist) else None
    for text in () if figure is None else figure.findobj(Text):
        if (shown := visible(text.get_text())) != text.get_text():
            text.set_text(shown)


def _repeat_warnings(caught: Sequence[warnings.WarningMessage]) -> None:
    """Issue caught warnings again, those of missing glyphs as one."""
    missing = []
    for warning in caught:
        glyph = _MISSING_GLYPH.match(str(warning.message))
        if glyph:
            missing.append(chr(int(glyph[1])))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    if missing:
        warnings.warn(
            f"the font of the figures lacks {len(set(missing))} characters, such as {missing[0]!r}, and shows boxes; "
            "install a font that has them and add its name to font.family in a matplotlibrc file",
            FontWarning,
            stacklevel=3,
        )


def new_figure(width_in: float, height_in: float, title: str = "") -> Figure:
    """Make a figure with a title, sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    # Notebooks show a plain figure only once pyplot, with its state and its choice of a window system, is imported.
    figure._repr_png_ = lambda: to_png(figure).getvalue()  # type: ignore[attr-defined]
    if title:
        figure.suptitle(title, fontsize=11, fontweight="bold")
    return figure


def one_panel(ax: Axes | None, width_in: float, height_in: float, title: str = "") -> Axes:
    """Return `ax`, or the axes of a new figure with a title, sizes in inches."""
    return new_figure(width_in, height_in, title).add_subplot() if ax is None else ax


def several_panels(ax: Axes | None, width_in: float, height_in: float, title: str = "") -> Figure | SubFigure:
    """Return a new figure for several panels, or a subfigure in place of `ax`."""
    if ax is None:
        return new_figure(width_in, height_in, title)
    place, figure = ax.get_subplotspec(), ax.figure
    if place is None or figure is None:
        raise InputError("ax: expected axes in a grid, such as those of figure.subplots")
    ax.remove()
    part = figure.add_subfigure(place)
    part.suptitle(title, fontsize=10, fontweight="bold")
    return part


def panel_grid(
    ax: Axes | None, count: int, max_columns: int, sizes_in: tuple[Any, Any], title: str, **shared: Any
) -> tuple[Figure | SubFigure, list[Axes], int]:
    """Return a figure, its panels in a grid, and the columns; sizes are those of a panel and of the margins."""
    columns = columns_for(count, max_columns)
    rows = -(-count // columns)
    width_in, height_in = np.multiply(sizes_in[0], (columns, rows)) + sizes_in[1]
    figure = several_panels(ax, width_in, height_in, title)
    panels = list(figure.subplots(rows, columns, squeeze=False, **shared).flat)
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes in panels[:count]:
        style_axes(axes)
    return figure, panels[:count], columns


def columns_for(count: int, max_columns: int) -> int:
    """Return the number of columns, between half the maximum and the maximum, with the fewest empty places."""
    return min(
        range(min(count, max_columns), min(count, max_columns) // 2, -1), key=lambda columns: -count % columns
    )


def legend_outside(figure: Figure | SubFigure, panels: Iterable[Axes], columns: int, **style: Any) -> Legend:
    """Add a legend below all panels with the entries of some."""
    entries = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in panels)
    handles = {label: handle for pairs in entries for handle, label in pairs}
    style = {"fontsize": 8, "frameon": False} | style
    return figure.legend(handles.values(), handles, loc="outside lower center", ncols=columns, **style)


def legend_below(axes: Axes, ax: Axes | None, columns: int) -> None:
    """Add a legend below the only panel of a figure, or within given axes `ax`."""
    if ax is None:
        legend_outside(axes.figure, [axes], columns)
    else:
        axes.legend(fontsize=7, framealpha=0.85)


@draws_names_literally
def to_png(figure: Figure, dpi: float | str = "figure") -> BytesIO:
    """Return a figure as a PNG image."""
    image = BytesIO()
    figure.savefig(image, format="png", dpi=dpi)
    image.seek(0)
    return image


def style_axes(axes: Axes) -> None:
    """Apply the common style: a light grid below the data, open at the top and to the right."""
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("0.4")
    axes.tick_params(labelsize=8, color="0.4")
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)


def draw_square(axes: Axes, centre_m: Floats | Sequence[float], reach_m: float, origin: str) -> float:
    """Set the limits to a square east and north of an origin; return the factor from metres to its unit."""
    factor, unit = length_unit(reach_m)
    style_axes(axes)
    axes.set_aspect("equal")
    axes.set_xlim(factor * (centre_m[0] - reach_m), factor * (centre_m[0] + reach_m))
    axes.set_ylim(factor * (centre_m[1] - reach_m), factor * (centre_m[1] + reach_m))
    axes.set_xlabel(f"east of {origin} ({unit})")
    axes.set_ylabel(f"north of {origin} ({unit})")
    return factor


def draw_ellipse(
    axes: Axes,
    centre_m: Sequence[float] | Floats,
    covariance_m2: Floats,
    scale: float,
    factor: float,
    **style: Any,
) -> None:
    """Draw an error ellipse of `scale` sigmas; `factor` converts metres to the unit of the axes."""
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(covariance_m2)
    width, height = 2.0 * factor * scale * np.sqrt(np.maximum(variances, 0.0))
    angle_deg = -(math.degrees(math.atan2(directions[0, 1], directions[1, 1])) % 180.0)
    centre = factor * centre_m[0], factor * centre_m[1]
    axes.add_patch(Ellipse(centre, width, height, angle=angle_deg, **style))


def log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic with numbers at all ticks, unless the data span too little."""
    from matplotlib.ticker import LogLocator, NullLocator

    if not axes.dataLim.y1 > _MIN_LOG_RATIO * axes.dataLim.minposy:
        return
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())


def panel_title(axes: Axes, text: str, side: str, **style: Any) -> None:
    """Put a title at the left or right above a panel, close to its upper edge."""
    axes.ticklabel_format(axis="y", style="plain", useOffset=False)  # a factor above would need room
    axes.set_title(text, loc=side, y=1.0, pad=3, **style)  # type: ignore[arg-type]


def length_unit(size_m: float) -> tuple[float, str]:
    """Return factor from metres and name of the unit for lengths of about a size."""
    for limit_m, factor, name in _UNITS:
        if size_m < limit_m:
            return factor, name
    raise InputError(f"length: expected a finite number, got {size_m} m")


def utc_dates(epoch_utc: Epochs) -> NDArray[np.datetime64]:
    """Return UTC as numpy dates to the millisecond; a leap second becomes the midnight after it."""
    days = (epoch_utc.jd - UNIX_JD).astype(np.int64).astype("datetime64[D]")
    milliseconds = np.rint(epoch_utc.fraction * 86400e3).astype("timedelta64[ms]")
    return days.astype("datetime64[ms]") + milliseconds


WIDE_TICKS, NARROW_TICKS = (4, 9), (3, 7)
"""Least and largest number of dates on an axis, for which matplotlib finds an interval for any length of the arc."""


def date_axes(
    panels: Sequence[Axes],
    dates: NDArray[np.datetime64],
    ticks: tuple[int, int] = WIDE_TICKS,
    columns: int = 1,
) -> None:
    """Label the horizontal axes with UTC dates below the lowest panel of each column."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    locator = AutoDateLocator(minticks=ticks[0], maxticks=ticks[1])
    panels[0].xaxis.set_major_locator(locator)
    panels[0].xaxis.set_major_formatter(ConciseDateFormatter(locator))
    if dates.min() == dates.max():
        hour = np.timedelta64(1, "h")
        panels[0].set_xlim(dates.min() - hour, dates.max() + hour)
    for column in range(columns):
        lowest = panels[(len(panels) - 1 - column) // columns * columns + column]
        lowest.tick_params(labelbottom=True)
        lowest.xaxis.get_offset_text().set_fontsize(8)
        lowest.set_xlabel("UTC")


@draws_names_literally
def save_figure(figure: Figure, paths: Iterable[str | Path] | str | Path) -> None:
    """Write a figure to files in the formats of their endings, such as ``.png`` and ``.svg``.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    paths : path-like or iterable of path-like
        One or more files; raster files have 200 dots per inch.

    Raises
    ------
    InputError
        The format is not one that matplotlib writes, or a file cannot be written.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.compute_residuals(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.report.save_figure(radioloc.plot_residuals(solution), ["residuals.png", "residuals.svg"])
    """
    from matplotlib import rc_context

    files = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    endings = [path.suffix.removeprefix(".").lower() for path in files]
    formats = figure.canvas.get_supported_filetypes()
    for path, ending in zip(files, endings, strict=True):
        if ending not in formats:
            raise InputError(f"{path}: figures cannot be written as {ending!r}; use .png, .svg or .pdf")
    engine, own_dpi = figure.get_layout_engine(), figure.dpi
    # Neither the hour nor chance belongs in a figure: the same figure makes the same file. It is laid out once for all
    # its files, as that takes longer than to draw it.
    fixed: Any = {
        "svg.hashsalt": "radioloc",
        "figure.autolayout": False,
        "figure.constrained_layout.use": False,
    }
    with rc_context(fixed):
        try:
            figure.dpi = DPI
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine(None)
            for path, ending in zip(files, endings, strict=True):
                with replaced_file(path) as temporary:
                    figure.savefig(temporary, format=ending, dpi=DPI, metadata=_UNDATED.get(ending))
        finally:
            figure.dpi = own_dpi
            figure.set_layout_engine(engine)
