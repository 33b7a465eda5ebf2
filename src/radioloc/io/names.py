"""Station names as the catalogue writes them, where it knows them."""

from __future__ import annotations

from typing import Any, Protocol

from radioloc.errors import StationError
from radioloc.measurements.link import Link
from radioloc.measurements.targets import canonical_target


class Catalogue(Protocol):
    """What reading needs of a station catalogue."""

    def get(self, name: str) -> Any:
        """Station of a name or alias, with an attribute ``name``; :class:`StationError` if unknown."""


def station_name(names: tuple[str, ...], catalogue: Catalogue | None) -> str:
    """Catalogue's name of a station that a file gives one or more names for.

    Parameters
    ----------
    names : tuple of str
        Names in the file, the most reliable first.
    catalogue : Catalogue or None
        Where to look them up; without one the first name is kept.

    Returns
    -------
    str
        The first name as it stands where the catalogue knows none of them; it is the model that then says so.
    """
    if catalogue is not None:
        for name in names:
            try:
                return str(catalogue.get(name).name)
            except StationError:
                continue
    return names[0]


def named_link(link: Link, catalogue: Catalogue | None) -> Link:
    """Make the same link under canonical names."""
    return Link(
        station_name((link.transmitter,), catalogue),
        canonical_target(link.target),
        station_name((link.receiver,), catalogue),
        link.differenced,
    )
