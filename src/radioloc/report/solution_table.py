"""The table of solutions: position, sigmas, fit and parameters, one column each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.estimation.combination import horizontal_ellipse
from radioloc.estimation.solution import Solution
from radioloc.report.cards import metres, sigma_text, to_sigma
from radioloc.report.image_solution import ImageSolution
from radioloc.report.point_solution import PointSolution
from radioloc.report.text_table import TextTable

_NONE = "-"
_ENU = ("east", "north", "up")


def solution_table(
    solutions: Iterable[Solution | ImageSolution | PointSolution | Mapping[str, Any]],
) -> TextTable:
    """Position, sigmas, fit and other estimated parameters of solutions, one column each.

    Parameters
    ----------
    solutions : iterable of Solution, ImageSolution, PointSolution or mapping
        A mapping is what ``solution.json`` holds.

    Raises
    ------
    InputError
        There are none.

    Examples
    --------
    >>> import radioloc
    >>> solution = radioloc.locate(radioloc.read_study("examples/apollo15/apollo15.toml"))
    >>> print(radioloc.report.solution_table([solution]).to_markdown().splitlines()[5])
    | latitude, ° N | 26.13339034 |
    """
    contents = [one if isinstance(one, Mapping) else one.to_dict() for one in solutions]
    if not contents:
        raise InputError("there is no solution to make a table of")
    columns = [_column(content) for content in contents]
    names = dict.fromkeys(name for column in columns for name in column)
    rows = [(name, *(column.get(name, _NONE) for column in columns)) for name in names]
    return TextTable(("", *(content["name"] for content in contents)), rows)


def _column(content: Mapping[str, Any]) -> dict[str, str]:
    """Cells of one solution by the names of their rows."""
    fit = content["fit"]
    cells = {"status": "converged" if content["converged"] else "not converged"}
    if content["position"]:
        cells |= _position(content)
    if "used" in fit:
        cells |= {"observations used": str(fit["used"]), "left out": str(fit["rejected"])}
    if fit.get("wrms_m") is not None:
        cells["wrms, m"] = metres(fit["wrms_m"])
    if fit.get("chi2_per_dof") is not None:
        cells["chi2/dof"] = f"{fit['chi2_per_dof']:.3g}"
    for item in content.get("parameters", ()):
        if not item["fixed"] and item["name"].split(".")[0] != "position":
            sigma = item["total_sigma"]
            value = (
                "undetermined" if sigma is None else f"{to_sigma(item['value'], sigma)} ± {sigma_text(sigma)}"
            )
            cells[f"{item['name']}, {item['unit']}"] = value
    return cells


def _position(content: Mapping[str, Any]) -> dict[str, str]:
    me = content["position"]["me"]
    cells = {
        "axes": me["frame"],
        "longitude, ° E": f"{me['longitude_deg']:.8f}",
        "latitude, ° N": f"{me['latitude_deg']:.8f}",
        "height, m": f"{me['height_m']:.3f}",
    }
    if any(content["sigma"][f"{axis}_m"] != 0.0 for axis in _ENU):  # the position was not held
        for axis in _ENU:
            cells[f"1 sigma {axis}, m"] = metres(content["sigma"][f"{axis}_m"])
        covariance = np.array(content["covariance"]["enu_m2"], dtype=np.float64)[:2, :2]
        if np.isfinite(covariance).all():
            ellipse = horizontal_ellipse(covariance)
            axes = f"{metres(ellipse.semi_major_m)} × {metres(ellipse.semi_minor_m)}"
            cells |= {"95 % ellipse, m": axes, "its azimuth, °": f"{ellipse.azimuth_deg:.0f}"}
    if (known := content.get("reference")) is not None and "east_m" in known:
        for axis in _ENU:
            cells[f"{axis} of {known['name']}, m"] = metres(known[f"{axis}_m"])
    return cells
