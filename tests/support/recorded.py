"""Content of a ``solution.json`` without a fit."""

import numpy as np

from radioloc import LunarPosition
from radioloc.ephemeris.constants import CONSTANTS
from radioloc.estimation.statistics import finite_or_none
from radioloc.lunar.selenographic import selenographic_to_cartesian


def recorded(
    name="lander", place=(-51.9162, 43.0584, -2550.0), sigma_m=(20.0, 10.0, 2.0), frame="ME_DE421", **fields
):
    """Return a solution at a longitude, latitude (deg) and height (m), with sigmas east, north and up."""
    longitude_deg, latitude_deg, height_m = place
    me_m = selenographic_to_cartesian(*np.radians([longitude_deg, latitude_deg]), height_m)
    ephemeris = frame.removeprefix("ME_")
    constants = CONSTANTS.get(ephemeris, CONSTANTS["DE421"])
    pa_m = LunarPosition.from_cartesian(me_m, constants.me_frame).to_axes("PA", constants).xyz_m
    geographic = {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg, "height_m": height_m}
    axes, xyz = ("east_m", "north_m", "up_m"), ("x_m", "y_m", "z_m")
    variances = np.diag(np.square(sigma_m)).tolist()
    return {
        "name": name,
        "converged": True,
        "position": {
            "pa": {"frame": f"PA_{ephemeris}", **dict(zip(xyz, pa_m.tolist(), strict=True))},
            "me": {"frame": frame, **geographic, **dict(zip(xyz, me_m.tolist(), strict=True))},
        },
        "sigma": dict(zip(axes, map(finite_or_none, sigma_m), strict=True)),
        "covariance": {"enu_m2": [list(map(finite_or_none, row)) for row in variances]},
        "fit": {"used": 10, "rejected": 0, "wrms_m": 0.5},
        "reference": None,
        "provenance": {},
    } | fields


def reference(name, longitude_deg, latitude_deg, height_m=-2550.0, **fields):
    """Return a reference of a solution."""
    return {
        "name": name,
        "longitude_deg": longitude_deg,
        "latitude_deg": latitude_deg,
        "height_m": height_m,
    } | fields
