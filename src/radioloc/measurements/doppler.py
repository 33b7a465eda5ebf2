"""Two- and three-way integrated Doppler.

Measured is the range difference over the count interval: the round-trip range at the end of the interval less that at
its start, m. The time tag is UTC at the middle of the interval. Moyer (2003), section 13.3, at one uplink frequency.
"""

from radioloc.measurements.measurement_type import Geometry, MeasurementType

DOPPLER = MeasurementType(
    name="doppler",
    description="integrated Doppler: round-trip range at the end of the count interval less that at its start; the "
    "time tag is the middle of the interval",
    geometry=Geometry.ROUND_TRIP,
    integrated=True,
)
