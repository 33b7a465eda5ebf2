"""Media on the path of the signal: delay of each leg, partial derivatives, and the status of the model.

:data:`MEDIA` has the media of the package (:class:`Medium`), those of entry points of the group ``radioloc.media``, and
those that :func:`radioloc.register` adds. Delays and lengths are metres, angles radians, electron contents TECU
(1e16 per square metre).
"""

from collections.abc import Mapping

from radioloc.media.axis_offset import AntennaAxisOffset
from radioloc.media.csp import read_csp
from radioloc.media.elevation_delay import ElevationDelay
from radioloc.media.ionex import read_ionex
from radioloc.media.ionosphere import Ionosphere, UniformTec
from radioloc.media.medium import Leg, LegDelay, LegEnd, Medium, Status
from radioloc.media.radio_atmosphere import read_radio_atmosphere
from radioloc.media.troposphere import Troposphere
from radioloc.plugins import Registry

__all__ = [
    "MEDIA",
    "ElevationDelay",
    "Leg",
    "LegDelay",
    "LegEnd",
    "Medium",
    "Status",
    "UniformTec",
    "read_csp",
    "read_ionex",
    "read_radio_atmosphere",
]

MEDIA: Mapping[str, Medium] = Registry(
    "radioloc.media",
    Medium,  # type: ignore[type-abstract]
    [Troposphere(), Ionosphere(), AntennaAxisOffset()],
)
"""Media by name, without the files that a study may give them."""
