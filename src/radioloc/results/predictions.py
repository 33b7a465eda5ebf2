"""Predictions for a target: light times, ranges and pointing over a grid of epochs, passes over stations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.statistics import finite_or_none
from radioloc.labels import Labels
from radioloc.results.cards import Card, Field, more, plural
from radioloc.results.result import Result
from radioloc.tables import TableForm, as_table
from radioloc.time import Epochs, utc_strings

_MAX_ROWS = 12
_WHERE = "the file of --out, and with --json"
_SIGNAL = {
    "uplink_light_time_s": ("up, s", 7),
    "downlink_light_time_s": ("down, s", 7),
    "range_rate_m_s": ("rate, m/s", 4),
    "doppler_hz": ("Doppler, Hz", 2),
}
"""Columns on the card: heading and decimals."""
_POINTING = {
    "receive_azimuth_deg": ("az, deg", 4),
    "receive_elevation_deg": ("el, deg", 4),
    "receive_ra_deg": ("ra, deg", 4),
    "receive_dec_deg": ("dec, deg", 4),
}
_DECIMALS = {"s": 12, "m": 4, "m_s": 7, "hz": 6, "deg": 7}


@dataclass(frozen=True, slots=True, eq=False)
class LightTimes(Result):
    """Light times of links at n epochs of reception; ``str()`` is a card with the first of each link.

    Parameters
    ----------
    name : str
        Name of the study.
    start_utc, stop_utc : str
        First and last epoch that was asked for.
    unseen : int
        Epochs of links at which not all of their stations see the target; they are no rows.
    frequency_hz : float or None
        Of the signal that is received if nothing moves, for the Doppler column.
    epoch : Epochs
        UTC of the reception at the receiving station.
    path : Labels
        Such as ``KASHI>lander>JIAMUSI`` or, one way, ``lander>KASHI``.
    columns : dict of str to ndarray, shape (n,)
        In this order; NaN where a link has no first station:

        - ``uplink_light_time_s``, ``downlink_light_time_s``: of the legs in TDB, with the delays by gravity and media.
        - ``range_m``: round trip as the clocks of the stations tell it, times the speed of light; one way with the
          target's own clock.
        - ``range_rate_m_s``: its change with the epoch, as the phase of the carrier has it.
        - ``doppler_hz``: received frequency less `frequency_hz`; only with one.
        - ``transmit_...`` and ``receive_...``, of the first station when it sends and of the second at the epoch:
          ``azimuth_deg``, ``elevation_deg`` without refraction; ``ra_deg``, ``dec_deg``, apparent, of the true equator
          and equinox of date; ``icrs_ra_deg``, ``icrs_dec_deg``, astrometric. All are topocentric.
    status : Labels
        Empty, or what of the model does not hold, such as the troposphere below 3 degrees, which then is left out.
    """

    name: str
    start_utc: str
    stop_utc: str
    unseen: int
    frequency_hz: float | None
    epoch: Epochs
    path: Labels
    columns: dict[str, NDArray[np.float64]]
    status: Labels

    def __len__(self) -> int:
        return len(self.epoch)

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        """Return one of the columns."""
        return self.columns[column]

    def named_columns(self) -> dict[str, Any]:
        """Return all columns by name."""
        return {"epoch_utc": self.epoch, "path": self.path, **self.columns, "status": self.status}

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Return all columns as a ``QTable`` of astropy, with units and ``Time``, or a ``DataFrame`` of pandas.

        Examples
        --------
        >>> from radioloc import light_times
        >>> found = light_times("examples/change5/short_arc.toml", ["KASHI"], step_s=1800.0)
        >>> found.to_table()["downlink_light_time_s"].to("ms").round(1)
        <Quantity [1316.1, 1314.1, 1312.3] ms>
        """
        texts = {"path": self.path[:], "status": self.status[:]}
        return as_table(self.named_columns() | texts, form)

    @property
    def decimals(self) -> dict[str, int]:
        """Decimals of the columns of numbers in a file."""
        # Of two units that a name ends in, such as s and m_s, the later applies.
        units = _DECIMALS.items()
        return {name: n for unit, n in units for name in self.columns if name.endswith(f"_{unit}")}

    def to_dict(self) -> dict[str, Any]:
        """Return all of it in types that JSON has: columns as lists, ``None`` where there is no number."""
        columns = {name: [*map(finite_or_none, column)] for name, column in self.columns.items()}
        named = ("name", "start_utc", "stop_utc", "unseen", "frequency_hz")
        texts = {"path": self.path[:].tolist(), "status": self.status[:].tolist()}
        dates = {"epoch_utc": utc_strings(self.epoch, 3).tolist()}
        return {key: getattr(self, key) for key in named} | {
            "columns": {name: (dates | texts | columns)[name] for name in self.named_columns()}
        }

    def card(self) -> Card:
        """Return the first rows of each link."""
        count = plural(len(self), "row")
        unseen = f"; {self.unseen} left out, when a station does not see it" if self.unseen else ""
        pointing = "at reception, no refraction; apparent ra and dec, of date"
        return Card(
            [
                Field("light time", [self.name]),
                Field("span", [f"{self.start_utc} to {self.stop_utc} UTC, of reception"]),
                Field("rows", [count + unseen]),
                *self._tables("signal", _SIGNAL, "light times in TDB; rate of the range"),
                *self._tables("pointing", _POINTING, pointing),
            ]
        )

    def _tables(self, label: str, names: dict[str, tuple[str, int]], what: str) -> Iterator[Field]:
        yield Field(label, [what])
        shown = [name for name in names if name in self.columns and np.isfinite(self[name]).any()]
        heading = ["UTC", *(names[name][0] for name in shown)]
        for code, text in enumerate(self.path.texts):
            rows = np.flatnonzero(self.path.codes == code)
            first = rows[:_MAX_ROWS]
            dates = [date[5:].replace("T", " ") for date in utc_strings(self.epoch[first], 0).tolist()]
            columns = [
                ["-" if np.isnan(x) else f"{x:.{names[name][1]}f}" for x in self[name][first]]
                for name in shown
            ]
            cells = zip(dates, *columns, strict=True)
            if len(rows):
                yield Field("", [text], heading, cells, more(len(rows), len(first), _WHERE))


@dataclass(frozen=True, slots=True)
class Pass:
    """A time in which a station sees the target above its mask."""

    station: str  # name in the catalogue
    start_utc: str  # first and last whole second
    stop_utc: str
    rises: bool  # whether it begins by a rise rather than by the limit of the search
    sets: bool  # likewise whether it ends by a set
    hours: float  # how long it lasts
    highest_deg: float  # elevation, to the minute, without refraction
    highest_utc: str
    target: str = ""  # which of several it is


@dataclass(frozen=True, slots=True)
class Passes(Result):
    """Passes of targets over some stations; ``str()`` is a card."""

    name: str  # of the study
    start_utc: str  # limits of the search
    stop_utc: str
    masks_deg: dict[str, float]  # elevations below which stations do not see the target, in their order
    target_mask_deg: float  # the same of the target
    passes: tuple[Pass, ...]  # by target and station, then in the order of time
    targets: tuple[str, ...] = ()  # names of several

    def to_dict(self) -> dict[str, Any]:
        """Return all of it in types that JSON has."""
        return asdict(self)

    def card(self) -> Card:
        """Return a table of the passes."""
        heading = (*["target"] * bool(self.targets), "station", "rise", "set", "hours", "max, deg", "at")
        span = f"{self.start_utc} to {self.stop_utc} UTC"
        masks = sorted(set(self.masks_deg.values()))
        above = " or ".join(f"{mask:g}" for mask in masks)
        return Card(
            [
                Field("visibility", [self.name]),
                Field("span", [span]),
                Field("mask", [f"{above} deg at the stations, {self.target_mask_deg:g} deg at the target"]),
                Field(
                    "passes", [plural(len(self.passes), "pass", "es")], heading, map(_pass_cells, self.passes)
                ),
                Field("never seen", self._never()),
            ]
        )

    def _never(self) -> Iterator[str]:
        seen = {(item.target, item.station) for item in self.passes}
        for target in self.targets or ("",):
            if unseen := [name for name in self.masks_deg if (target, name) not in seen]:
                yield f"{target} by {', '.join(unseen)}".lstrip()


def _pass_cells(seen: Pass) -> tuple[str, ...]:
    """Month, day and time; the span has the year."""
    return (
        *[seen.target] * bool(seen.target),
        seen.station,
        _short(seen.start_utc) if seen.rises else "already up",
        _short(seen.stop_utc) if seen.sets else "still up",
        f"{seen.hours:.2f}",
        f"{seen.highest_deg:.1f}",
        seen.highest_utc[11:16],
    )


def _short(utc: str) -> str:
    return utc[5:19].replace("T", " ")
