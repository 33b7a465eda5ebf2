"""What the signal meets on its way: each medium gives the delay of a leg, its partials, and why it has none.

:data:`MEDIA` are those of the model (:class:`Medium`); the readers give them files. Delays and lengths are metres,
angles radians, electron contents TECU (1e16 per square metre).
"""

from radioloc.media.csp import MediaCalibrations, read_csp
from radioloc.media.ionex import IonexMaps, read_ionex
from radioloc.media.ionosphere import UniformTec
from radioloc.media.medium import Elevation, Leg, LegDelay, LegEnd, Medium
from radioloc.media.radio_atmosphere import RadioAtmosphere, read_radio_atmosphere
from radioloc.media.registry import MEDIA
from radioloc.media.status import Status

__all__ = [
    "MEDIA",
    "Elevation",
    "IonexMaps",
    "Leg",
    "LegDelay",
    "LegEnd",
    "MediaCalibrations",
    "Medium",
    "RadioAtmosphere",
    "Status",
    "UniformTec",
    "read_csp",
    "read_ionex",
    "read_radio_atmosphere",
]
