"""Limits that every lunar ranging file must keep."""

from __future__ import annotations

from pathlib import Path

from radioloc.errors import FileFormatError

FLIGHT_TIME_LIMITS_S = (2.2, 2.8)
"""Round-trip light times between the Earth's and the Moon's surface lie well inside (2.31 to 2.74 s)."""

YEARS = (1972, 2100)
"""First year of UTC with leap seconds, and one beyond any data."""


def require_lunar_flight_time(path: str | Path, line: int, flight_time_s: float) -> None:
    """Raise :class:`FileFormatError` for a round-trip time of flight that no lunar target has."""
    low, high = FLIGHT_TIME_LIMITS_S
    if low < flight_time_s < high:
        return
    problem = f"the time of flight is {flight_time_s!r} s, but between Earth and Moon it is {low} to {high} s"
    advice = "leave the point out or correct it"
    for factor, said in (
        (2.0, "half of such a one: give the round trip"),
        (0.5, "twice such a one: halve it"),
    ):
        if low < factor * flight_time_s < high:
            advice = f"it is {said}, if that is what it holds"
    raise FileFormatError(path, f"{problem}; {advice}", line)


def require_year(path: str | Path, line: int, year: int) -> None:
    """Raise :class:`FileFormatError` for a year that is not one of UTC as it is today."""
    if not YEARS[0] <= year <= YEARS[1]:
        raise FileFormatError(
            path, f"the year is {year}; years from {YEARS[0]} to {YEARS[1]} can be read", line
        )
