"""Type of a measurement: legs, events of the time tag, and limits of the value.

A value is the speed of light times the travel time of a signal over its legs, by the clocks at their ends, its change
over a count interval, or a linear combination of such values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.quantities import convert_fields
from radioloc.units import set_fields

TIME_TAGS = ("transmit", "receive", "bounce")
"""Events of time tags; :attr:`Observations.tag` has indices into this tuple."""


class Geometry(Enum):
    """Legs of a measurement; the values are the forms of its path."""

    ROUND_TRIP = "transmitter>target>receiver"
    """Up from the first station to the target and down to the second."""
    ONE_WAY = "target>receiver"
    """Down from the target, whose clock reads the transmission."""
    BASELINE = "station1<target>station2"
    """Down from the target to both stations: the second leg less the first, of one wavefront."""
    COMBINED = ""
    """Legs of the combined measurements."""


@dataclass(frozen=True, slots=True)
class Part:
    """Part of a combined measurement."""

    weight: float  #: factor of its value
    type: str  #: name of its type, a simple one
    link: Link  #: participants


@dataclass(frozen=True, slots=True)
class MeasurementType:
    """Type of measurement.

    Raises
    ------
    InputError
        Attributes are inconsistent.
    """

    name: str  #: name in tables of observations
    description: str  #: definition of the value and of the time tag, a sentence for the reference pages
    geometry: Geometry  #: legs
    #: Whether the value is the change of the path over a count interval, tagged at its middle (a carrier phase,
    #: which the ionosphere advances by as much as it delays a code).
    integrated: bool = False
    tags: tuple[str, ...] = TIME_TAGS  #: permitted events of the time tag, from :data:`TIME_TAGS`
    #: Form of the path (:attr:`~radioloc.measurements.link.Link.form`); by default that of the geometry.
    form: str = ""
    #: Function of the link that returns the combined measurements, with the same time tag and count interval;
    #: only with ``Geometry.COMBINED``.
    parts: Callable[[Link], tuple[Part, ...]] | None = None
    positive: bool = False  #: whether values must be above zero
    #: Limits of the magnitude of values, and of their rate over the count interval.
    largest_m: float | None = None
    fastest_m_s: float | None = None  #: likewise
    limit: str = ""  #: reason of the limits, for messages

    def __post_init__(self) -> None:
        convert_fields(self)
        if (self.geometry is Geometry.COMBINED) != (self.parts is not None):
            raise InputError(
                f"measurement type {self.name}: expected parts if and only if the geometry is COMBINED"
            )
        if not self.form:
            set_fields(self, form=self.geometry.value)
        unknown = set(self.tags) - set(TIME_TAGS)
        if not self.name.isidentifier() or not self.tags or unknown or not self.form:
            raise InputError(
                f"measurement type {self.name!r}: expected a name of letters and underscores, a form of the path, and "
                f"time tags of {', '.join(TIME_TAGS)}"
            )

    @property
    def on_baseline(self) -> bool:
        """Return whether two stations receive."""
        return self.form.startswith("station1<")
