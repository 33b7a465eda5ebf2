"""Two- and three-way range.

Measured is the time of flight from a station over the target to a station, by the stations' clocks, times the speed of
light: a round trip, never its half. The time tag is UTC at the station and names the transmission or the reception, or,
as if by a clock at the geocentre, the bounce. Moyer (2003), section 13.5.
"""

from radioloc.measurements.measurement_type import Geometry, MeasurementType

RANGE = MeasurementType(
    name="range",
    description="round-trip light time from a station over the target to the same (two-way) or another station "
    "(three-way), times the speed of light",
    geometry=Geometry.ROUND_TRIP,
    positive=True,
    limit="a round trip",
)
