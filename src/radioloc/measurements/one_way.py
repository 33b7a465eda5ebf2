"""One-way range and integrated Doppler of a signal that the target generates.

Measured is the time of flight from the target to a station, times the speed of light: reception read by the station's
clock less transmission read by the target's, which keeps proper time (:mod:`~radioloc.measurements.proper_time`); what
its oscillator does beyond that are parameters (``target_clock``, ``target_frequency``, ``target_frequency_rate``). The
time tag is UTC and names the reception, or the transmission by the target's clock. One-way
Doppler is the range difference over the count interval, tagged at its middle. Moyer (2003), sections 11.4 and 13.3.1
(F1).
"""

from radioloc.measurements.measurement_type import Geometry, MeasurementType

ONE_WAY_RANGE = MeasurementType(
    name="one_way_range",
    description="one-way light time from the target to a station, reception by the station's clock less transmission "
    "by the target's, times the speed of light",
    geometry=Geometry.ONE_WAY,
    tags=("receive", "transmit"),
)
ONE_WAY_DOPPLER = MeasurementType(
    name="one_way_doppler",
    description="one-way integrated Doppler: one-way range at the end of the count interval less that at its start; "
    "the time tag is the middle of the interval",
    geometry=Geometry.ONE_WAY,
    integrated=True,
    tags=("receive", "transmit"),
)
