"""What the signal meets on its way: each medium gives the delay of a leg, its partials, and why it has none.

:data:`MEDIA` are those of the model (:class:`Medium`); other names read their files or compute delays directly.
Delays and lengths are metres, angles radians, electron contents TECU (1e16 per square metre).
"""

from radioloc.media.gpt3 import Gpt3Grid, read_gpt3
from radioloc.media.ionex import IonexMaps, read_ionex
from radioloc.media.ionosphere import (
    UniformTec,
    ionosphere_delay_m,
    modified_shell_mapping,
)
from radioloc.media.medium import Elevation, Leg, LegDelay, LegEnd, Medium
from radioloc.media.optical_troposphere import optical_delay
from radioloc.media.radio_troposphere import (
    standard_weather,
    zenith_hydrostatic_delay_m,
    zenith_wet_delay_m,
)
from radioloc.media.registry import MEDIA
from radioloc.media.status import Status
from radioloc.media.vmf3_files import Vmf3Grids, Vmf3Site, read_vmf3_grids, read_vmf3_sites

__all__ = [
    "MEDIA",
    "Elevation",
    "Gpt3Grid",
    "IonexMaps",
    "Leg",
    "LegDelay",
    "LegEnd",
    "Medium",
    "Status",
    "UniformTec",
    "Vmf3Grids",
    "Vmf3Site",
    "ionosphere_delay_m",
    "modified_shell_mapping",
    "optical_delay",
    "read_gpt3",
    "read_ionex",
    "read_vmf3_grids",
    "read_vmf3_sites",
    "standard_weather",
    "zenith_hydrostatic_delay_m",
    "zenith_wet_delay_m",
]
