"""What a solution of images says of its position, in dictionaries and on cards."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.ephemeris.constants import CONSTANTS
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar.position import LunarPosition
from radioloc.report.cards import Field, metres
from radioloc.report.position_table import difference

Floats = NDArray[np.float64]

ENU = ("east", "north", "up")


def position_content(
    position: LunarPosition, covariance_enu_m2: Floats, references: Mapping[str, LunarPosition]
) -> dict[str, Any]:
    """Keys of ``solution.json``: the position, its sigmas and covariance, and the first of the known ones."""
    longitude, latitude, height = position.selenographic
    pa = position.to_axes("PA", CONSTANTS["DE421"])
    return {
        "position": {
            "pa": {"frame": pa.frame, **_named("xyz", pa.xyz_m)},
            "me": {
                "frame": position.frame,
                "longitude_deg": longitude,
                "latitude_deg": latitude,
                "height_m": height,
                **_named("xyz", position.xyz_m),
            },
        },
        "sigma": _named(ENU, np.sqrt(np.diag(covariance_enu_m2))),
        "covariance": {"enu_m2": [[finite_or_none(v) for v in row] for row in covariance_enu_m2]},
        "reference": next(_beside(position, references), None),
    }


def references_of(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """All references of what ``solution.json`` holds, the first of them first."""
    first = content.get("reference")
    return [*([] if first is None else [first]), *content.get("references", ())]


def _beside(position: LunarPosition, references: Mapping[str, LunarPosition]) -> Iterator[dict[str, Any]]:
    for name, place in references.items():
        *_, west_m, north_m, up_m = difference(position.selenographic, place.selenographic)
        yield {
            "name": name,
            **dict(zip(("longitude_deg", "latitude_deg", "height_m"), place.selenographic, strict=True)),
            "east_m": -west_m,
            "north_m": north_m,
            "up_m": up_m,
            "horizontal_m": math.hypot(west_m, north_m),
        }


def position_field(position: LunarPosition) -> Field:
    """The position on a card."""
    longitude, latitude, height = position.selenographic
    return Field(
        "position",
        (
            f"{longitude:.6f} deg E, {latitude:.6f} deg N ({position.frame})",
            f"{height:.1f} m above the 1737.4 km sphere",
        ),
    )


def reference_field(position: LunarPosition, references: Mapping[str, LunarPosition]) -> Field:
    """How far the position is from known ones."""
    lines = (
        f"solution - {one['name']}: east {metres(one['east_m'])}, north {metres(one['north_m'])}, "
        f"up {metres(round(one['up_m'], 4))} m; {metres(one['horizontal_m'])} m horizontal"
        for one in _beside(position, references)
    )
    return Field("reference", lines)


def _named(names: Iterable[str], values: Iterable[float]) -> dict[str, float | None]:
    return {f"{name}_m": finite_or_none(float(value)) for name, value in zip(names, values, strict=True)}
