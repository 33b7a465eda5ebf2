"""The table of observations: one row per measurement, one array per column.

Every value is in metres. A range is the length of the light path from the transmitter over the point on the Moon to the
receiver, as the speed of light times the time of flight in the station's clock (UTC rate): a round trip, not its half.
The epoch is UTC and belongs to the event that the time tag names. Millions of rows are meant to fit: no Python object
is kept per row.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError, InputError, visible
from radioloc.measurements.link import Link
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.registry import KINDS, MEASUREMENTS, is_integrated, kind_of
from radioloc.measurements.resolution import (
    MIN_RANGE_RATE_M_S,
    RELATIVE_STEP,
    epoch_step_s,
    is_single_precision,
    single_precision_groups,
    single_precision_step_m,
)
from radioloc.measurements.table_columns import (
    UNITS,
    as_codes,
    as_column,
    codes_of_names,
    columns_of_table,
    each_once,
    recoded,
    require_lunar_flight_times,
)
from radioloc.tables import TableForm, as_table
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.vectors import Floats

RANGE, VLBI_DELAY, DOPPLER, VLBI_DELAY_RATE = (
    kind_of(name) for name in ("range", "vlbi_delay", "doppler", "vlbi_delay_rate")
)

WEATHER_LIMITS = {
    "pressure_hpa": (100.0, 1100.0),
    "temperature_k": (150.0, 350.0),
    "relative_humidity": (0.0, 1.0),
    "wavelength_um": (0.1, 1e9),
}
"""Lowest and highest value that a station on Earth can have recorded; catches Celsius, percent and Pascal."""

_SIGMA_LIMITS_M = (1e-9, 1e12)
_TURNAROUND_LIMITS = (0.05, 20.0)
"""From Ka band up to S band down it is 0.067, the reverse 15; catches millimetres and wavelengths of light."""
_MAX_ROUNDING_US = 999  # largest difference of time tags by rounding to milliseconds, microseconds
_EPOCH_TOLERANCE_US = 10  # of the time tags of one observation; no path is measured twice in it
_MAX_SIGNALS = 16  # most observations of one path, kind and epoch, of different wavelengths
_MIN_ROUNDED_COUNT = 5  # fewest rounded copies within one file, as dense series may repeat a value
_ROUNDING_SIGMAS, _ROUNDING_M = 0.02, 2e-4
"""Largest difference of a value in two files, the sum of both: light times have 1 ps, ranges a part of their sigma."""
_OF_ALL = ("links", "files", "ramps")
_IN_MEMORY = "in memory"


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Observations in the order in which they were given; arrays are read-only.

    Build with :meth:`from_columns`, which checks everything; the plain constructor checks nothing.

    Parameters
    ----------
    epoch : Epochs
        When the event named by the time tag happened, UTC, n epochs.
    tag : ndarray of int8, shape (n,)
        Index into :data:`TIME_TAGS`.
    kind : ndarray of int8, shape (n,)
        Index into :data:`KINDS`.
    link : ndarray of int32, shape (n,)
        Index into ``links``.
    links : tuple of Link
        The different paths, each once.
    value_m : ndarray, shape (n,)
        What was measured, m: of a range the speed of light times the whole time of flight; of other
        kinds as :data:`KINDS` says.
    sigma_m : ndarray, shape (n,)
        Its standard deviation, m.
    pressure_hpa, temperature_k, relative_humidity : ndarray, shape (n,)
        Weather at the station; humidity from 0 to 1. NaN says that it was not recorded.
    wavelength_um : ndarray, shape (n,)
        Vacuum wavelength of the light or of the radio signal on its way down, micrometres. NaN says that it was not
        recorded.
    uplink_hz : ndarray, shape (n,)
        Frequency of the radio signal on its way up, Hz. NaN says that it was not recorded or does not apply.
    count_s : ndarray, shape (n,)
        Count interval of Doppler and of a delay rate, s; NaN for other kinds.
    modulus_m : ndarray, shape (n,)
        Modulus of an ambiguous range, m of light path; NaN where it is known in full.
    ramped : ndarray of bool, shape (n,)
        Whether the value counts cycles of a transmitted frequency that changes, as ``ramps`` say, with ``uplink_hz``,
        or one-way that of ``wavelength_um``, as the reference frequency that they are in metres by
        (:mod:`~radioloc.measurements.ramps`).
    files : tuple of str
        The files that the rows came from, each once.
    file : ndarray of int32, shape (n,)
        Index into ``files``.
    line : ndarray of int32, shape (n,)
        Line in that file, counted from 1.
    ramps : Ramps
        Transmitted frequencies of stations and, one-way, of targets.
    """

    epoch: Epochs
    tag: NDArray[np.int8]
    kind: NDArray[np.int8]
    link: NDArray[np.int32]
    links: tuple[Link, ...]
    value_m: Floats
    sigma_m: Floats
    pressure_hpa: Floats
    temperature_k: Floats
    relative_humidity: Floats
    wavelength_um: Floats
    uplink_hz: Floats
    count_s: Floats
    modulus_m: Floats
    ramped: NDArray[np.bool_]
    files: tuple[str, ...]
    file: NDArray[np.int32]
    line: NDArray[np.int32]
    ramps: Ramps

    @classmethod
    def from_columns(
        cls,
        *,
        epoch: Epochs | Any,
        links: Sequence[Link | str],
        value_m: ArrayLike,
        sigma_m: ArrayLike,
        link: ArrayLike = 0,
        tag: ArrayLike = "transmit",
        kind: ArrayLike = "range",
        pressure_hpa: ArrayLike = np.nan,
        temperature_k: ArrayLike = np.nan,
        relative_humidity: ArrayLike = np.nan,
        wavelength_um: ArrayLike = np.nan,
        uplink_hz: ArrayLike = np.nan,
        count_s: ArrayLike = np.nan,
        modulus_m: ArrayLike = np.nan,
        ramped: ArrayLike = False,
        files: Sequence[str] = (),
        file: ArrayLike = 0,
        line: ArrayLike | None = None,
        ramps: Ramps | None = None,
        single_precision: Collection[str] = (),
    ) -> Observations:
        """Check and copy columns; a single value stands for all rows.

        Parameters are those of the class. ``kind`` and ``tag`` are names (``"doppler"``, ``"receive"``) or the indices
        that a table has, ``links`` are links or paths such as ``"KASHI>lander>KASHI"``. Without ``files`` the rows
        count as made in memory, and ``line`` is the row counted from 1. ``single_precision`` names columns recorded as
        float32 besides those whose arrays have that type. Columns with a unit (an astropy ``Quantity``) are converted
        to the one in the parameter's name, a ``Time`` in any scale to UTC; a masked entry counts as not recorded.

        Raises
        ------
        InputError
            Epochs not in UTC, a unit that does not convert, a column of another length, a code without a name, a value
            or sigma that is not finite and positive, values or epochs rounded by single precision to steps larger than
            sigma, or weather that no station can have recorded (as when Celsius or
            percent were given). Where the row came from a file it is a :class:`FileFormatError` that names file and
            line.

        Examples
        --------
        >>> import radioloc
        >>> radioloc.Observations.from_columns(
        ...     epoch=radioloc.time.epochs_from_strings(["2024-05-02T06:00:00", "2024-05-02T06:10:00"], "UTC"),
        ...     links=["KASHI>lander>KASHI"],
        ...     kind="range",
        ...     tag="receive",
        ...     value_m=[765432.1e3, 765400.2e3],
        ...     sigma_m=2.5,
        ... )
        <Observations 2 2024-05-02 to 2024-05-02>
        """
        if not isinstance(epoch, Epochs):
            epoch = to_scale(Epochs.from_time(epoch), "UTC")
        epoch.require("UTC")
        n = len(epoch)
        given = [Link.from_path(link) if isinstance(link, str) else link for link in links]
        unique_links, link_codes = each_once(given)
        unique_files, file_codes = each_once(files or (_IN_MEMORY,))
        numbers = {
            "value_m": value_m,
            "sigma_m": sigma_m,
            "pressure_hpa": pressure_hpa,
            "temperature_k": temperature_k,
            "relative_humidity": relative_humidity,
            "wavelength_um": wavelength_um,
            "uplink_hz": uplink_hz,
            "count_s": count_s,
            "modulus_m": modulus_m,
        }
        made = cls(
            epoch=Epochs(
                as_column("epoch.jd", epoch.jd, n), as_column("epoch.fraction", epoch.fraction, n), "UTC"
            ),
            tag=as_codes("tag", codes_of_names("tag", tag, TIME_TAGS), n, len(TIME_TAGS), np.int8),
            kind=as_codes("kind", codes_of_names("kind", kind, KINDS), n, len(KINDS), np.int8),
            link=recoded(link_codes, as_codes("link", link, n, len(links), np.int32)),
            links=unique_links,
            **{name: as_column(name, column, n) for name, column in numbers.items()},
            ramped=as_column("ramped", ramped, n, np.bool_),
            files=unique_files,
            file=recoded(file_codes, as_codes("file", file, n, len(file_codes), np.int32)),
            line=as_column("line", np.arange(1, n + 1) if line is None else line, n, np.int32),
            ramps=Ramps.none() if ramps is None else ramps,
        )
        made._validate()
        narrow = {name for name, column in numbers.items() if is_single_precision(column)}
        made._require_resolution({*single_precision, *narrow})
        return made

    @classmethod
    def from_table(
        cls,
        table: Any,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        *,
        catalogue: StationCatalogue | None = None,
        lunar: bool = True,
        **constants: Any,
    ) -> Observations:
        """Read a table of pandas, Arrow, polars or astropy, or a dictionary of arrays.

        Parameters
        ----------
        table : DataFrame, Table, QTable or mapping of str to array_like
            With the columns that a file of observations has (``docs/reference/observation-table.md``): ``epoch_utc``
            (text, timestamps, or a Time of any scale), ``type``, ``path``, ``observed_m`` or ``light_time_s``,
            ``sigma_m`` or ``sigma_s``, ``time_tag``, and what else was recorded.
        columns : mapping of str to str, optional
            Which columns of the table are those, where they have other names: ``{"observed_m": "rho"}``. Where it is
            given, if only empty, columns that are not known are left out; else they are an error.
        units : mapping of str to str, optional
            Units, as astropy spells them, of columns by their names in the table: ``{"rho": "km"}``. Columns of astropy
            and fields of Arrow may state their own; else the unit is that in the name here.
        catalogue : StationCatalogue, optional
            Gives stations their catalogue names; that of the package where not given.
        lunar : bool
            Whether the target is at the Moon, so that a range of another length is a mistake.
        **constants
            What is the same in all rows and in no column, by the name of the column.

        Raises
        ------
        InputError
            A column is missing, not known, of another unit, or holds what cannot be; the row, counted from 1, is said.

        Warns
        -----
        DataQualityWarning
            The same observation is there twice, and counted once.

        Examples
        --------
        >>> import radioloc
        >>> radioloc.Observations.from_table(
        ...     {"t": ["2024-05-02T06:00:00", "2024-05-02T06:10:00"], "rho": [765432.1, 765400.2]},
        ...     columns={"epoch_utc": "t", "observed_m": "rho"},
        ...     units={"rho": "km"},
        ...     type="range", path="KASHI>lander>KASHI", time_tag="receive", sigma_m=2.5,
        ... )
        <Observations 2 2024-05-02 to 2024-05-02>
        """
        catalogue = StationCatalogue.default() if catalogue is None else catalogue
        return observations_of(columns_of_table(table, columns, units, constants, catalogue=catalogue), lunar)

    @staticmethod
    def concatenate(parts: Sequence[Observations]) -> Observations:
        """Join tables, in order."""
        if not parts:
            raise InputError("no observations to join; give at least one table")
        links, link_codes = each_once([link for part in parts for link in part.links])
        files, file_codes = each_once([file for part in parts for file in part.files])
        columns: dict[str, Any] = {"links": links, "files": files}
        columns["epoch"] = Epochs.concatenate([p.epoch for p in parts])
        columns["ramps"] = Ramps.concatenate([p.ramps for p in parts])
        for name, codes in (("link", link_codes), ("file", file_codes)):
            ends = np.cumsum([len(getattr(p, f"{name}s")) for p in parts])[:-1]
            own = zip(parts, np.split(codes, ends), strict=True)
            columns[name] = np.concatenate([of_part[getattr(p, name)] for p, of_part in own])
        for field in fields(Observations):
            if field.name not in columns:
                columns[field.name] = np.concatenate([getattr(p, field.name) for p in parts])
        return _frozen(Observations(**columns))

    def __len__(self) -> int:
        return len(self.value_m)

    def __repr__(self) -> str:
        if len(self) == 0:
            return "<Observations none>"
        first, last = self.span().day_strings()
        return f"<Observations {len(self)} {first} to {last}>"

    def __getitem__(self, which: Any) -> Observations:
        """Return rows as :meth:`select` does; a single row is a table, too."""
        return self.select(which)

    def span(self) -> Epochs:
        """The first and the last epoch; there is at least one."""
        days = (self.epoch.jd - self.epoch.jd.min()) + self.epoch.fraction
        return self.epoch[[int(days.argmin()), int(days.argmax())]]

    def select(self, which: Any) -> Observations:
        """Rows chosen by a mask, a slice or indices, in that order; ``links``, ``files`` and ``ramps`` stay whole."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in columns.items():
            if name not in _OF_ALL:
                columns[name] = value[which] if isinstance(value, Epochs) else np.atleast_1d(value[which])
        return _frozen(Observations(**columns))

    def types(self) -> NDArray[np.str_]:
        """Kind of each measurement as text, shape (n,)."""
        return np.array(KINDS)[self.kind]

    def tags(self) -> NDArray[np.str_]:
        """Time tag of each measurement as text, shape (n,)."""
        return np.array(TIME_TAGS)[self.tag]

    def paths(self) -> NDArray[np.str_]:
        """Path of each measurement as text, shape (n,)."""
        return np.array([link.path for link in self.links], dtype=np.str_)[self.link]

    def origin(self, row: int) -> str:
        """Where a row came from, such as ``data.np2, line 12``."""
        return f"{self.files[self.file[row]]}, line {self.line[row]}"

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Everything as a table, one column per measured or recorded quantity; :meth:`from_table` gives it back.

        Parameters
        ----------
        form : {"astropy", "pandas"}
            A ``QTable`` with units and ``Time``, or a ``DataFrame`` with dates in UTC to the nanosecond.

        Raises
        ------
        InputError
            Another form, or an epoch in a leap second for pandas, which knows none.

        Examples
        --------
        >>> import radioloc
        >>> ranges = radioloc.read_observations("examples/apollo15/apollo15_apollo_2006-2007.csv")
        >>> ranges[:3].to_table()["value_m"].to("km").round(3)
        <Quantity [794279.926, 794512.76 , 794821.912] km>
        """
        columns: dict[str, Any] = {"epoch_utc": self.epoch, "type": self.types(), "path": self.paths()}
        columns |= {"time_tag": self.tags()} | {name: getattr(self, name) for name in UNITS}
        columns |= {"ramped": self.ramped}
        columns |= {"file": np.array(self.files, dtype=np.str_)[self.file], "line": self.line}
        return as_table(columns, form)

    def summary(self) -> str:
        """Text for people: how many observations, from when to when, by path and kind."""
        if len(self) == 0:
            return "no observations"
        first, last = (str(s) for s in utc_strings(self.span(), decimals=0))
        lines = [f"{len(self)} observations, {first} to {last} UTC, {len(np.unique(self.file))} file(s)"]
        groups, counts = np.unique(self.link * len(KINDS) + self.kind, return_counts=True)
        named = sorted(
            (self.links[group // len(KINDS)].path, KINDS[group % len(KINDS)], int(count))
            for group, count in zip(groups, counts, strict=True)
        )
        width = max(len(path) for path, _, _ in named)
        lines += [f"  {path:<{width}}  {kind}  {count:>7}" for path, kind, count in named]
        if len(self.ramps):
            lines.append(
                f"  {len(self.ramps)} ramp{'s' * (len(self.ramps) > 1)} of {', '.join(self.ramps.stations)}"
            )
        return visible("\n".join(lines))

    def _validate(self) -> None:
        """Hold the observations to what can be true of each quantity and type."""
        self._refuse(~np.isfinite(self.value_m), "value_m", "must be finite")
        least, most = _SIGMA_LIMITS_M
        wrong = ~((self.sigma_m >= least) & (self.sigma_m <= most))
        self._refuse(wrong, "sigma_m", f"must be {least:g} to {most:g}")
        wrong = is_integrated(self.kind) & ~(np.isfinite(self.count_s) & (self.count_s > 0.0))
        self._refuse(wrong, "count_s", "the measurement needs its count interval, above zero")
        for code in np.unique(self.kind):
            kind, rows = MEASUREMENTS[KINDS[code]], self.kind == code
            allowed = [TIME_TAGS.index(tag) for tag in kind.tags]
            where = " at the arrival at the first station" if kind.on_baseline else ""
            rule = f"the {kind.name} is tagged{where} ({' or '.join(kind.tags)})"
            if len(allowed) < len(TIME_TAGS):
                self._refuse(rows & ~np.isin(self.tag, allowed), "time_tag", rule)
            of_link = np.array([link.form != kind.form for link in self.links], dtype=bool)
            rule = f"that of the type {kind.name} is written {kind.form}"
            self._refuse(rows & of_link[self.link], "path", rule)
            if kind.positive:
                wrong = rows & ~(self.value_m > 0.0)
                self._refuse(wrong, "value_m", f"must be above zero: {kind.limit}")
            if kind.largest_m is not None:
                self._refuse(rows & (np.abs(self.value_m) > kind.largest_m), "value_m", kind.limit)
            if kind.fastest_m_s is not None:
                wrong = rows & (np.abs(self.value_m) > kind.fastest_m_s * self.count_s)
                self._refuse(wrong, "value_m", kind.limit)
        wrong = ~np.isnan(self.uplink_hz) & ~((self.uplink_hz > 1e6) & (self.uplink_hz < 1e12))
        self._refuse(wrong, "uplink_hz", "must be 1e6 to 1e12, or left out")
        forms = np.array([link.form for link in self.links], dtype=np.str_)[self.link]
        sent, one_way = forms == "transmitter>target>receiver", forms == "target>receiver"
        reference = np.where(one_way, self.wavelength_um, self.uplink_hz)
        wrong = self.ramped & (np.isnan(reference) | (self.tag != TIME_TAGS.index("receive")))
        rule = "cycles need their reference frequency, uplink_hz or one-way wavelength_um, and time tags of reception"
        self._refuse(wrong, "ramped", rule)
        two_way = np.array([link.transmitter == link.receiver for link in self.links], dtype=bool)[self.link]
        counted = is_integrated(self.kind)
        wrong = self.ramped & ~((sent & (counted | two_way)) | (one_way & counted))
        rule = "cycles are counted in one-way, two-way and three-way Doppler and in two-way ranges"
        self._refuse(wrong, "ramped", rule)
        wrong = ~np.isnan(self.modulus_m) & (~(self.modulus_m > 0.0) | is_integrated(self.kind))
        self._refuse(wrong, "modulus_m", "must be above zero, and of a range, or left out")
        for name, (low, high) in WEATHER_LIMITS.items():
            column = getattr(self, name)
            wrong = ~(np.isnan(column) | ((column >= low) & (column <= high)))
            self._refuse(wrong, name, f"must be {low:g} to {high:g}, or left out where it was not recorded")
        turnaround = 1e6 * C_M_S / (self.wavelength_um * self.uplink_hz)
        low, high = _TURNAROUND_LIMITS
        rule = f"the frequency down is {low:g} to {high:g} times uplink_hz; correct one of them"
        self._refuse((turnaround < low) | (turnaround > high), "wavelength_um", rule)

    def _require_resolution(self, single_precision: set[str]) -> None:
        """Refuse values and epochs that single precision rounds to steps above sigma."""
        steps_m = np.zeros(len(self))
        for name in single_precision & {"value_m", "observed_m", "light_time_s"}:
            steps_m = single_precision_step_m(self.value_m, C_M_S if name == "light_time_s" else 1.0)
        if "modulus_m" in single_precision:  # of which the value is many
            ambiguous_m = np.where(np.isnan(self.modulus_m), 0.0, np.abs(self.value_m))
            steps_m = np.maximum(steps_m, RELATIVE_STEP * ambiguous_m)
        if single_precision & {"uplink_hz", "wavelength_um"} and self.ramped.any():
            counted_m = C_M_S * np.where(is_integrated(self.kind), self.count_s, 0.0)
            steps_m = np.maximum(steps_m, np.where(self.ramped, RELATIVE_STEP * counted_m, 0.0))
        self._refuse_rounded(steps_m > self.sigma_m, steps_m)
        if not len(self):
            return
        group = (self.kind.astype(np.int64) * len(self.links) + self.link) * len(self.files) + self.file
        single = single_precision_groups(self.value_m, self.sigma_m, self.count_s, group)
        self._refuse_rounded(single, single_precision_step_m(self.value_m, 1.0) if single.any() else steps_m)
        step_s = epoch_step_s(self.epoch.fraction)
        coarse = (self.kind == RANGE) & (MIN_RANGE_RATE_M_S * step_s > self.sigma_m)
        rule = (
            f"epochs are Julian dates of one number, in steps of {step_s:.1g} s; give dates, or two numbers"
        )
        self._refuse(coarse, "sigma_m", rule)

    def _refuse_rounded(self, wrong: NDArray[np.bool_], steps_m: Floats) -> None:
        """Refuse values that single precision rounds to steps."""
        step_m = float(steps_m[np.argmax(wrong)]) if wrong.any() else 0.0
        rule = (
            f"single precision (float32) rounds it to a multiple of {step_m:.3g} m, which is more than its sigma; "
            "give double precision, or a sigma for rounded values"
        )
        self._refuse(wrong, "value_m", rule)

    def _refuse(self, wrong: NDArray[np.bool_], name: str, rule: str) -> None:
        if not wrong.any():
            return
        row = int(np.argmax(wrong))
        words = {"path": self.links[self.link[row]].path, "time_tag": TIME_TAGS[self.tag[row]]}
        found = words.get(name) or f"{getattr(self, name)[row]:g}"
        problem = f"{name} is {found}, but {rule}"
        source = self.files[self.file[row]]
        if source == _IN_MEMORY:
            raise InputError(f"observation {row + 1}: {problem}")
        raise FileFormatError(source, problem, int(self.line[row]))


def _frozen(observations: Observations) -> Observations:
    for field in fields(observations):
        value = getattr(observations, field.name)
        for array in (value.jd, value.fraction) if isinstance(value, Epochs) else (value,):
            if isinstance(array, np.ndarray) and array.flags.owndata:
                array.flags.writeable = False
    return observations


def observations_of(columns: Mapping[str, Any], lunar: bool) -> Observations:
    """Observations of the columns of a table, those of a lunar target of lunar length, each once."""
    made = Observations.from_columns(**columns)
    if lunar:
        whole = (made.kind == RANGE) & np.isnan(made.modulus_m)
        require_lunar_flight_times(made.files[0], made.value_m[whole] / C_M_S, made.line[whole])
    return without_duplicates(made)


def without_duplicates(observations: Observations, *, first_counts: bool = False) -> Observations:
    """Return the observations, each once: copies are left out with a warning, two values of one are an error."""
    # Rows are of one observation if path, kind, time tag, wavelength and count interval are the same and their epochs
    # differ by at most 10 microseconds, or by rounding to milliseconds. Copies have the same value and sigma, in two
    # files up to rounding. With `first_counts`, as for frequencies read off twice, a second value is a warning, too.
    instant = _instants_us(observations)
    if not (np.diff(np.sort(instant)) <= _MAX_ROUNDING_US).any():
        return observations
    first, second = _near_pairs(instant)
    apart_us = np.abs(instant[second] - instant[first])
    # Of copies one has the time tag of the other after rounding: only one of the two is a multiple of it.
    ticks = 86400e3 * observations.epoch.fraction * np.array([[1.0], [10.0]])
    whole = np.abs(ticks - np.rint(ticks)) < 1e-5
    rounded = (whole[:, first] != whole[:, second]).any(axis=0) & (apart_us > _EPOCH_TOLERANCE_US)
    files = observations.file[first] != observations.file[second]
    near = (apart_us <= _EPOCH_TOLERANCE_US) | rounded
    near &= ~(apart_us > 0.25e6 * observations.count_s[first])
    value_m, sigma_m, wavelength_um = observations.value_m, observations.sigma_m, observations.wavelength_um
    rounding = np.where(files, _ROUNDING_SIGMAS * sigma_m[first], 0.0)
    same = np.abs(value_m[second] - value_m[first]) <= rounding + np.where(files, _ROUNDING_M, 0.0)
    same &= np.abs(sigma_m[second] - sigma_m[first]) <= rounding
    same_count = _agree(observations.count_s, first, second)
    same_signal = _agree(wavelength_um, first, second) & same_count
    lacking = np.isnan(wavelength_um[first]) != np.isnan(wavelength_um[second])
    copies = near & same & (same_signal | (lacking & same_count))
    by_chance = copies & rounded & ~files
    if len(np.unique(first[by_chance])) < _MIN_ROUNDED_COUNT:
        copies &= ~by_chance
    other = np.flatnonzero(near & ~rounded & same_signal & ~same)
    if len(other) and not first_counts:
        pair = other[np.argmin(second[other])]
        raise InputError(
            f"{observations.origin(int(second[pair]))}: this observation has another value or sigma in "
            f"{observations.origin(int(first[pair]))} ({len(other)} such pair(s) in all); leave one of them out"
        )
    copies[other] = True
    second, which = np.unique(second[copies], return_index=True)
    first, apart_us = first[copies][which], apart_us[copies][which]
    shifted = f", but for the rounding of its time by {apart_us.max()} us" if apart_us.any() else ""
    with_other = f", {len(other)} with another value or sigma" if len(other) else ""
    return counted_once(
        observations, first, second, f"this observation is already there{shifted}", with_other
    )


def _instants_us(observations: Observations) -> NDArray[np.int64]:
    """Epochs in whole microseconds, those of each path, kind and time tag far from those of the next."""
    epoch = observations.epoch
    days = (epoch.jd - epoch.jd.min(initial=np.inf)) + epoch.fraction
    since_us = np.rint(86400e6 * days).astype(np.int64)
    series = (observations.link.astype(np.int64) * len(KINDS) + observations.kind) * len(TIME_TAGS)
    number = np.cumsum(np.bincount(series + observations.tag) > 0)[series + observations.tag]
    return np.asarray(since_us + number * (since_us.max(initial=0) + 2 * _MAX_ROUNDING_US))


def _near_pairs(instant_us: NDArray[np.int64]) -> NDArray[np.intp]:
    """Pairs of rows that rounding of their epochs may separate, the earlier row first, shape (2, m)."""
    order = np.argsort(instant_us, kind="stable")
    in_order, pairs = instant_us[order], []
    for lag in range(1, min(len(order), _MAX_SIGNALS + 1)):
        near = np.flatnonzero(in_order[lag:] - in_order[:-lag] <= _MAX_ROUNDING_US)
        if not len(near):
            break
        pairs.append(np.sort([order[near], order[near + lag]], axis=0))
    return np.concatenate(pairs, axis=1)


def _agree(column: Floats, first: NDArray[np.intp], second: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether a quantity is the same in both rows to a millionth, or recorded in neither."""
    one, two = column[first], column[second]
    return np.asarray((np.abs(one - two) <= 1e-6 * np.abs(one)) | (np.isnan(one) & np.isnan(two)))


def counted_once(
    observations: Observations,
    first: NDArray[np.intp],
    second: NDArray[np.intp],
    problem: str,
    more: str = "",
) -> Observations:
    """Observations without the second of each pair of rows, with a warning that says the problem and the first."""
    if not len(first):
        return observations
    pair = int(np.argmin(second))
    here, there = (observations.origin(int(rows[pair])) for rows in (second, first))
    warnings.warn(
        f"{here}: {problem}, in {there} ({len(first)} such pair(s) in all{more}); it is counted once",
        DataQualityWarning,
        stacklevel=5,
    )
    kept = np.ones(len(observations), dtype=bool)
    kept[second] = False
    return observations.select(kept)
