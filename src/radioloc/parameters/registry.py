"""The kinds of parameter that there are: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.parameters`` that names a
:class:`~radioloc.parameters.kind.ParameterKind`. The position is not among them: it is what the model is computed for.
"""

from __future__ import annotations

from collections.abc import Mapping

from radioloc.parameters.biases import (
    FREQUENCY_OFFSET,
    FREQUENCY_RATE,
    RANGE_BIAS,
    STATION_DELAY,
    TIME_BIAS,
    TRANSPONDER_DELAY,
)
from radioloc.parameters.clocks import CLOCK, CLOCK_RATE, TARGET_CLOCK, TARGET_FREQUENCY
from radioloc.parameters.earth import POLE, STATION_POSITION, UT1
from radioloc.parameters.kind import ParameterKind
from radioloc.parameters.media import ELECTRON_CONTENT, ZENITH_DELAY
from radioloc.parameters.moon import (
    LIBRATION,
    LIBRATION_VARIATION,
    LOVE_NUMBERS,
    LUNAR_LENGTHS,
    MOON_POSITION,
    MOON_POSITION_VARIATION,
)
from radioloc.plugins import registry

PARAMETERS: Mapping[str, ParameterKind] = registry(
    "radioloc.parameters",
    ParameterKind,
    [
        RANGE_BIAS,
        TIME_BIAS,
        CLOCK,
        CLOCK_RATE,
        FREQUENCY_OFFSET,
        FREQUENCY_RATE,
        ZENITH_DELAY,
        ELECTRON_CONTENT,
        TRANSPONDER_DELAY,
        STATION_DELAY,
        TARGET_CLOCK,
        TARGET_FREQUENCY,
        STATION_POSITION,
        UT1,
        POLE,
        MOON_POSITION,
        MOON_POSITION_VARIATION,
        LIBRATION,
        LIBRATION_VARIATION,
        LOVE_NUMBERS,
        LUNAR_LENGTHS,
    ],
)
"""Kinds of parameter by name, in the order of the columns of the design matrix."""
