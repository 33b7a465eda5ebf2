"""Kinds of parameter: a physical quantity, its scope, and the partial derivatives of observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from radioloc.errors import InputError
from radioloc.parameters.rows import ObservationRows
from radioloc.vectors import Floats, Mask


class Scope(Enum):
    """Owner of a parameter; the value is the word for it in a study file."""

    STATION = "station"
    PASS = "pass"
    """A station in a pass; a new pass begins after some hours without its observations."""
    LINK = "link"
    """A path such as ``JIAMUSI>lander>KASHI``, or a baseline."""
    LINK_AND_PASS = "link and pass"
    TARGET = "target"
    EARTH = "earth"
    MOON = "moon"
    SESSION = "session"
    """Earth or Moon in a session; a new session begins after some hours without any observation."""

    @property
    def named(self) -> bool:
        """Return whether there are several owners, each with a name."""
        return self not in (Scope.EARTH, Scope.MOON, Scope.SESSION)

    @property
    def owner(self) -> Scope:
        """Scope without division into passes."""
        return {Scope.PASS: Scope.STATION, Scope.LINK_AND_PASS: Scope.LINK}.get(self, self)


Amount = float | tuple[float, ...] | None  # a number, or one for each component

Members = dict[str, int]  # index in the predictor by name; Earth, Moon and session have no name and index 0

Sigmas = dict[str, Amount]  # a-priori sigmas by member


@dataclass(frozen=True, slots=True)
class ParameterKind:
    """Kind of parameter in the registry.

    Estimated, considered, fixed and simulated parameters all use the same partials.

    Raises
    ------
    InputError
        The record contradicts itself.
    """

    name: str  #: in study files and results, such as ``"range_bias"``
    unit: str  #: SI unit of the value, as in keys of study files: ``"m"``, ``"s/s"``, ``"1"``
    description: str  #: text of reference pages
    scopes: tuple[Scope, ...]  #: possible owners; the first is the default
    #: Partial derivatives of the computed values of observations, shape (m, ends, components). A scope of
    #: stations needs two ends, for the first and the second station; others have one or two ends, which are
    #: added.
    partials: Callable[[ObservationRows], Floats]
    #: Whether each end of an observation depends on the parameter, shape (m, ends), by its link, type, time tag,
    #: frequencies and weather; called before values are computed.
    acts_on: Callable[[ObservationRows], Mask]
    components: tuple[str, ...] = ("",)  #: names of its numbers; by default one number without a name
    #: Quantity in words, which follow a component in cards: ``"position of the Moon"``; by default the name.
    label: str = ""
    scale: float = 1.0  #: change that moves an observation by about one metre
    #: Whether it needs partials that predictors compute on request only: by station positions, by the electron
    #: content above stations, and by displacements of the target in a count interval.
    more_partials: bool = False
    term: str = ""  #: term of the model that has its partials; without the term the parameter is an error
    #: Whether only differences between stations are observable; ``"all"`` then estimates all but one reference
    #: station of each network.
    relative: bool = False
    #: Whether a link has the parameter of its second station only, as those of both stations would cancel.
    of_links_second: bool = False
    #: Default a-priori sigmas by member, from observations and members with observations, or the reason in words
    #: for their absence. Without it the kind is considered only if a study states a sigma.
    considered: Callable[[ObservationRows, Members], Mapping[str, Amount] | str] | None = None
    considered_per: Scope | None = None  #: scope of considered parameters; by default the first of `scopes`
    #: Kinds with the same effect: members that a study estimates or considers of them have no default here.
    replaced_by: tuple[str, ...] = ()

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

        By role: names, value, sigma, per.
        """
        unit = "" if self.unit == "1" else f"_{self.unit.replace('/', '_')}"
        return {
            "names": self.name,
            "value": f"{self.name}{unit or '_value'}",
            "sigma": f"{self.name}_sigma{unit}",
            "per": f"{self.name}_per",
        }

    def parameter_names(self, member: str) -> list[str]:
        """Return names of the parameters of a member, such as ``station_position.KASHI.east``."""
        return [".".join(filter(None, (self.name, member, component))) for component in self.components]

    @property
    def value_key(self) -> str:
        """Key of the a-priori value."""
        return self.keys["value"]

    @property
    def sigma_key(self) -> str:
        """Key of its sigma."""
        return self.keys["sigma"]


def all_observations(rows: ObservationRows) -> Mask:
    """Return that every observation depends on the parameter, shape (m, 1)."""
    return np.ones((len(rows), 1), dtype=bool)


def both_stations(rows: ObservationRows) -> Mask:
    """Return that an observation depends on the parameter at each of its stations, shape (m, 2)."""
    return rows.ends >= 0
