"""Predictions for a target: light times, ranges and pointing over a grid of epochs, passes over stations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from radioloc.estimation.statistics import finite_or_none
from radioloc.labels import Labels
from radioloc.quantities import TableForm, as_table
from radioloc.results.cards import Card, Field, plural, remaining_line
from radioloc.results.result import Result
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats

_MAX_ROWS = 12
_FILE = "the file of --out, and with --json"
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

    Columns, in this order, NaN if a link has no first station:

    - ``uplink_light_time_s``, ``downlink_light_time_s``: legs in TDB, with the delays of gravity and media.
    - ``range_m``: round trip in the time of the station clocks, times the speed of light; one way with the clock of the
      target.
    - ``range_rate_m_s``: derivative of the range from the carrier phase.
    - ``doppler_hz``: received frequency less `frequency_hz`, if given.
    - ``transmit_...`` and ``receive_...``, of the first station at transmission and of the second at the epoch:
      ``azimuth_deg``, ``elevation_deg`` without refraction; ``ra_deg``, ``dec_deg``, apparent, of the true equator and
      equinox of date; ``icrs_ra_deg``, ``icrs_dec_deg``, astrometric. All are topocentric.
    """

    name: str  #: of the study
    start_utc: str  #: first requested epoch
    stop_utc: str  #: last requested epoch
    unseen: int  #: number of omitted epochs at which a station of the link does not see the target
    frequency_hz: float | None  #: received frequency without motion, Hz, for the Doppler column
    epoch: Epochs  #: UTC of reception at the receiving station, n of them
    path: Labels  #: paths such as ``KASHI>lander>JIAMUSI`` or, one way, ``lander>KASHI``
    columns: dict[str, Floats]  #: by name, (n,)
    status: Labels  #: empty, or the omitted part of the model, such as the troposphere below 3 degrees
    notes: tuple[str, ...] = ()  #: antennas of one complex

    def __len__(self) -> int:
        return len(self.epoch)

    def __getitem__(self, column: str) -> Floats:
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
        # If a name ends in two units, such as s and m_s, the later applies.
        units = _DECIMALS.items()
        return {name: n for unit, n in units for name in self.columns if name.endswith(f"_{unit}")}

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers in types that JSON has: columns as lists, NaN as ``None``."""
        columns = {name: [*map(finite_or_none, column)] for name, column in self.columns.items()}
        named = ("name", "start_utc", "stop_utc", "unseen", "frequency_hz")
        texts = {"path": self.path[:].tolist(), "status": self.status[:].tolist()}
        dates = {"epoch_utc": utc_strings(self.epoch, 3).tolist()}
        return {key: getattr(self, key) for key in named} | {
            "columns": {name: (dates | texts | columns)[name] for name in self.named_columns()}
        }

    def card(self) -> Card:
        """Return a card with the first rows of each link."""
        count = plural(len(self), "row")
        unseen = f"; {self.unseen} omitted, as a station does not see the target" if self.unseen else ""
        pointing = "at reception, no refraction; apparent ra and dec, of date"
        return Card(
            [
                Field("light time", [self.name]),
                Field("span", [f"{self.start_utc} to {self.stop_utc} UTC, of reception"]),
                Field("rows", [count + unseen]),
                *self._tables("signal", _SIGNAL, "light times in TDB; rate of the range"),
                *self._tables("pointing", _POINTING, pointing),
                Field("notes", self.notes),
            ]
        )

    def _tables(self, label: str, names: dict[str, tuple[str, int]], caption: str) -> Iterator[Field]:
        yield Field(label, [caption])
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
                yield Field("", [text], heading, cells, remaining_line(len(rows), len(first), _FILE))


@dataclass(frozen=True, slots=True)
class Pass:
    """Interval in which a station sees the target above its mask."""

    station: str  # name in the catalogue
    start_utc: str  # first and last whole second
    stop_utc: str
    rises: bool  # whether it begins with a rise, not at the limit of the search
    sets: bool  # whether it ends with a set
    hours: float  # length
    highest_deg: float  # elevation, to the minute, without refraction
    highest_utc: str
    target: str = ""  # name of one of several


@dataclass(frozen=True, slots=True)
class Passes(Result):
    """Passes of targets over some stations; ``str()`` is a card."""

    name: str  # of the study
    start_utc: str  # limits of the search
    stop_utc: str
    masks_deg: dict[str, float]  # lowest elevations of the target by station
    target_mask_deg: float  # lowest elevation of the stations at the target
    passes: tuple[Pass, ...]  # by target and station, then in the order of time
    targets: tuple[str, ...] = ()  # names of several
    notes: tuple[str, ...] = ()  # antennas of one complex, and the horizon of a point

    def to_dict(self) -> dict[str, Any]:
        """Return all fields in types that JSON has."""
        return asdict(self)

    def card(self) -> Card:
        """Return a card with a table of the passes."""
        heading = (*["target"] * bool(self.targets), "station", "rise", "set", "hours", "max, deg", "at")
        span = f"{self.start_utc} to {self.stop_utc} UTC"
        masks = sorted(set(self.masks_deg.values()))
        elevations = " or ".join(f"{mask:g}" for mask in masks)
        return Card(
            [
                Field("visibility", [self.name]),
                Field("span", [span]),
                Field(
                    "mask", [f"{elevations} deg at the stations, {self.target_mask_deg:g} deg at the target"]
                ),
                Field(
                    "passes", [plural(len(self.passes), "pass", "es")], heading, map(_pass_cells, self.passes)
                ),
                Field("never seen", self._unseen()),
                Field("notes", self.notes),
            ]
        )

    def _unseen(self) -> Iterator[str]:
        visible = {(item.target, item.station) for item in self.passes}
        for target in self.targets or ("",):
            if unseen := [name for name in self.masks_deg if (target, name) not in visible]:
                yield f"{target} by {', '.join(unseen)}".lstrip()


def _pass_cells(item: Pass) -> tuple[str, ...]:
    """Return the cells of a pass, with dates without the year."""
    return (
        *[item.target] * bool(item.target),
        item.station,
        _short(item.start_utc) if item.rises else "already up",
        _short(item.stop_utc) if item.sets else "still up",
        f"{item.hours:.2f}",
        f"{item.highest_deg:.1f}",
        item.highest_utc[11:16],
    )


def _short(utc: str) -> str:
    return utc[5:19].replace("T", " ")
