"""Positions with their sigmas as somebody else states them, to compare solutions with: a TOML file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.estimation.statistics import finite_or_none
from radioloc.parameters.maps import MAP_TIE
from radioloc.report.position_table import METHODS
from radioloc.studies.schema import Hints, TomlTable, check, entry
from radioloc.studies.study_file import Place, position_of, toml_content

_AXES = ("east", "north", "up")


@dataclass(frozen=True, slots=True)
class StatedPosition(Place):
    """Keys of ``[positions.NAME]``: a position, and what is known of it.

    Parameters
    ----------
    method : {"tracking", "images"}
    sigma_m : float or tuple of float, or None
        Standard deviations east and north, m; without them the position is shown, but not tested.
    sigma_up_m : float or None
        Of the height, which has no part in a test without it.
    map : str or None
        The map on which it was read, whose tie it has in common with all that was read there.
    map_sigma_m : float or tuple of float, or None
        Sigmas of that tie, in addition.
    """

    method: str = entry("tracking", choices=METHODS)
    sigma_m: tuple[float, float] | None = entry(None, positive=True, kind=float | tuple[float, float])
    sigma_up_m: float | None = entry(None, positive=True)
    map: str | None = None
    map_sigma_m: tuple[float, float] | None = entry(None, positive=True, kind=float | tuple[float, float])

    def __post_init__(self) -> None:
        for key in ("sigma_m", "map_sigma_m"):
            if isinstance(value := getattr(self, key), int | float):
                object.__setattr__(self, key, (float(value),) * 2)
        check(self)


def read_stated(path: Path) -> list[dict[str, Any]]:
    """The positions of a file, with the keys of ``solution.json`` as far as they have them.

    Raises
    ------
    InputError
        The file cannot be read or holds no positions; the message names table and key.
    """
    top = TomlTable(path, "", toml_content(path), Hints())
    positions = top.table("positions")
    top.finish()
    if positions is None:
        top.fail("positions", "is missing; each position is a table [positions.NAME]")
    return [_content(table, name) for name, table in positions.named().items()]


def _content(table: TomlTable, name: str) -> dict[str, Any]:
    given = table.read(StatedPosition)
    place = position_of(table, given)
    if not place.frame.startswith("ME_"):
        table.fail("frame", f"must be mean-Earth axes, such as ME_DE421, not {place.frame!r}")
    if (given.map is None) != (given.map_sigma_m is None):
        table.fail("map", "belongs to map_sigma_m; give both or neither")
    sigma_m = np.array([*(given.sigma_m or (math.nan,) * 2), given.sigma_up_m or math.nan])
    ties_m = given.map_sigma_m or ()
    total_m2 = sigma_m**2
    total_m2[: len(ties_m)] += np.square(ties_m)
    longitude_deg, latitude_deg, height_m = place.selenographic
    me = {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg, "height_m": height_m}
    known = np.isfinite(total_m2)
    covariance = np.where(np.outer(known, known), np.diag(total_m2), math.nan)
    return {
        "name": given.name or name,
        "method": given.method,
        "converged": True,
        "position": {
            "me": {"frame": place.frame, **me} | dict(zip(("x_m", "y_m", "z_m"), place.xyz_m, strict=True))
        },
        "sigma": {
            f"{axis}_m": finite_or_none(math.sqrt(value))
            for axis, value in zip(_AXES, total_m2.tolist(), strict=True)
        },
        "covariance": {"enu_m2": covariance},
        "considered": [
            {"name": f"{MAP_TIE.name}.{given.map}.{axis}", "position_enu_m": tie_m * np.eye(3)[k]}
            for k, (axis, tie_m) in enumerate(zip(_AXES, ties_m, strict=False))
        ],
        "fit": {"used": None, "rejected": None},
        "reference": None,
        "provenance": {},
    }
