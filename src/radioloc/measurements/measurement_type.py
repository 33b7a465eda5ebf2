"""Type of a measurement: the legs of its value, the events that its time tag names, the limits of its value.

A value is the speed of light times the time that a signal takes over its legs, read by the clocks at their ends, the
change of one over a count interval, or a linear combination of such values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.quantities import convert_fields

TIME_TAGS = ("transmit", "receive", "bounce")
"""Events that an epoch can belong to; :attr:`Observations.tag` holds indices into this."""


class Geometry(Enum):
    """Which legs a value runs over; the value is the form of the path that belongs to it."""

    ROUND_TRIP = "transmitter>target>receiver"
    """Up from the first station to the target and down to the second."""
    ONE_WAY = "target>receiver"
    """Down from the target, whose own clock reads the transmission."""
    BASELINE = "station1<target>station2"
    """Down from the target to both stations: the second leg less the first, of one wavefront."""
    COMBINED = ""
    """The legs of the measurements that are combined."""


@dataclass(frozen=True, slots=True)
class Part:
    """A measurement that another one combines.

    Parameters
    ----------
    weight : float
        What its value is multiplied by.
    type : str
        Name of its type, which is not combined itself.
    link : Link
        Its participants.
    """

    weight: float
    type: str
    link: Link


@dataclass(frozen=True, slots=True)
class MeasurementType:
    """One type of measurement.

    Parameters
    ----------
    name : str
        As it stands in tables of observations.
    description : str
        What is measured and what the time tag names, a sentence for the reference pages.
    geometry : Geometry
        The legs.
    integrated : bool
        Whether the value is the change of the path over a count interval, tagged at its middle (of the carrier's phase,
        which the ionosphere advances as much as it delays a code).
    tags : tuple of str
        Events that the time tag may name, of :data:`TIME_TAGS`.
    form : str
        Form of the path, where it does not follow from the geometry: as :attr:`~radioloc.measurements.link.Link.form`.
    parts : callable, optional
        From the link to the measurements that are combined, at the same time tag and count interval; only with
        ``Geometry.COMBINED``.
    positive : bool
        Whether the value must be above zero.
    largest_m, fastest_m_s : float or None
        Largest magnitude of the value, and of its change in a second of the count interval.
    limit : str
        Sentence that says why, for messages.

    Raises
    ------
    InputError
        The record contradicts itself.
    """

    name: str
    description: str
    geometry: Geometry
    integrated: bool = False
    tags: tuple[str, ...] = TIME_TAGS
    form: str = ""
    parts: Callable[[Link], tuple[Part, ...]] | None = None
    positive: bool = False
    largest_m: float | None = None
    fastest_m_s: float | None = None
    limit: str = ""

    def __post_init__(self) -> None:
        convert_fields(self)
        if (self.geometry is Geometry.COMBINED) != (self.parts is not None):
            raise InputError(
                f"measurement type {self.name}: parts belong to Geometry.COMBINED, and only to it"
            )
        if not self.form:
            object.__setattr__(self, "form", self.geometry.value)
        unknown = set(self.tags) - set(TIME_TAGS)
        if not self.name.isidentifier() or not self.tags or unknown or not self.form:
            raise InputError(
                f"measurement type {self.name!r} needs a name of letters and underscores, a form of path and time "
                f"tags out of {', '.join(TIME_TAGS)}"
            )

    @property
    def on_baseline(self) -> bool:
        """Whether two stations receive."""
        return self.form.startswith("station1<")
