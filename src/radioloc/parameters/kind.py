"""What a kind of parameter is: a physical quantity, its scope, and how an observation answers to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.parameters.rows import ObservationRows
from radioloc.vectors import Floats


class Scope(Enum):
    """Whom a parameter belongs to; the value is the word for it in a study file."""

    STATION = "station"
    PASS = "pass"
    """Of a station: a new pass begins when it has not observed for some hours."""
    LINK = "link"
    """A path such as ``JIAMUSI>lander>KASHI``, or a baseline."""
    LINK_AND_PASS = "link and pass"
    TARGET = "target"
    EARTH = "earth"
    MOON = "moon"
    SESSION = "session"
    """Of Earth or Moon: a new session begins when no station has observed for some hours."""

    @property
    def named(self) -> bool:
        """Whether there can be several, each with a name."""
        return self not in (Scope.EARTH, Scope.MOON, Scope.SESSION)

    @property
    def owner(self) -> Scope:
        """Scope without division into passes."""
        return {Scope.PASS: Scope.STATION, Scope.LINK_AND_PASS: Scope.LINK}.get(self, self)


Amount = float | tuple[float, ...] | None  # a number, or one for each component

Members = dict[str, int]  # by name, with the index in the predictor; the whole has no name and the index 0

Sigmas = dict[str, Amount]  # a-priori sigmas by member


@dataclass(frozen=True, slots=True)
class ParameterKind:
    """A kind of parameter, as the registry holds it.

    Whether a parameter is estimated, considered, fixed or drawn in a simulation is not its own affair: all need its
    partials only.

    Parameters
    ----------
    name : str
        In study files and results, such as ``"range_bias"``.
    unit : str
        SI unit of the value, as in keys of study files: ``"m"``, ``"s/s"``, ``"1"``.
    description : str
        What it is, for reference pages.
    scopes : tuple of Scope
        Whom it can belong to; the first is the default.
    partials : callable
        From observations to partial derivatives of their computed values, shape (m, ends, components). There are two
        ends, those of the first and of the second station, where the scope is the station; else one or two, which are
        added.
    acts_on : callable
        From observations, before anything is computed, to whether the parameter can be estimated from them by each end,
        shape (m, ends).
    components : tuple of str
        Names of the numbers that it consists of; one without a name as a rule.
    scale : float
        A change worth about one metre of an observation.
    more_partials : bool
        Whether it needs the partials that predictors compute on request only: by the stations' places, by the electron
        content above them, and what moves the target in a count interval.
    term : str
        Term of the model by whose partials it acts, and without which it cannot be.
    relative : bool
        Whether only differences between stations show; ``"all"`` then estimates all but one reference station of each
        network.
    of_links_second : bool
        Whether that of a link is that of its second station alone, as both stations' would cancel.
    considered : callable, optional
        From observations, before anything is computed, and members (names of those on whose observations the parameter
        acts, with their indices) to the a-priori sigmas of the members that are considered where a study says nothing
        else; or why none is, in words. Without it none is.
    considered_per : Scope, optional
        Whom those belong to, where it is not the first of the scopes.

    Raises
    ------
    InputError
        The record contradicts itself.
    """

    name: str
    unit: str
    description: str
    scopes: tuple[Scope, ...]
    partials: Callable[[ObservationRows], Floats]
    acts_on: Callable[[ObservationRows], NDArray[np.bool_]]
    components: tuple[str, ...] = ("",)
    scale: float = 1.0
    more_partials: bool = False
    term: str = ""
    relative: bool = False
    of_links_second: bool = False
    considered: Callable[[ObservationRows, Members], Mapping[str, Amount] | str] | None = None
    considered_per: Scope | None = None

    def __post_init__(self) -> None:
        named = self.name.isidentifier() and self.keys["sigma"].isidentifier()
        if not (named and self.scopes and self.components and self.scale > 0.0):
            raise InputError(
                f"parameter kind {self.name!r} in {self.unit!r} needs a name of letters and underscores, a unit of "
                "letters, digits and /, scopes, components and a scale above zero"
            )

    @property
    def keys(self) -> dict[str, str]:
        """Keys in a study file, such as ``range_bias``, ``range_bias_m``, ``range_bias_sigma_m``, ``range_bias_per``.

        By what they give: names, value, sigma, per.
        """
        unit = "" if self.unit == "1" else f"_{self.unit.replace('/', '_')}"
        return {
            "names": self.name,
            "value": f"{self.name}{unit or '_value'}",
            "sigma": f"{self.name}_sigma{unit}",
            "per": f"{self.name}_per",
        }

    def parameter_names(self, whose: str) -> list[str]:
        """Names of the parameters of one that has this kind, such as ``station_position.KASHI.east``."""
        return [".".join(filter(None, (self.name, whose, component))) for component in self.components]

    @property
    def value_key(self) -> str:
        """Key of the a-priori value."""
        return self.keys["value"]

    @property
    def sigma_key(self) -> str:
        """Key of its sigma."""
        return self.keys["sigma"]


def everywhere(rows: ObservationRows) -> NDArray[np.bool_]:
    """Return that a parameter acts on every observation, as one end, shape (m, 1)."""
    return np.ones((len(rows), 1), dtype=bool)


def both_stations(rows: ObservationRows) -> NDArray[np.bool_]:
    """Return that a parameter acts at each station that takes part, shape (m, 2)."""
    return rows.ends >= 0
