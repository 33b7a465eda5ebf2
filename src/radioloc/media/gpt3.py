"""Climate at any place from the grid of GPT3 (Landskron and Boehm 2018), for stations without weather.

The file ``gpt3_5.grd`` or ``gpt3_1.grd`` of TU Wien, which the user provides, holds at each point of a grid of 5 or 1
degrees the mean, annual and semiannual variation of pressure, temperature, humidity, lapse rate, the coefficients a of
VMF3, mean temperature and decrease factor of water vapour, and horizontal gradients. There is no weather of the day in
it: pressure is off by 7 hPa (16 mm of zenith delay) and the wet delay by 3 to 4 cm as a rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import FileFormatError, InputError
from radioloc.media.grids import LatLonGrid, sort_into_grid
from radioloc.media.mapping_functions import day_of_year, seasons
from radioloc.media.neutral_atmosphere import DRY_AIR_KG_MOL, GAS_CONSTANT_J_K_MOL, STANDARD_GRAVITY_M_S2
from radioloc.text_files import ANY_BYTE, read_lines, table_of
from radioloc.time import Epochs

_COLUMNS = 64
_SEASONAL_BEFORE = 4
"""Quantities with seasons that stand before the two columns of undulation and height."""

_SCALES = np.array([1.0, 1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1.0, 1.0, 1e-5, 1e-5, 1e-5, 1e-5])
"""To Pa, K, kg/kg, K/m, then a hydrostatic, a wet, decrease factor, K, and gradients in m."""


@dataclass(frozen=True, slots=True, eq=False)
class Gpt3Values:
    """Climate of a place at some epochs; arrays of shape (n,).

    Mean temperature and decrease factor are those of the water vapour, for the wet delay of Askne and Nordius;
    coefficients a those of VMF3 on the ellipsoid.
    """

    pressure_hpa: NDArray[np.float64]
    vapour_pressure_hpa: NDArray[np.float64]
    mean_temperature_k: NDArray[np.float64]
    vapour_decrease_factor: NDArray[np.float64]
    hydrostatic_a: NDArray[np.float64]
    wet_a: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Gpt3Grid:
    """The grid of GPT3: its points, what varies with the seasons, and heights of the geoid and of the points above it.

    ``seasonal``, shape (rows, columns, 12, 5), holds mean, annual cosine and sine, semiannual cosine and sine of
    pressure (Pa), temperature (K), specific humidity, lapse rate (K/m), a hydrostatic, a wet, decrease factor, mean
    temperature (K) and four gradients (m); lapse rate and gradients are left aside.
    """

    grid: LatLonGrid
    seasonal: NDArray[np.float64]
    undulation_m: NDArray[np.float64]
    height_m: NDArray[np.float64]

    def at(self, epochs: Epochs, latitude_rad: float, longitude_rad: float, height_m: float) -> Gpt3Values:
        """Climate of four points, each taken to the height above the ellipsoid, then bilinear; epochs of any scale.

        Landskron and Boehm (2018), section 4, as GPT2w (Boehm et al. 2015): pressure falls exponentially with the
        virtual temperature of the grid point, vapour pressure with the power lambda + 1 of pressure.
        """
        row, column, weight = self.grid.corners(latitude_rad, longitude_rad)
        corners = np.einsum("cqs,ns->qnc", self.seasonal[row, column, :8], seasons(day_of_year(epochs)))
        pressure, temperature, humidity, _, hydrostatic_a, wet_a, decrease, mean_temperature = corners
        above = height_m - self.undulation_m[row, column] - self.height_m[row, column]
        virtual = temperature * (1.0 + 0.6077 * humidity)
        per_metre = STANDARD_GRAVITY_M_S2 * DRY_AIR_KG_MOL / (GAS_CONSTANT_J_K_MOL * virtual)
        ratio = np.exp(-per_metre * above)
        vapour = humidity * pressure / (0.622 + 0.378 * humidity) * ratio ** (decrease + 1.0)
        hectopascal = 0.01 * pressure * ratio, 0.01 * vapour
        return Gpt3Values(
            *(v @ weight for v in (*hectopascal, mean_temperature, decrease, hydrostatic_a, wet_a))
        )


def read_gpt3(path: str | Path) -> Gpt3Grid:
    """Read ``gpt3_5.grd`` or ``gpt3_1.grd``, plain or gzip; :class:`FileFormatError` names what is wrong in it."""
    path = Path(path)
    lines = [
        (number, line)
        for number, line in enumerate(read_lines(path, encoding=ANY_BYTE), start=1)
        if line.strip() and not line.lstrip().startswith("%")
    ]
    table = table_of(path, lines, _COLUMNS, "a grid of GPT3")
    try:
        grid, order = sort_into_grid(table[:, 0], table[:, 1], "the grid of GPT3")
    except InputError as error:
        raise FileFormatError(path, str(error)) from error
    split = 2 + 5 * _SEASONAL_BEFORE
    seasonal = np.concatenate([table[:, 2:split], table[:, split + 2 :]], axis=1)
    seasonal = _SCALES[:, None] * seasonal.reshape(len(table), -1, 5)
    mean = seasonal[..., 0]
    possible = (
        (np.abs(mean[:, 0] - 7.5e4) < 3.5e4)
        & (np.abs(mean[:, 1] - 260.0) < 60.0)
        & (np.abs(mean[:, 4] - 1.2e-3) < 1e-4)
    )
    if not possible.all():
        problem = "pressure, temperature or ah are not in Pa, K and thousandths; take the file gpt3_5.grd or gpt3_1.grd"
        raise FileFormatError(path, problem, lines[int(np.argmin(possible))][0])
    return Gpt3Grid(grid, seasonal[order], table[order, split], table[order, split + 1])
