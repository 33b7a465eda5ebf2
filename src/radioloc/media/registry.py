"""The media that there are: those of the package, one line each, and those of other packages.

A package adds its own by an entry point of the group ``radioloc.media`` that names a
:class:`~radioloc.media.medium.Medium`.
"""

from __future__ import annotations

from collections.abc import Mapping

from radioloc.media.axis_offset import AntennaAxisOffset
from radioloc.media.ionosphere import Ionosphere
from radioloc.media.medium import Medium
from radioloc.media.troposphere import Troposphere
from radioloc.plugins import registry

MEDIA: Mapping[str, Medium] = registry(
    "radioloc.media",
    Medium,  # type: ignore[type-abstract]
    [Troposphere(), Ionosphere(), AntennaAxisOffset()],
)
"""Media by name, as they are without files."""
