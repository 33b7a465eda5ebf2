"""Types of measurement of the package, of other packages, and of :func:`radioloc.register`.

Other packages add a :class:`~radioloc.measurements.registry.MeasurementType` by an entry point of the group
``radioloc.measurements``.

Values are light times in metres. Time tags are UTC of the transmission or the reception at a station, or of the bounce
by a clock at the geocentre.

Range: the time of flight from a station over the target to a station, by the stations' clocks: always a round trip.
Moyer (2003), section 13.5. Integrated Doppler: the round-trip range at the end of the count interval less that at
its start, tagged at the middle of the interval. Moyer (2003), section 13.3, at one uplink frequency.

One-way range: the time of flight from the target to a station, reception read by the station's clock less transmission
read by the target's, which keeps proper time (:mod:`~radioloc.measurements.proper_time`). The behaviour of its
oscillator beyond that is estimated (``target_clock``, ``target_frequency``, ``target_frequency_rate``). The tag of a
transmission is by the target's clock. One-way Doppler is its change over the count interval. Moyer (2003), sections
11.4 and 13.3.1 (F1).

VLBI delay: the arrival at the second station less the arrival of the same wavefront at the first, by the stations'
clocks, tagged with the arrival at the first. The delay rate is its change over the count interval (of the phase).

Differences have one time tag for both measurements. Differenced one-way range and Doppler are free of the target's
clock but for its drift over the difference of the light times; a differenced delay of two targets (same-beam VLBI) is
free of the stations' clocks and, nearly, of the media. Moyer (2003), section 13.6; Kikuchi et al. (2009), Radio Science
44, RS2008.

A :class:`MeasurementType` states the legs, the events of the time tag and the limits of the value. A value is the
speed of light times the travel time of a signal over its legs, by the clocks at their ends, its change over a count
interval, or a linear combination of such values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.link import Link
from radioloc.plugins import DerivedNames, Registry
from radioloc.quantities import convert_fields
from radioloc.units import set_fields
from radioloc.vectors import Mask

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


def _of_stations(one_way: str) -> Callable[[Link], tuple[Part, ...]]:
    return lambda link: (
        Part(1.0, one_way, Link("", link.target, link.receiver)),
        Part(-1.0, one_way, Link("", link.target, link.transmitter)),
    )


_PACKAGED = [
    MeasurementType(
        name="range",
        description="round-trip light time from a station over the target to the same (two-way) or another station "
        "(three-way), times the speed of light",
        geometry=Geometry.ROUND_TRIP,
        positive=True,
        limit="a round trip",
    ),
    MeasurementType(
        name="vlbi_delay",
        description="arrival of a wavefront at the second station less its arrival at the first, times the speed of "
        "light; tagged with the arrival at the first station",
        geometry=Geometry.BASELINE,
        tags=("receive",),
        largest_m=12.8e6,
        limit="a VLBI delay below the Earth's diameter (12.8e6 m, 43 ms)",
    ),
    MeasurementType(
        name="doppler",
        description="integrated Doppler: round-trip range at the end of the count interval less that at its start; the "
        "time tag is the middle of the interval",
        geometry=Geometry.ROUND_TRIP,
        integrated=True,
    ),
    MeasurementType(
        name="vlbi_delay_rate",
        description="VLBI delay at the end of the count interval less that at its start; tagged with the arrival at "
        "the first station at the middle of the interval",
        geometry=Geometry.BASELINE,
        integrated=True,
        tags=("receive",),
        largest_m=12.8e6,
        # Two stations on opposite sides of the equator separate by 2 x 465 m/s.
        fastest_m_s=1000.0,
        limit="a change of the VLBI delay below 1000 m in a second of the count interval",
    ),
    MeasurementType(
        name="one_way_range",
        description="one-way light time from the target to a station, reception by the station's clock less "
        "transmission by the target's, times the speed of light",
        geometry=Geometry.ONE_WAY,
        tags=("receive", "transmit"),
    ),
    MeasurementType(
        name="one_way_doppler",
        description="one-way integrated Doppler: one-way range at the end of the count interval less that at its "
        "start; the time tag is the middle of the interval",
        geometry=Geometry.ONE_WAY,
        integrated=True,
        tags=("receive", "transmit"),
    ),
    MeasurementType(
        name="differenced_range",
        description="one-way range at the second station less that at the first, both received at the time tag",
        geometry=Geometry.COMBINED,
        form="station1<target>station2",
        tags=("receive",),
        parts=_of_stations("one_way_range"),
    ),
    MeasurementType(
        name="differenced_doppler",
        description="one-way integrated Doppler at the second station less that at the first, over the same "
        "count interval",
        geometry=Geometry.COMBINED,
        integrated=True,
        form="station1<target>station2",
        tags=("receive",),
        parts=_of_stations("one_way_doppler"),
    ),
    MeasurementType(
        name="differenced_delay",
        description="VLBI delay of the first target less that of the second, both arriving at the first station at the "
        "time tag (same-beam VLBI)",
        geometry=Geometry.COMBINED,
        form="station1<target1|target2>station2",
        tags=("receive",),
        parts=lambda link: (
            Part(1.0, "vlbi_delay", Link(link.transmitter, link.target, link.receiver, True)),
            Part(-1.0, "vlbi_delay", Link(link.transmitter, link.second_target, link.receiver, True)),
        ),
    ),
]
_PACKAGED_CODES = {kind.name: code for code, kind in enumerate(_PACKAGED)}

MEASUREMENTS: Mapping[str, MeasurementType] = Registry("radioloc.measurements", MeasurementType, _PACKAGED)
"""Types of measurement by name; :attr:`Observations.kind` has indices in this order."""

KINDS = DerivedNames(lambda: MEASUREMENTS)  # their names


def _table(trait: str) -> Mask:
    """Return a mask of types that have a trait, or the geometry of that name."""
    return np.array([getattr(kind, trait, kind.geometry.name == trait) for kind in MEASUREMENTS.values()])


def is_integrated(kind: NDArray[np.int8]) -> Mask:
    """Return a mask of differences over a count interval: Doppler and delay rates."""
    return np.asarray(_table("integrated")[kind])


def is_differenced(kind: NDArray[np.int8]) -> Mask:
    """Return a mask of measurements of baselines, two stations that receive."""
    return np.asarray(_table("on_baseline")[kind])


def is_one_way(kind: NDArray[np.int8]) -> Mask:
    """Return a mask of one-way measurements, of a signal from the target at a station."""
    return np.asarray(_table("ONE_WAY")[kind])


def is_combined(kind: NDArray[np.int8]) -> Mask:
    """Return a mask of linear combinations of simple measurements."""
    return np.asarray(_table("COMBINED")[kind])


def kind_of(name: str) -> int:
    """Return the index of a type of measurement in :data:`KINDS`."""
    return _PACKAGED_CODES[name] if name in _PACKAGED_CODES else KINDS.index(name)
