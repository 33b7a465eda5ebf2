"""Where targets are seen on maps: how far each is east and north of the place that was read.

A descent camera, or an orbiter that sees a lander, gives a place on a map. The computed values are how far the target
is east and north of that place, m on the ground, in the map's axes (mean Earth); the measured values therefore are
zero. The Moon carries map and target alike, so there is neither a leg nor a station, and the time tag says nothing.
"""

from radioloc.measurements.measurement_type import Geometry, MeasurementType

MAP_EAST = MeasurementType(
    name="map_east",
    description="how far the target is east of the place that was read on a map",
    geometry=Geometry.MAP,
)
MAP_NORTH = MeasurementType(
    name="map_north",
    description="how far the target is north of the place that was read on a map",
    geometry=Geometry.MAP,
)
