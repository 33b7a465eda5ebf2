"""Table of observations, with a row per measurement and an array per column.

Values are metres. A range is the round-trip length of the light path from the transmitter over the target to the
receiver: the speed of light times the time of flight by the station's clock (rate of UTC). The epoch is the UTC of the
event of the time tag. Rows are not Python objects, so that tables can have millions of rows.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import C_M_S
from radioloc.earth.stations import StationCatalogue
from radioloc.errors import DataQualityWarning, FileFormatError, InputError, visible
from radioloc.measurements.link import Link
from radioloc.measurements.ramps import Ramps
from radioloc.measurements.registry import KINDS, MEASUREMENTS, TIME_TAGS, is_integrated, kind_of
from radioloc.measurements.table_columns import (
    FILE_COLUMNS,
    MIN_RANGE_RATE_M_S,
    RELATIVE_STEP,
    UNITS,
    as_codes,
    as_column,
    codes_of_names,
    columns_of_table,
    epoch_step_s,
    is_single_precision,
    recoded,
    require_lunar_flight_times,
    single_precision_step_m,
    unique_items,
)
from radioloc.quantities import TableForm, as_table
from radioloc.time import Epochs, to_scale, utc_strings
from radioloc.units import set_fields
from radioloc.vectors import Floats, Indices, Mask

RANGE, VLBI_DELAY, DOPPLER, VLBI_DELAY_RATE = (
    kind_of(name) for name in ("range", "vlbi_delay", "doppler", "vlbi_delay_rate")
)

WEATHER_LIMITS = {
    "pressure_hpa": (100.0, 1100.0),
    "temperature_k": (150.0, 350.0),
    "relative_humidity": (0.0, 1.0),
    "wavelength_um": (0.1, 1e9),
}
"""Lowest and highest value of a station on Earth; other values are in Celsius, percent or Pascal."""

_SIGMA_LIMITS_M = (1e-9, 1e12)
_TURNAROUND_LIMITS = (0.05, 20.0)
"""The ratio of Ka band up and S band down is 0.067, the reverse 15; others have wavelengths in mm, or of light."""
_MAX_ROUNDING_US = 1000  # largest difference of time tags of copies, a millisecond, as by rounding
_EPOCH_TOLERANCE_US = 10  # of the time tags of copies; repeated measurements are farther apart
_MAX_SIGNAL_COUNT = 16  # observations of a path, kind and epoch with different wavelengths
_MIN_ROUNDED_COUNT = 5  # of rounded copies in a file; fewer may be repeated values of a dense series
_ROUNDING_SIGMAS, _ROUNDING_M = 0.02, 2e-4
"""Terms of the largest difference of copies in two files: light times have 1 ps, ranges a fraction of sigma."""
_MIN_LONG_COLUMN = 2**16  # values, above which a column of one value takes no memory for each row
_SHARED_FIELDS = ("links", "files", "ramps")
_IN_MEMORY = "in memory"


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Observations in their original order; arrays are read-only.

    :meth:`from_columns` and :meth:`from_table` check their input; the constructor does not.
    """

    epoch: Epochs  #: UTC of the events of the time tags, n epochs
    tag: NDArray[np.int8]  #: (n,), index into :data:`TIME_TAGS`
    kind: NDArray[np.int8]  #: (n,), index into :data:`KINDS`
    link: NDArray[np.int32]  #: (n,), index into ``links``
    links: tuple[Link, ...]  #: different paths
    #: (n,), measured values, m: of ranges the speed of light times the round-trip time of flight; of other kinds
    #: as described in :data:`MEASUREMENTS`.
    value_m: Floats
    sigma_m: Floats  #: (n,), standard deviations, m
    pressure_hpa: Floats  #: (n,), weather at the receiving station; humidity from 0 to 1; NaN if not recorded
    temperature_k: Floats  #: likewise
    relative_humidity: Floats  #: likewise
    #: (n,), vacuum wavelength of light or of the radio downlink, micrometres; NaN if not recorded.
    wavelength_um: Floats
    uplink_hz: Floats  #: (n,), frequency of the radio uplink, Hz; NaN if not recorded
    count_s: Floats  #: (n,), count interval of Doppler and of a delay rate, s; NaN for other kinds
    modulus_m: Floats  #: (n,), modulus of ambiguous ranges, m of light path; NaN for unambiguous values
    #: (n,), whether values count cycles of a variable transmitted frequency (``ramps``), in metres by the
    #: reference frequency ``uplink_hz``, or one-way that of ``wavelength_um``
    #: (:mod:`~radioloc.measurements.ramps`).
    ramped: Mask
    files: tuple[str, ...]  #: different files of origin
    file: NDArray[np.int32]  #: (n,), index into ``files``
    line: NDArray[np.int32]  #: (n,), line in the file, counted from 1
    ramps: Ramps  #: transmitted frequencies of stations and, one-way, of targets

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
        """Check and copy columns; a single value applies to all rows.

        Parameters are those of the class. ``kind`` and ``tag`` are names (``"doppler"``, ``"receive"``) or indices,
        ``links`` are links or paths such as ``"KASHI>lander>KASHI"``. Without ``files`` the origin is memory, and
        ``line`` is the row counted from 1. ``single_precision`` names columns recorded as float32, beside arrays of
        that type. An astropy ``Quantity`` is converted to the unit in the parameter's name, a ``Time`` of any scale to
        UTC; masked entries count as not recorded.

        Raises
        ------
        InputError
            Epochs are not UTC, a unit cannot be converted, lengths differ, a name or index is unknown, a value or sigma
            is not finite and positive, values or epochs have rounding steps above sigma, or weather is impossible (as
            in Celsius or percent). For rows of a file it is a :class:`FileFormatError` with file and line.

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
        parsed = [Link.from_path(link) if isinstance(link, str) else link for link in links]
        unique_links, link_codes = unique_items(parsed)
        unique_files, file_codes = unique_items(files or (_IN_MEMORY,))
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
        table = cls(
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
            ramps=Ramps.empty() if ramps is None else ramps,
        )
        table._validate()
        narrow = {name for name, column in numbers.items() if is_single_precision(column)}
        table._require_resolution({*single_precision, *narrow})
        return _frozen(table)

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
        """Read a table of pandas, Arrow, polars or astropy, a dictionary of arrays, or a file with columns of its own.

        Parameters
        ----------
        table : DataFrame, Table, QTable, mapping of str to array_like, or path-like
            Columns of a file of observations (``docs/reference/observation-table.md``): ``epoch_utc`` (text,
            timestamps, or a Time of any scale), ``type``, ``path``, ``observed_m`` or ``light_time_s``, ``sigma_m`` or
            ``sigma_s``, ``time_tag``, and optional ones.
        columns : mapping of str to str, optional
            Names of columns in the table by their names here: ``{"observed_m": "rho"}``. With it, even empty, unknown
            columns are ignored; without it they are an error.
        units : mapping of str to str, optional
            Units in the notation of astropy by names in the table: ``{"rho": "km"}``; by default the unit of the column
            (astropy, Arrow) or that in the name here.
        catalogue : StationCatalogue, optional
            Catalogue of station names; by default that of the package.
        lunar : bool
            Whether targets are at the Moon, so that ranges of another length are an error.
        **constants
            Values of all rows by the name of the missing column; texts may name columns of the table:
            ``path="{station}>lander>{station}"``.

        Raises
        ------
        InputError
            A column is missing, unknown or of another unit, or has an invalid value; the message has the row, or the
            line of a file, from 1.

        Warns
        -----
        DataQualityWarning
            Duplicate observations are removed.

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
        return observations_from_columns(
            columns_of_table(table, columns, units, constants, catalogue=catalogue), lunar
        )

    @staticmethod
    def concatenate(parts: Sequence[Observations]) -> Observations:
        """Join tables, in order."""
        if not parts:
            raise InputError("parts: expected one or more tables of observations, got none")
        links, link_codes = unique_items([link for part in parts for link in part.links])
        files, file_codes = unique_items([file for part in parts for file in part.files])
        columns: dict[str, Any] = {"links": links, "files": files}
        columns["epoch"] = Epochs.concatenate([p.epoch for p in parts])
        columns["ramps"] = Ramps.concatenate([p.ramps for p in parts])
        for name, codes in (("link", link_codes), ("file", file_codes)):
            ends = np.cumsum([len(getattr(p, f"{name}s")) for p in parts])[:-1]
            by_part = zip(parts, np.split(codes, ends), strict=True)
            columns[name] = np.concatenate([part_codes[getattr(p, name)] for p, part_codes in by_part])
        for field in fields(Observations):
            if field.name not in columns:
                columns[field.name] = np.concatenate([getattr(p, field.name) for p in parts])
        return _frozen(Observations(**columns))

    def __len__(self) -> int:
        return len(self.value_m)

    def __repr__(self) -> str:
        if len(self) == 0:
            return "<Observations 0>"
        first, last = self.span().day_strings()
        return f"<Observations {len(self)} {first} to {last}>"

    def __getitem__(self, rows: Any) -> Observations:
        """Return rows as :meth:`select` does; a single row is a table, too."""
        return self.select(rows)

    def span(self) -> Epochs:
        """Return the first and the last epoch of a table with rows."""
        days = (self.epoch.jd - self.epoch.jd.min()) + self.epoch.fraction
        return self.epoch[[int(days.argmin()), int(days.argmax())]]

    def select(self, rows: Any) -> Observations:
        """Return rows by a mask, a slice or indices, in order; ``links``, ``files`` and ``ramps`` are unchanged."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in columns.items():
            if name not in _SHARED_FIELDS:
                columns[name] = value[rows] if isinstance(value, Epochs) else np.atleast_1d(value[rows])
        return _frozen(Observations(**columns))

    def parts(self, rows_at_once: int) -> Iterator[Observations]:
        """Yield successive parts of some number of rows."""
        for start in range(0, len(self), rows_at_once):
            yield self.select(slice(start, start + rows_at_once))

    def types(self) -> NDArray[np.str_]:
        """Return the name of the type of each measurement, shape (n,)."""
        return np.array(KINDS)[self.kind]

    def tags(self) -> NDArray[np.str_]:
        """Return the name of each time tag, shape (n,)."""
        return np.array(TIME_TAGS)[self.tag]

    def paths(self) -> NDArray[np.str_]:
        """Return the path of each measurement as text, shape (n,)."""
        return np.array([link.path for link in self.links], dtype=np.str_)[self.link]

    def origin(self, row: int) -> str:
        """Return the origin of a row, such as ``data.np2, line 12``."""
        return f"{self.files[self.file[row]]}, line {self.line[row]}"

    def to_table(self, form: TableForm = "astropy") -> Any:
        """Return a table with a column per quantity, which :meth:`from_table` can read.

        Parameters
        ----------
        form : {"astropy", "pandas"}
            A ``QTable`` with units and ``Time``, or a ``DataFrame`` with dates in UTC to the nanosecond.

        Raises
        ------
        InputError
            The form is unknown, or an epoch is in a leap second, which pandas does not support.

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
        """Return the number of observations, their span, and their numbers by path and kind as text."""
        if len(self) == 0:
            return "no observations"
        first, last = (str(s) for s in utc_strings(self.span(), decimals=0))
        lines = [f"{len(self)} observations, {first} to {last} UTC, {len(np.unique(self.file))} file(s)"]
        groups, counts = np.unique(self.link * len(KINDS) + self.kind, return_counts=True)
        group_rows = sorted(
            (self.links[group // len(KINDS)].path, KINDS[group % len(KINDS)], int(count))
            for group, count in zip(groups, counts, strict=True)
        )
        width = max(len(path) for path, _, _ in group_rows)
        lines += [f"  {path:<{width}}  {kind}  {count:>7}" for path, kind, count in group_rows]
        if len(self.ramps):
            lines.append(
                f"  {len(self.ramps)} ramp{'s' * (len(self.ramps) > 1)} of {', '.join(self.ramps.stations)}"
            )
        return visible("\n".join(lines))

    def _validate(self) -> None:
        """Raise an error for values that are impossible for their quantity or type."""
        self._refuse(~np.isfinite(self.value_m), "value_m", "a finite number")
        low, high = _SIGMA_LIMITS_M
        wrong = ~((self.sigma_m >= low) & (self.sigma_m <= high))
        self._refuse(wrong, "sigma_m", f"{low:g} to {high:g}")
        wrong = is_integrated(self.kind) & ~(np.isfinite(self.count_s) & (self.count_s > 0.0))
        self._refuse(wrong, "count_s", "a count interval above zero")
        for code in np.unique(self.kind):
            kind, rows = MEASUREMENTS[KINDS[code]], self.kind == code
            allowed = [TIME_TAGS.index(tag) for tag in kind.tags]
            rule = f"{' or '.join(kind.tags)} for {kind.name}"
            if len(allowed) < len(TIME_TAGS):
                self._refuse(rows & ~np.isin(self.tag, allowed), "time_tag", rule)
            of_link = np.array([link.form != kind.form for link in self.links], dtype=bool)
            rule = f"{kind.form} for {kind.name}"
            self._refuse(rows & of_link[self.link], "path", rule)
            if kind.positive:
                wrong = rows & ~(self.value_m > 0.0)
                self._refuse(wrong, "value_m", f"a number above zero ({kind.limit})")
            if kind.largest_m is not None:
                self._refuse(rows & (np.abs(self.value_m) > kind.largest_m), "value_m", kind.limit)
            if kind.fastest_m_s is not None:
                wrong = rows & (np.abs(self.value_m) > kind.fastest_m_s * self.count_s)
                self._refuse(wrong, "value_m", kind.limit)
        wrong = ~np.isnan(self.uplink_hz) & ~((self.uplink_hz > 1e6) & (self.uplink_hz < 1e12))
        self._refuse(wrong, "uplink_hz", "1e6 to 1e12")
        forms = np.array([link.form for link in self.links], dtype=np.str_)
        sent, one_way = (
            (forms == form)[self.link] for form in ("transmitter>target>receiver", "target>receiver")
        )
        reference = np.where(one_way, self.wavelength_um, self.uplink_hz)
        wrong = self.ramped & (np.isnan(reference) | (self.tag != TIME_TAGS.index("receive")))
        rule = "a reference frequency (uplink_hz, one-way wavelength_um) and time tags of reception"
        self._refuse(wrong, "ramped", rule)
        two_way = np.array([link.transmitter == link.receiver for link in self.links], dtype=bool)[self.link]
        counted = is_integrated(self.kind)
        wrong = self.ramped & ~((sent & (counted | two_way)) | (one_way & counted))
        rule = "one-way, two-way or three-way Doppler, or two-way ranges"
        self._refuse(wrong, "ramped", rule)
        wrong = ~np.isnan(self.modulus_m) & (~(self.modulus_m > 0.0) | is_integrated(self.kind))
        self._refuse(wrong, "modulus_m", "a number above zero, for ranges only")
        for name, (low, high) in WEATHER_LIMITS.items():
            column = getattr(self, name)
            wrong = ~(np.isnan(column) | ((column >= low) & (column <= high)))
            self._refuse(wrong, name, f"{low:g} to {high:g}")
        turnaround = 1e6 * C_M_S / (self.wavelength_um * self.uplink_hz)
        low, high = _TURNAROUND_LIMITS
        rule = f"a downlink frequency of {low:g} to {high:g} times uplink_hz"
        self._refuse((turnaround < low) | (turnaround > high), "wavelength_um", rule)

    def _require_resolution(self, single_precision: set[str]) -> None:
        """Raise an error for values and epochs with rounding steps above sigma."""
        steps_m = np.zeros(len(self))
        for name in single_precision & {"value_m", "observed_m", "light_time_s"}:
            steps_m = single_precision_step_m(self.value_m, C_M_S if name == "light_time_s" else 1.0)
        if "modulus_m" in single_precision:
            ambiguous_m = np.where(np.isnan(self.modulus_m), 0.0, np.abs(self.value_m))
            steps_m = np.maximum(steps_m, RELATIVE_STEP * ambiguous_m)
        if single_precision & {"uplink_hz", "wavelength_um"} and self.ramped.any():
            counted_m = C_M_S * np.where(is_integrated(self.kind), self.count_s, 0.0)
            steps_m = np.maximum(steps_m, np.where(self.ramped, RELATIVE_STEP * counted_m, 0.0))
        wrong = steps_m > self.sigma_m
        step_m = float(steps_m[np.argmax(wrong)]) if wrong.any() else 0.0
        self._refuse(
            wrong, "value_m", f"double precision, as steps of float32 are {step_m:.3g} m, above sigma"
        )
        step_s = epoch_step_s(self.epoch.fraction) if len(self) else 0.0
        wrong = (self.kind == RANGE) & (MIN_RANGE_RATE_M_S * step_s > self.sigma_m)
        rule = (
            f"at least the effect of epochs that are Julian dates of one number, in steps of {step_s:.1g} s"
        )
        self._refuse(wrong, "sigma_m", rule)

    def _refuse(self, wrong: Mask, name: str, expected: str) -> None:
        if not wrong.any():
            return
        row = int(np.argmax(wrong))
        words = {"path": self.links[self.link[row]].path, "time_tag": TIME_TAGS[self.tag[row]]}
        value = words.get(name) or f"{getattr(self, name)[row]:g}"
        problem = f"expected {expected}, got {value}"
        source = self.files[self.file[row]]
        if source == _IN_MEMORY:
            raise InputError(f"observation {row + 1}: {name}: {problem}")
        raise FileFormatError(source, f"{FILE_COLUMNS.get(name, name)}: {problem}", int(self.line[row]))


def _frozen(observations: Observations) -> Observations:
    """Return the observations with read-only columns; a long column of one value is a view of that value."""
    for field in fields(observations):
        value = getattr(observations, field.name)
        for array in (value.jd, value.fraction) if isinstance(value, Epochs) else (value,):
            if isinstance(array, np.ndarray) and array.flags.owndata:
                array.flags.writeable = False
        if isinstance(value, np.ndarray) and len(value) > _MIN_LONG_COLUMN:
            pairs = (value[:1], value[-1:]), (value[1:], value[:-1])
            if all(np.array_equal(*pair, equal_nan=True) for pair in pairs):
                set_fields(observations, **{field.name: np.broadcast_to(value[0], len(value))})
    return observations


def observations_from_columns(columns: Mapping[str, Any], lunar: bool) -> Observations:
    """Return the observations of the columns of a table without duplicates; ranges of lunar targets are checked."""
    observations = Observations.from_columns(**columns)
    if lunar:
        rows = (observations.kind == RANGE) & np.isnan(observations.modulus_m)
        flight_s = observations.value_m[rows] / C_M_S
        require_lunar_flight_times(observations.files[0], flight_s, observations.line[rows])
    return without_duplicates(observations)


def without_duplicates(observations: Observations, *, first_counts: bool = False) -> Observations:
    """Return the observations without copies, which are a warning; copies with another value are an error."""
    # Rows are copies if path, kind, time tag, wavelength and count interval are equal and their epochs differ by at
    # most 10 microseconds, or by a millisecond of rounded time tags or of equal values. Copies have the same value and
    # sigma, in two files up to rounding. With `first_counts`, as for frequencies read off repeatedly, another value is
    # a warning, too.
    instant = _instants_us(observations)
    if not (np.diff(np.sort(instant)) <= _MAX_ROUNDING_US).any():
        return observations
    first, second = _nearly_equal_pairs(instant)
    difference_us = np.abs(instant[second] - instant[first])
    # The time tag of one of two rounded copies is a multiple of a millisecond, that of the other is not.
    ticks = 86400e3 * observations.epoch.fraction * np.array([[1.0], [10.0]])
    is_multiple = np.abs(ticks - np.rint(ticks)) < 1e-5
    files = observations.file[first] != observations.file[second]
    value_m, sigma_m, wavelength_um = observations.value_m, observations.sigma_m, observations.wavelength_um
    # Of values that occur twice, both are one measurement, as another one has other digits.
    is_repeated = value_m[first] == value_m[second]
    repeated_m = value_m[np.isin(value_m, value_m[first[is_repeated]])]
    values_m, value_counts = np.unique(repeated_m, return_counts=True)
    is_repeated &= np.isin(value_m[first], values_m[value_counts == 2])
    rounded = (is_multiple[:, first] != is_multiple[:, second]).any(axis=0) | is_repeated
    rounded &= difference_us > _EPOCH_TOLERANCE_US
    simultaneous = (difference_us <= _EPOCH_TOLERANCE_US) | rounded
    simultaneous &= ~(difference_us > 0.25e6 * observations.count_s[first])
    rounding = np.where(files, _ROUNDING_SIGMAS * sigma_m[first], 0.0)
    equal = np.abs(value_m[second] - value_m[first]) <= rounding + np.where(files, _ROUNDING_M, 0.0)
    equal &= np.abs(sigma_m[second] - sigma_m[first]) <= rounding
    same_count = _agree(observations.count_s, first, second)
    same_signal = _agree(wavelength_um, first, second) & same_count
    lacking = np.isnan(wavelength_um[first]) != np.isnan(wavelength_um[second])
    copies = simultaneous & equal & (same_signal | (lacking & same_count))
    by_chance = copies & rounded & ~files
    if len(np.unique(first[by_chance])) < _MIN_ROUNDED_COUNT:
        copies &= ~by_chance
    conflicting = np.flatnonzero(simultaneous & ~rounded & same_signal & ~equal)
    if len(conflicting) and not first_counts:
        pair = conflicting[np.argmin(second[conflicting])]
        raise InputError(
            f"{observations.origin(int(second[pair]))}: this observation has another value or sigma in "
            f"{observations.origin(int(first[pair]))} ({len(conflicting)} such pairs); remove one of them"
        )
    copies[conflicting] = True
    second, index = np.unique(second[copies], return_index=True)
    first, difference_us = first[copies][index], difference_us[copies][index]
    rounding_text = f" (time tags up to {difference_us.max()} us apart)" if difference_us.any() else ""
    conflicts = f", {len(conflicting)} with another value or sigma" if len(conflicting) else ""
    return without_second(observations, first, second, f"duplicate observation{rounding_text}", conflicts)


def _instants_us(observations: Observations) -> NDArray[np.int64]:
    """Return epochs in integer microseconds, with different offsets for each path, kind and time tag."""
    epoch = observations.epoch
    days = (epoch.jd - epoch.jd.min(initial=np.inf)) + epoch.fraction
    since_us = np.rint(86400e6 * days).astype(np.int64)
    series = (observations.link.astype(np.int64) * len(KINDS) + observations.kind) * len(TIME_TAGS)
    number = np.cumsum(np.bincount(series + observations.tag) > 0)[series + observations.tag]
    return np.asarray(since_us + number * (since_us.max(initial=0) + 2 * _MAX_ROUNDING_US))


def _nearly_equal_pairs(instant_us: NDArray[np.int64]) -> Indices:
    """Return pairs of rows with epochs that differ at most by rounding, the earlier row first, shape (2, m)."""
    order = np.argsort(instant_us, kind="stable")
    in_order, pairs = instant_us[order], []
    for lag in range(1, min(len(order), _MAX_SIGNAL_COUNT + 1)):
        places = np.flatnonzero(in_order[lag:] - in_order[:-lag] <= _MAX_ROUNDING_US)
        if not len(places):
            break
        pairs.append(np.sort([order[places], order[places + lag]], axis=0))
    return np.concatenate(pairs, axis=1)


def _agree(column: Floats, first: Indices, second: Indices) -> Mask:
    """Return whether a quantity is equal in both rows to a millionth, or recorded in neither."""
    a, b = column[first], column[second]
    return np.asarray((np.abs(a - b) <= 1e-6 * np.abs(a)) | (np.isnan(a) & np.isnan(b)))


def without_second(
    observations: Observations, first: Indices, second: Indices, problem: str, details: str = ""
) -> Observations:
    """Return the observations without the second row of each pair, with a warning."""
    if not len(first):
        return observations
    pair = int(np.argmin(second))
    origins = [observations.origin(int(rows[pair])) for rows in (second, first)]
    warnings.warn(
        f"{origins[0]}: {problem}, as in {origins[1]}; ignored ({len(first)} such pairs{details})",
        DataQualityWarning,
        stacklevel=5,
    )
    is_first = np.ones(len(observations), dtype=bool)
    is_first[second] = False
    return observations.select(is_first)
