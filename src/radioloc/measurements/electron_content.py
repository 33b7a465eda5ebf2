"""Sources of electron content along the rays of radio signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.earth.ionosphere import modified_shell_mapping
from radioloc.errors import InputError
from radioloc.time import Epochs


class ElectronContent(Protocol):
    """A source of slant electron content, such as :class:`radioloc.earth.ionex.IonexMaps`."""

    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: Epochs
    ) -> NDArray[np.float64]:
        """Electron content along rays from stations, TECU, shape (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class UniformTec:
    """The same vertical electron content everywhere and always.

    Parameters
    ----------
    vertical_tecu : float
        TECU (1e16 electrons per square metre).

    Raises
    ------
    InputError
        It is not from 0 to 1000 TECU.
    """

    vertical_tecu: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.vertical_tecu <= 1000.0:
            raise InputError(f"an electron content of {self.vertical_tecu!r} TECU cannot be; give 0 to 1000")

    def slant_tec(
        self, station_itrf_m: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, epochs: Epochs
    ) -> NDArray[np.float64]:
        """Vertical content times the modified single layer mapping, TECU, shape (n,)."""
        return self.vertical_tecu * modified_shell_mapping(elevation_rad)[0]
