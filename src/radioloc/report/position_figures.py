"""Positions and their errors: estimates with their ellipses beside known places, and by length of arc."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.boundary import bare_arguments
from radioloc.errors import InputError
from radioloc.estimation.solution import ReferenceComparison, Solution, compare_with
from radioloc.report.cards import to_sigma
from radioloc.report.figures import COLORS, SCALE_95, length_unit, one_panel, style_axes
from radioloc.report.position_table import PositionRow

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

_Floats = NDArray[np.float64]

_MARKERS = {"tracking": "o", "images": "^", "image_point": "v", "stereo": "D", "joint": "s"}
_OF_REFERENCES = "+xsDo^"


class DrawnPlace(NamedTuple):
    """A position to draw: by what method, its name, how far east and north, m, and the covariance of both, m^2."""

    method: str
    name: str
    at_m: tuple[float, float]
    covariance_m2: _Floats | None = None

    @classmethod
    def of_row(cls, row: PositionRow, covariance_m2: _Floats | None) -> DrawnPlace:
        """A row of a table, as far from the benchmark as that says."""
        return cls(row.method, row.name, (-(row.west_m or 0.0), row.north_m or 0.0), covariance_m2)


def marker_style(method: str, number: int) -> dict[str, Any]:
    """How the first, second ... estimate is marked; black and open if it is a reference, not to hide another."""
    style: dict[str, Any] = {"markersize": 8, "linestyle": ""}
    if method != "reference":
        color = COLORS[number % (len(COLORS) - 1)]
        return style | {"marker": _MARKERS.get(method, "o"), "color": color, "markeredgecolor": "white"}
    from matplotlib.patheffects import withStroke

    style |= {"color": "black", "fillstyle": "none", "markeredgewidth": 1.4}
    halo = withStroke(linewidth=3.0, foreground="white")
    return style | {"marker": _OF_REFERENCES[number % len(_OF_REFERENCES)], "path_effects": [halo]}


def draw_places(axes: Axes, places: Sequence[DrawnPlace], origin: str) -> None:
    """Draw positions about one of them, and the ellipses of 95 % of those that have a covariance."""
    corners_m = []
    for place in places:
        size_m = 0.0 if place.covariance_m2 is None else SCALE_95 * np.sqrt(np.diag(place.covariance_m2))
        corners_m += [np.add(place.at_m, size_m), np.subtract(place.at_m, size_m)]
    factor = draw_square(axes, np.array(corners_m), origin)
    seen = {True: 0, False: 0}
    for place in places:
        known = place.method == "reference"
        style = marker_style(place.method, seen[known])
        seen[known] += 1
        if place.covariance_m2 is not None:
            ellipse = error_ellipse(place.at_m, place.covariance_m2, SCALE_95, factor)
            ellipse.set(facecolor=(style["color"], 0.08), edgecolor=style["color"], linewidth=1.1)
            axes.add_patch(ellipse)
        axes.plot(*np.multiply(factor, place.at_m), label=place.name, zorder=3, **style)
    axes.set_title("ellipses of 95 %", fontsize=8, color="0.3")


def draw_square(axes: Axes, corners_m: _Floats, origin: str) -> float:
    """A square with room around the corners, shape (n, 2), with its labels; the factor from metres to its unit."""
    lowest_m, highest_m = corners_m.min(axis=0), corners_m.max(axis=0)
    reach_m = 0.58 * float((highest_m - lowest_m).max()) or 1.0
    factor, unit = length_unit(reach_m)
    style_axes(axes)
    axes.set_aspect("equal")
    middle = 0.5 * factor * (lowest_m + highest_m)
    axes.set_xlim(middle[0] - factor * reach_m, middle[0] + factor * reach_m)
    axes.set_ylim(middle[1] - factor * reach_m, middle[1] + factor * reach_m)
    axes.set_xlabel(f"east of {origin} ({unit})")
    axes.set_ylabel(f"north of {origin} ({unit})")
    return factor


@bare_arguments
def plot_position(
    solution: Solution,
    reference_pa_m: ArrayLike | None = None,
    reference_name: str | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the estimate east and north of a known position, with the ellipses of one sigma and of 95 %.

    Parameters
    ----------
    solution : Solution
        What to draw, with all its references; ellipses are those of the total covariance.
    reference_pa_m : array_like, shape (3,), optional
        The position at the origin, principal axes, m; the first reference of the solution by default, or else the
        estimate itself.
    reference_name : str, optional
        What that is.
    ax : matplotlib.axes.Axes, optional
        Axes to draw in, in place of a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        Shows itself in a notebook; save it with :func:`~radioloc.report.save_figure`.

    Raises
    ------
    InputError
        The position is held or not determined, so it has no error ellipse.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> radioloc.plot_position(solution).axes[0].get_xlabel()
    'east of JPL, DE421 solution (m)'
    """
    if not (solution.position_estimated and solution.position_determined):
        raise InputError("the position is held or not determined, so there is no error ellipse to draw")
    known = solution.known
    if reference_pa_m is not None:
        known.insert(0, compare_with(solution, reference_pa_m, reference_name or "reference"))
    origin_m = np.array([known[0].east_m, known[0].north_m] if known else [0.0, 0.0])
    others_m = [origin_m - (one.east_m, one.north_m) for one in known]
    sigmas_m = solution.sigma_enu_m()
    reach_m = SCALE_95 * sigmas_m[:2]
    of = f" of {solution.targets[0].name}" if solution.targets else ""
    axes = one_panel(ax, 5.2, 5.6, f"{solution.name}: position{of}")
    corners_m = np.array([origin_m - reach_m, origin_m + reach_m, *others_m])
    factor = draw_square(axes, corners_m, known[0].name if known else "the estimate")
    covariance_m2 = solution.position_covariance("enu")[:2, :2]
    for scale, opacity, label in ((SCALE_95, 0.15, "95 %"), (1.0, 0.3, "1 sigma")):
        ellipse = error_ellipse(origin_m, covariance_m2, scale, factor)
        ellipse.set(facecolor=(COLORS[0], opacity), edgecolor=COLORS[0], linewidth=0.9, label=label)
        axes.add_patch(ellipse)
    axes.plot(*(factor * origin_m), label="estimate", **marker_style("tracking", 0))
    for k, (one, at_m) in enumerate(zip(known, others_m, strict=True)):
        axes.plot(*(factor * at_m), label=one.name, **marker_style("reference", k))
    axes.legend(loc="best", fontsize=8, frameon=True, framealpha=0.9, edgecolor="0.8")
    axes.set_title("\n".join(_caption(solution, known)), fontsize=8, color="0.3")
    return axes.figure.figure


def _caption(solution: Solution, known: Sequence[ReferenceComparison]) -> list[str]:
    """Where the estimate is, how well that is known, and how far from the first known position."""
    longitude_deg, latitude_deg, height_m = solution.selenographic
    of_degrees = np.degrees(np.sqrt(np.diag(solution.position_covariance("geographic"))[:2]))
    sigmas_m = solution.sigma_enu_m()
    place = (
        f"{to_sigma(longitude_deg, of_degrees[0])}\N{DEGREE SIGN} E, {to_sigma(latitude_deg, of_degrees[1])}"
        f"\N{DEGREE SIGN} N, {to_sigma(height_m, sigmas_m[2])} m ({solution.me_frame})"
    )
    factor, unit = length_unit(float(max(sigmas_m)))
    east, north, up = (f"{factor * sigma_m:.3g}" for sigma_m in sigmas_m)
    sigmas = f"1 sigma: east {east}, north {north}, up {up} {unit}"
    if known:
        factor, unit = length_unit(known[0].horizontal_m)
        sigmas += f"; offset {factor * known[0].horizontal_m:.3g} {unit}"
    return [place, sigmas]


def error_ellipse(
    centre_m: Sequence[float] | _Floats, covariance_m2: _Floats, scale: float, factor: float
) -> Ellipse:
    """An error ellipse with axes of so many sigmas, in the unit that a factor leads to from metres."""
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(covariance_m2)
    width, height = 2.0 * factor * scale * np.sqrt(np.maximum(variances, 0.0))
    azimuth_deg = math.degrees(math.atan2(directions[0, 1], directions[1, 1])) % 180.0
    return Ellipse((factor * centre_m[0], factor * centre_m[1]), width, height, angle=-azimuth_deg)
