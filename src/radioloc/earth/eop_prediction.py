"""Earth orientation after the last day of a table, for planning, and errors of predictions by lead time.

``"hold"`` keeps the pole and the length of day of the last day. ``"extrapolate"`` continues the last day with the
annual and Chandler terms of the pole, and with the last year's mean length of day and the annual and semiannual terms
of UT1, by least squares of the last four years. Zonal tides are removed first and restored last; celestial pole
offsets are held (0.3 mas, 1 cm on the ground).

Errors of predictions t days after the last measured day, for UT1 and for each coordinate of the pole: of Bulletin A's
values 0.00025 t^0.75 s and 0.00068 t^0.80 arcsec, which Bulletin A itself states. Errors of added days are those of
the same method at days of C04 since 2000, compared with the later series. Bulletin A's formula would be too small for
them, for UT1 by a factor of three after a year.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from radioloc.constants import ARCSEC_RAD, MJD_ZERO_JD, SECONDS_PER_DAY
from radioloc.earth.eop import EopTable
from radioloc.earth.eop_tides import zonal_tides
from radioloc.errors import InputError
from radioloc.time import Epochs, utc_to_tt
from radioloc.vectors import Floats

BEYOND = ("hold", "extrapolate")
_MAX_LEAD_D = 3000  # range of the error model
_FITTED_D = 1461
_YEAR_D, _HALF_YEAR_D, _CHANDLER_D = 365.2422, 182.6211, 433.0
_MEASURED_S, _MEASURED_RAD = 10e-6, 60e-6 * ARCSEC_RAD  # errors of measured values


def extended(table: EopTable, method: str) -> EopTable:
    """Return the table with days up to 3000 after the last measured one; `method` is one of :data:`BEYOND`."""
    if method not in BEYOND:
        raise InputError(f"eop_beyond: expected {' or '.join(BEYOND)}, got {method!r}")
    with_offsets = np.flatnonzero(np.isfinite(table.dx_rad) & np.isfinite(table.dy_rad))
    if not len(with_offsets):
        raise InputError("the table of Earth orientation has no celestial pole offset to hold")
    if method == "extrapolate" and len(table.mjd_utc) < _FITTED_D:
        raise InputError(
            f"the table of Earth orientation has {len(table.mjd_utc)} days; {_FITTED_D} are needed to extrapolate it"
        )
    last, end = float(table.mjd_utc[-1]), int(last_measured_mjd(table)) + _MAX_LEAD_D
    lead_d = np.arange(1.0, end - last + 1.0)
    seconds, xp_rad, yp_rad = _continued(table, lead_d, method)
    tt = utc_to_tt(Epochs.from_jd(last + lead_d + MJD_ZERO_JD, 0.0, "UTC"))
    tide_s, _ = zonal_tides(tt.centuries_since_j2000())
    tt_minus_utc_s = ((tt.jd - MJD_ZERO_JD - last - lead_d) + tt.fraction) * SECONDS_PER_DAY
    added_columns = {
        "mjd_utc": last + lead_d,
        "xp_rad": xp_rad,
        "yp_rad": yp_rad,
        "ut1_minus_utc_s": seconds + tide_s + tt_minus_utc_s,
        "dx_rad": np.full(len(lead_d), np.nan),
        "dy_rad": np.full(len(lead_d), np.nan),
        "predicted": np.ones(len(lead_d), dtype=bool),
    }
    columns: dict[str, Any] = {
        name: np.append(getattr(table, name), column) for name, column in added_columns.items()
    }
    later = np.arange(len(columns["mjd_utc"])) > with_offsets[-1]
    for name in ("dx_rad", "dy_rad"):
        columns[name][later] = columns[name][with_offsets[-1]]
    columns["predicted"] |= later
    source = f"{'held' if method == 'hold' else 'extrapolated'} after {table.last_date}"
    return replace(table, **columns, sources=(*table.sources, source), beyond=(method, last))


def _continued(table: EopTable, lead_d: Floats, method: str) -> Floats:
    """Return UT1 - TT without zonal tides, s, and the pole, rad, at days after the last, shape (3, n)."""
    values, tt = table.at_0h_utc
    days = table.mjd_utc[-_FITTED_D:] - table.mjd_utc[-1]
    columns = values[-_FITTED_D:, :3].T.copy()
    columns[0] -= zonal_tides(tt[-_FITTED_D:].centuries_since_j2000())[0]
    last = columns[:, -1:]
    if method == "hold":
        length_of_day = (columns[0, -1] - columns[0, -2]) / (days[-1] - days[-2])
        return np.asarray(last + np.outer([length_of_day, 0.0, 0.0], lead_d))
    rates = np.array([(columns[0, -1] - np.interp(-_YEAR_D, days, columns[0])) / _YEAR_D, 0.0, 0.0])
    periods = [(_YEAR_D, _HALF_YEAR_D), (_YEAR_D, _CHANDLER_D), (_YEAR_D, _CHANDLER_D)]
    return np.array(
        [
            value + rate * lead_d + _periodic(days, column, period, lead_d)
            for value, rate, column, period in zip(last, rates, columns, periods, strict=True)
        ]
    )


def _periodic(days: Floats, column: Floats, periods_d: tuple[float, ...], at_d: Floats) -> Floats:
    """Return the change of the periodic terms of a column, fitted with its trend, from day zero to other days."""

    def waves(day: Floats) -> Floats:
        angle = 2.0 * np.pi * day[:, None] / np.array(periods_d)
        return np.hstack([np.cos(angle), np.sin(angle)])

    trend = np.column_stack([np.ones_like(days), days / _YEAR_D])
    coefficients = np.linalg.lstsq(np.hstack([waves(days), trend]), column, rcond=None)[0][
        : 2 * len(periods_d)
    ]
    return np.asarray((waves(at_d) - waves(np.zeros(1))) @ coefficients)


def last_measured_mjd(table: EopTable) -> float:
    """Last day with measured values only, or the first day of a table of predictions, MJD UTC."""
    measured = np.flatnonzero(~table.predicted)
    return float(table.mjd_utc[measured[-1] if len(measured) else 0])


def orientation_errors(table: EopTable, mjd_utc: Floats) -> tuple[Floats, Floats]:
    """Return standard deviations of UT1, s, and of each coordinate of the pole, rad, at some dates, shape (n,)."""
    lead_d = np.maximum(mjd_utc - last_measured_mjd(table), 0.0)
    ut1_s, pole_arcsec = 0.00025 * lead_d**0.75, 0.00068 * lead_d**0.80
    if table.beyond is not None:
        method, last = table.beyond
        if method == "hold":
            added_s = np.minimum(4e-5 * lead_d**1.5, 5e-4 * lead_d)
            added_arcsec = np.minimum(1.6e-3 * lead_d, 0.19)
        else:
            added_s = np.hypot(3.2e-4 * lead_d**0.9, 7.4e-6 * lead_d**1.5)
            added_arcsec = np.minimum(pole_arcsec, 0.08)
        ut1_s = np.where(mjd_utc > last, added_s, ut1_s)
        pole_arcsec = np.where(mjd_utc > last, added_arcsec, pole_arcsec)
    return np.hypot(_MEASURED_S, ut1_s), np.hypot(_MEASURED_RAD, pole_arcsec * ARCSEC_RAD)
