"""Half of a range, as one-way equivalents are logged; the time tag is that of the range."""

from radioloc.measurements import Geometry, MeasurementType, Part

HALF_RANGE = MeasurementType(
    name="half_range",
    description="half of the two- or three-way range",
    geometry=Geometry.COMBINED,
    form="transmitter>target>receiver",
    parts=lambda link: (Part(0.5, "range", link),),
    positive=True,
)
