"""Differences of measurements: of one target at two stations, of two targets at one baseline.

Both measurements of a difference have the same time tag. Differenced one-way range and Doppler are free of the target's
clock but for its drift over the difference of the light times; a differenced delay of two targets (same-beam VLBI) is
free of the stations' clocks and, nearly, of the media. Moyer (2003), section 13.6; Kikuchi et al. (2009), Radio Science
44, RS2008.
"""

from collections.abc import Callable

from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import Geometry, MeasurementType, Part


def _of_stations(one_way: str) -> Callable[[Link], tuple[Part, ...]]:
    return lambda link: (
        Part(1.0, one_way, Link("", link.target, link.receiver)),
        Part(-1.0, one_way, Link("", link.target, link.transmitter)),
    )


DIFFERENCED_RANGE = MeasurementType(
    name="differenced_range",
    description="one-way range at the second station less that at the first, both received at the time tag",
    geometry=Geometry.COMBINED,
    form="station1<target>station2",
    tags=("receive",),
    parts=_of_stations("one_way_range"),
)
DIFFERENCED_DOPPLER = MeasurementType(
    name="differenced_doppler",
    description="one-way integrated Doppler at the second station less that at the first, over the same count interval",
    geometry=Geometry.COMBINED,
    integrated=True,
    form="station1<target>station2",
    tags=("receive",),
    parts=_of_stations("one_way_doppler"),
)
DIFFERENCED_DELAY = MeasurementType(
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
)
