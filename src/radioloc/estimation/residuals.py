"""Observations with their residuals after a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.labels import USED, Labels
from radioloc.estimation.statistics import finite_or_none
from radioloc.time import Epochs, utc_strings


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Observations with what is left of them after the fit; arrays of shape (n,).

    Parameters
    ----------
    epoch_utc : Epochs
        UTC of the event that the time tag names.
    stations, types, paths : Labels
        Station that a bias or a group belongs to, kind of measurement, participants of the signal path.
    observed_m, residual_m, sigma_m : ndarray
        Observed value, observed - computed, stated standard deviation; m (of the round trip
        for ranges).
    elevation_deg : ndarray or None
        Lower of the stations' elevations of the Moon, deg.
    statuses : Labels
        ``"used"`` or the reason why the observation was left out.
    """

    epoch_utc: Epochs
    stations: Labels
    types: Labels
    paths: Labels
    observed_m: NDArray[np.float64]
    residual_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    elevation_deg: NDArray[np.float64] | None
    statuses: Labels

    def __len__(self) -> int:
        return len(self.residual_m)

    def select(self, rows: Any) -> Residuals:
        """Some rows: a slice, a mask or indices."""
        return Residuals(
            self.epoch_utc[rows],
            self.stations.select(rows),
            self.types.select(rows),
            self.paths.select(rows),
            self.observed_m[rows],
            self.residual_m[rows],
            self.sigma_m[rows],
            None if self.elevation_deg is None else self.elevation_deg[rows],
            self.statuses.select(rows),
        )

    @property
    def station(self) -> NDArray[np.str_]:
        """:attr:`stations` as texts, shape (n,)."""
        return self.stations[:]

    @property
    def type(self) -> NDArray[np.str_]:
        """:attr:`types` as texts, shape (n,)."""
        return self.types[:]

    @property
    def path(self) -> NDArray[np.str_]:
        """:attr:`paths` as texts, shape (n,)."""
        return self.paths[:]

    @property
    def status(self) -> NDArray[np.str_]:
        """:attr:`statuses` as texts, shape (n,)."""
        return self.statuses[:]

    @property
    def series(self) -> Labels:
        """Type and path together, such as ``range A>lander>A``."""
        types, paths = self.types.texts, self.paths.texts
        names = [f"{kind} {path}" for kind in types for path in paths]
        return Labels.coded(names, self.types.codes * len(paths) + self.paths.codes)

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which observations took part in the fit, shape (n,)."""
        return self.statuses.are(USED)

    @property
    def computed_m(self) -> NDArray[np.float64]:
        """Computed values, m, shape (n,)."""
        return self.observed_m - self.residual_m

    def rejected(self) -> list[dict[str, Any]]:
        """Observations that were left out and why, in types that JSON has."""
        out = np.flatnonzero(~self.used)
        if not len(out):
            return []
        columns = {
            "epoch_utc": utc_strings(self.epoch_utc[out], decimals=3).tolist(),
            "station": self.stations[out].tolist(),
            "path": self.paths[out].tolist(),
            "residual_m": [finite_or_none(value) for value in self.residual_m[out]],
            "reason": self.statuses[out].tolist(),
        }
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def to_table(self) -> Any:
        """All columns as an ``astropy.table.Table``."""
        columns = {
            "epoch_utc": utc_strings(self.epoch_utc),
            "type": self.type,
            "station": self.station,
            "path": self.path,
            "observed_m": self.observed_m,
            "computed_m": self.computed_m,
            "residual_m": self.residual_m,
            "sigma_m": self.sigma_m,
            "status": self.status,
        }
        if self.elevation_deg is not None:
            columns["elevation_deg"] = self.elevation_deg
        from astropy.table import Table

        return Table(columns)
