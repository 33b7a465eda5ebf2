"""Registry of kinds of parameter: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.parameters`` that names a
:class:`~radioloc.parameters.kind.ParameterKind`. Positions and states are parameters of targets.
"""

from __future__ import annotations

import copyreg
from collections.abc import Mapping

from radioloc.parameters import biases, clocks, earth, moon
from radioloc.parameters.kind import ParameterKind
from radioloc.plugins import Registry

PARAMETERS: Mapping[str, ParameterKind] = Registry(
    "radioloc.parameters",
    ParameterKind,
    [
        biases.RANGE_BIAS,
        biases.TIME_BIAS,
        clocks.CLOCK,
        clocks.CLOCK_RATE,
        biases.FREQUENCY_OFFSET,
        biases.FREQUENCY_RATE,
        earth.ZENITH_DELAY,
        earth.ELECTRON_CONTENT,
        biases.TRANSPONDER_DELAY,
        biases.STATION_DELAY,
        biases.SCALE_FACTOR,
        clocks.TARGET_CLOCK,
        clocks.TARGET_FREQUENCY,
        clocks.TARGET_FREQUENCY_RATE,
        earth.STATION_POSITION,
        earth.UT1,
        earth.POLE,
        moon.MOON_POSITION,
        moon.MOON_POSITION_VARIATION,
        moon.LIBRATION,
        moon.LIBRATION_VARIATION,
        moon.LONGITUDE_LIBRATION,
        moon.LOVE_NUMBERS,
        moon.LUNAR_LENGTHS,
    ],
)
"""Kinds of parameter by name, in the order of the columns of the design matrix."""


def _registered(name: str) -> ParameterKind:
    return PARAMETERS[name]


copyreg.pickle(ParameterKind, lambda kind: (_registered, (kind.name,)))  # workers look kinds up by name


def parameter_label(name: str) -> str:
    """Return the name of a parameter in full, for cards and messages; other names are returned as they are."""
    kind_name, _, owner = name.partition(".")
    kind = PARAMETERS.get(kind_name)
    if kind is None:
        return name
    label = kind.label or kind.name.replace("_", " ")
    for component in filter(None, kind.components):
        if owner == component or owner.endswith(f".{component}"):
            owner, label = owner.removesuffix(component).removesuffix("."), f"{component} {label}"
            break
    if not owner:
        return label
    if owner == "all":
        return f"{label} of all {kind.scopes[0].owner.value}s"
    return f"{label} of {owner}" if kind.scopes[0].named else f"{label}, session {owner}"
