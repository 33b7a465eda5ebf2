"""VLBI delay and its change over a count interval.

Measured is the arrival at the second station less the arrival of the same wavefront at the first, by the stations'
clocks, times the speed of light. The time tag is UTC of the arrival at the first station; of a delay rate, at the
middle of the count interval, over which the delay's difference is taken (of the phase).
"""

from radioloc.measurements.measurement_type import Geometry, MeasurementType

VLBI_DELAY = MeasurementType(
    name="vlbi_delay",
    description="arrival of a wavefront at the second station less its arrival at the first, times the speed of light; "
    "tagged with the arrival at the first station",
    geometry=Geometry.BASELINE,
    tags=("receive",),
    largest_m=12.8e6,
    limit="a VLBI delay is not longer than the Earth (12.8e6 m, 43 ms)",
)
VLBI_DELAY_RATE = MeasurementType(
    name="vlbi_delay_rate",
    description="VLBI delay at the end of the count interval less that at its start; tagged with the arrival at the "
    "first station at the middle of the interval",
    geometry=Geometry.BASELINE,
    integrated=True,
    tags=("receive",),
    largest_m=12.8e6,
    # Two stations on the equator, one on either side of the Earth, part by 2 x 465 m/s.
    fastest_m_s=1000.0,
    limit="a VLBI delay changes by less than 1000 m in a second of its count interval",
)
