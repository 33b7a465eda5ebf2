"""Passes of a target over stations: when each sees it, and how high it stands, as a card."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from radioloc.report.cards import Card, Field, Shown, plural


@dataclass(frozen=True, slots=True)
class Pass:
    """A time in which a station sees the target above its mask.

    Parameters
    ----------
    station : str
        Name in the catalogue.
    start_utc, stop_utc : str
        First and last whole second.
    rises, sets : bool
        Whether it begins by a rise and ends by a set rather than by the limits of the search.
    hours : float
        How long it lasts, h.
    highest_deg : float
        Highest elevation, to the minute, without refraction.
    highest_utc : str
        When that is.
    target : str
        Which of several it is.
    """

    station: str
    start_utc: str
    stop_utc: str
    rises: bool
    sets: bool
    hours: float
    highest_deg: float
    highest_utc: str
    target: str = ""


@dataclass(frozen=True, slots=True)
class Passes(Shown):
    """All passes of targets over some stations; ``str()`` is a card.

    Parameters
    ----------
    name : str
        Name of the study.
    start_utc, stop_utc : str
        Limits of the search.
    masks_deg : dict of str to float
        Elevation of each station below which it does not see the target, in the order of the stations.
    target_mask_deg : float
        The same of the target.
    passes : tuple of Pass
        By target and station, then in the order of time.
    targets : tuple of str
        Names of several.
    """

    name: str
    start_utc: str
    stop_utc: str
    masks_deg: dict[str, float]
    target_mask_deg: float
    passes: tuple[Pass, ...]
    targets: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """All of it, in types that JSON has."""
        return asdict(self)

    def card(self) -> Card:
        """A table of the passes."""
        heading = (*["target"] * bool(self.targets), "station", "rise", "set", "hours", "max, deg", "at")
        span = f"{self.start_utc} to {self.stop_utc} UTC"
        masks = sorted(set(self.masks_deg.values()))
        above = " or ".join(f"{mask:g}" for mask in masks)
        return Card(
            [
                Field("visibility", [self.name]),
                Field("span", [span]),
                Field("mask", [f"{above} deg at the stations, {self.target_mask_deg:g} deg at the target"]),
                Field("passes", [plural(len(self.passes), "pass", "es")], heading, map(_cells, self.passes)),
                Field("never seen", self._never()),
            ]
        )

    def _never(self) -> Iterator[str]:
        seen = {(one.target, one.station) for one in self.passes}
        for target in self.targets or ("",):
            if unseen := [name for name in self.masks_deg if (target, name) not in seen]:
                yield f"{target} by {', '.join(unseen)}".lstrip()


def _cells(one: Pass) -> tuple[str, ...]:
    """Month, day and time; the span has the year."""
    return (
        *[one.target] * bool(one.target),
        one.station,
        _short(one.start_utc) if one.rises else "already up",
        _short(one.stop_utc) if one.sets else "still up",
        f"{one.hours:.2f}",
        f"{one.highest_deg:.1f}",
        one.highest_utc[11:16],
    )


def _short(utc: str) -> str:
    return utc[5:19].replace("T", " ")
