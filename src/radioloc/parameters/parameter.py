"""Parameters of an estimate: names, a-priori values and roles, in a fixed order."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.units import set_fields
from radioloc.vectors import Floats, Mask

_MIN_SIGMA = 1e-30  # In any unit; the square of its inverse is still finite


class Role(Enum):
    """Treatment of a parameter by the estimator."""

    ESTIMATED = "estimated"
    CONSIDERED = "considered"
    """Adjusted with its a-priori sigma, but not reported: its error is in the weights and in the covariance."""
    FIXED = "fixed"
    """Held at its a-priori value, as if known exactly."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """Number that the estimator may change.

    Raises
    ------
    InputError
        A value is not finite, a standard deviation or a scale is not positive.
    """

    name: str  #: unique name: the kind, a dot, and the owner or component, such as ``"range_bias.APOLLO"``
    unit: str  #: unit of the value as text, such as ``"m"``, ``"rad"``, ``"s"``
    kind: str  #: kind of parameter: ``"position"``, ``"range_bias"``, ``"time_bias"``, ...
    prior_value: float = 0.0  #: a-priori value, in `unit`, at which the iteration starts
    #: Standard deviation of the a-priori value, in `unit`; infinity leaves the parameter to the data alone.
    prior_sigma: float = math.inf
    role: Role = Role.ESTIMATED  #: whether it is estimated, considered or fixed
    #: Change of the parameter, in `unit`, that moves an observation by about one metre: 1 for metres, 1/1737400
    #: for a selenographic angle in rad, 0.001 for a time bias in seconds. It makes parameters of different units
    #: comparable in unobservable directions; the estimate does not depend on it.
    scale: float = 1.0
    #: First and last epoch on which it acts, UTC, if not the whole arc.
    span_utc: tuple[str, str] | None = None
    #: Errors of the a-priori value that other results share, by name: change by one sigma of each, in `unit`.
    #: They are part of `prior_sigma`.
    prior_errors: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a parameter needs a name, such as 'range_bias.APOLLO'")
        if not math.isfinite(self.prior_value):
            raise InputError(f"the a-priori value of {self.name} is {self.prior_value}; give a finite number")
        if not self.prior_sigma >= _MIN_SIGMA:
            raise InputError(
                f"the a-priori sigma of {self.name} is {self.prior_sigma}; give a number of {_MIN_SIGMA:g} or more, "
                "or infinity to leave the parameter free"
            )
        if self.role is Role.CONSIDERED and not math.isfinite(self.prior_sigma):
            raise InputError(
                f"{self.name}: a considered parameter needs a finite sigma of its a-priori value"
            )
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise InputError(f"the scale of {self.name} is {self.scale}; give a finite positive number")

    @property
    def fixed(self) -> bool:
        """Return whether the estimator keeps the a-priori value."""
        return self.role is Role.FIXED


@dataclass(frozen=True)
class ParameterSet:
    """Parameters in the order of the columns of the partials; arrays are read-only, shape (p,).

    Raises
    ------
    InputError
        A name occurs twice.
    """

    #: No name occurs twice, but a considered parameter may be the error of a fixed one.
    parameters: Sequence[Parameter]

    def __post_init__(self) -> None:
        set_fields(self, parameters=tuple(self.parameters))
        names = Counter((item.name, item.role is Role.CONSIDERED) for item in self.parameters)
        doubled = sorted(name for (name, _), count in names.items() if count > 1)
        if doubled:
            raise InputError(
                f"parameter names occur more than once: {', '.join(doubled)}; each must be unique"
            )

    def __len__(self) -> int:
        return len(self.parameters)

    def __repr__(self) -> str:
        return f"<ParameterSet {len(self)}: {', '.join(self.names)}>"

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[self.index(name)]

    def __contains__(self, name: object) -> bool:
        return name in self.names

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names, in order."""
        return tuple(item.name for item in self.parameters)

    @cached_property
    def free(self) -> Mask:
        """Mask of adjusted parameters: estimated or considered."""
        return np.array([not item.fixed for item in self.parameters])

    @cached_property
    def considered(self) -> Mask:
        """Mask of considered parameters."""
        return np.array([item.role is Role.CONSIDERED for item in self.parameters])

    @cached_property
    def prior_values(self) -> Floats:
        """A-priori values, each in its unit."""
        return self._column("prior_value")

    @cached_property
    def prior_sigmas(self) -> Floats:
        """A-priori standard deviations, each in its unit; infinite for free parameters."""
        return self._column("prior_sigma")

    @cached_property
    def scales(self) -> Floats:
        """Changes that move an observation by about one metre."""
        return self._column("scale")

    def _column(self, name: str) -> Floats:
        column = np.array([getattr(item, name) for item in self.parameters], dtype=np.float64)
        column.flags.writeable = False
        return column

    def index(self, name: str) -> int:
        """Return the index of a parameter; an unknown name is an :class:`InputError`."""
        try:
            return self.names.index(name)
        except ValueError:
            raise InputError(
                f"unknown parameter {name!r}; the parameters are {', '.join(self.names)}"
            ) from None

    def of_kind(self, kind: str) -> tuple[int, ...]:
        """Return the indices of the parameters of one kind."""
        return tuple(i for i, item in enumerate(self.parameters) if item.kind == kind)

    def changed(self, name: str, **changes: Any) -> ParameterSet:
        """Return a copy with some fields of one parameter changed."""
        k = self.index(name)
        return ParameterSet(
            (*self.parameters[:k], replace(self.parameters[k], **changes), *self.parameters[k + 1 :])
        )
