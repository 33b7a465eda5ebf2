"""Observations to predict and points on the Moon for tests of the measurement chain."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from radioloc.earth.orientation import EarthOrientation
from radioloc.measurements import Computed, FixedPoint, Link, Observations, PhysicalModel
from radioloc.time import Epochs, epochs_from_strings, to_scale

# JPL's DE421 reflector coordinates, principal axes: radius (m), latitude and east longitude (deg), as in the
# prediction tables of McDonald Observatory labelled "JPL DE-421".
_DE421_SPHERICAL = {
    "apollo11": (1735472.732, 0.6934309, 23.4543075),
    "luna17": (1734929.200, 38.3330890, -35.0366860),
    "apollo14": (1736336.135, -3.6233288, -17.4971065),
    "apollo15": (1735477.340, 26.1551743, 3.6103520),
    "luna21": (1734639.009, 25.8509928, 30.9087426),
}

LASER = {"pressure_hpa": 780.0, "temperature_k": 280.0, "relative_humidity": 0.3, "wavelength_um": 0.532}
"""Weather and wavelength of laser ranging."""

START_TAI_JD = 2459185.5
"""2020-12-02."""


def _cartesian(radius_m: float, latitude_deg: float, longitude_deg: float) -> np.ndarray:
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    return radius_m * np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


REFLECTORS_PA_M = {name: _cartesian(*place) for name, place in _DE421_SPHERICAL.items()}
APOLLO15_PA_M = REFLECTORS_PA_M["apollo15"]
APOLLO15 = FixedPoint(APOLLO15_PA_M)


def observed_at(
    epoch: Epochs | list[str],
    links: Link | str | Sequence[Link | str],
    tag: str = "receive",
    **columns: object,
) -> Observations:
    """Return observations at epochs, texts of UTC or of any scale, whose values are to be computed."""
    return Observations.from_columns(
        epoch=to_scale(epoch, "UTC") if isinstance(epoch, Epochs) else epochs_from_strings(epoch, "UTC"),
        links=[links] if isinstance(links, (Link, str)) else links,
        tag=tag,
        **({"value_m": 1.0, "sigma_m": 1.0} | columns),
    )


def observations(
    path: str, tai: Epochs, tag: str = "transmit", kind: str = "range", **columns: object
) -> Observations:
    """Return observations on one path such as ``KASHI>x>JIAMUSI``, times those of transmission."""
    return observed_at(tai, path, tag, kind=kind, **columns)


def epochs_tai(
    count: int, hours: float, start_jd: float = START_TAI_JD, start_fraction: float = 0.0
) -> Epochs:
    """Return evenly spaced epochs of TAI, both ends included."""
    return Epochs.from_jd(start_jd, start_fraction + np.linspace(0.0, hours / 24.0, count), "TAI")


def with_predictions_after_2_december(model: PhysicalModel) -> PhysicalModel:
    """Mark Earth orientation from 4 December 2020 on, which the cubic of 2 December uses, as predicted."""
    table = model.earth.table
    return replace(model, earth=EarthOrientation(replace(table, predicted=table.mjd_utc >= 59187.0)))


def assert_same(first: Computed, second: Computed, atol: float = 0.0) -> None:
    """Compare all columns, numbers within a tolerance."""
    for field in fields(first):
        values, expected = getattr(first, field.name), getattr(second, field.name)
        exact = field.name == "status" or atol == 0.0
        np.testing.assert_allclose(
            values, expected, rtol=0.0, atol=0.0 if exact else atol, err_msg=field.name
        )
