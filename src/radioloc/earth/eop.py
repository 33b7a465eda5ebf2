"""Daily Earth orientation: the table, and its values between days.

Polar motion, UT1 and celestial pole offsets at 0h UTC of each day come from the IERS 20 C04 series, and after
its end from Bulletin A, first its measured values and then its predictions. Both refer to the IAU 2006/2000A
precession-nutation: finals2000A names IAU 2000A alone, but its dX, dY differ from C04 by less than 0.03 mas
in the mean of 2023 to 2026, when a change of precession model would show as 0.14 mas.

Between days each quantity follows the cubic through the four nearest (Lagrange), as the IERS recommend. UT1
is interpolated as UT1-TAI, so that leap seconds leave no step, and without zonal tides, as a cubic through
daily values cannot follow their fortnightly and shorter terms. All 62 zonal terms are removed, including those above
35 days, which are smooth to 0.2 ns: one table is simpler than two.

Two layouts of fixed columns are recognised by their rows: the IERS 20 C04 series (one row per 0h UTC, all
measured), and Bulletin A's finals2000A (measured values, then a year of predictions, then rows with a date alone). Of
finals2000A the Bulletin A columns are used, not the monthly Bulletin B beside them.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import astropy_iers_data
import numpy as np
from numpy.typing import NDArray

from radioloc.constants import ARCSEC_RAD, MJD_ZERO_JD, SECONDS_PER_DAY, TT_MINUS_TAI_S
from radioloc.earth.eop_tides import zonal_tides
from radioloc.errors import CoverageError, FileFormatError, InputError, in_file
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.text_files import read_blocks
from radioloc.time import Epochs, utc_to_tt
from radioloc.units import in_unit, set_fields
from radioloc.vectors import Floats, Indices, Mask

_MJD_1972 = 41317.0
_BEYOND = 'or, for planning, set [model] eop_beyond = "hold" or "extrapolate" (with --at: --eop-beyond)'
_MAX_DAILY_CHANGE_S = 0.1
"""UT1-TAI changes by a few ms a day; a whole second means a leap second that one of the sources lacks."""
_MAX_POLE_OFFSET_ARCSEC = 0.03
"""IAU 2000A offsets stay below 9 mas in all published rows; those of the 1980 theory reach 120 mas."""


@dataclass(frozen=True, slots=True, eq=False)
class EopValues:
    """Earth orientation of a table at n epochs, without subdaily terms; dX, dY are offsets from IAU 2006/2000A."""

    ut1_minus_tt_s: Floats
    xp_rad: Floats
    yp_rad: Floats
    dx_rad: Floats
    dy_rad: Floats
    ut1_minus_tt_rate: Floats  # s/s
    xp_rate_rad_s: Floats
    yp_rate_rad_s: Floats
    dx_rate_rad_s: Floats
    dy_rate_rad_s: Floats
    predicted: Mask  # whether any of the daily values used is a prediction


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EopTable:
    """Earth orientation at 0h UTC of successive days, at least four, from 1972-01-01 on.

    Raises
    ------
    InputError
        The columns differ in length, dates do not rise, or UT1 - UTC contradicts the leap seconds.
    """

    mjd_utc: Floats  #: rising
    xp_rad: Floats  #: pole
    yp_rad: Floats
    ut1_minus_utc_s: Floats  #: with its leap steps
    dx_rad: Floats  #: celestial pole offsets from IAU 2006/2000A; NaN where not given
    dy_rad: Floats
    predicted: Mask  #: whether any value of the day is a prediction
    sources: tuple[str, ...] = ()  #: where the values come from, for the record of a result
    beyond: tuple[str, float] | None = None  #: how days after one (MJD UTC) were added (eop_prediction)
    _nodes_tt: Epochs = field(init=False)
    _values: Floats = field(init=False)

    def __post_init__(self) -> None:
        names = ("mjd_utc", "xp_rad", "yp_rad", "ut1_minus_utc_s", "dx_rad", "dy_rad", "predicted")
        for name in names:
            unit = "rad" if name.endswith("_rad") else "s" if name.endswith("_s") else "d"
            column = np.array(
                in_unit(getattr(self, name), unit, name),
                dtype=np.bool_ if name == "predicted" else np.float64,
            )
            if column.ndim != 1 or len(column) < 4 or len(column) != len(self.mjd_utc):
                raise InputError(
                    f"EOP column {name} has shape {column.shape}; all need one length, at least 4"
                )
            if not name.startswith("d") and not np.isfinite(column).all():
                raise InputError(f"EOP column {name} holds a value that is not a finite number")
            column.setflags(write=False)
            set_fields(self, **{name: column})
        if (np.diff(self.mjd_utc) <= 0.0).any():
            raise InputError("the dates of EOP must rise from row to row")
        nodes = utc_to_tt(Epochs.from_jd(self.mjd_utc + MJD_ZERO_JD, 0.0, "UTC"))
        tt_minus_utc_s = ((nodes.jd - MJD_ZERO_JD - self.mjd_utc) + nodes.fraction) * SECONDS_PER_DAY
        # TAI-UTC is a whole number since 1972; rounding removes the error of the fraction of a day.
        tai_minus_utc_s = np.round(tt_minus_utc_s - TT_MINUS_TAI_S)
        ut1_minus_tt_s = self.ut1_minus_utc_s - tai_minus_utc_s - TT_MINUS_TAI_S
        jumps = np.abs(np.diff(ut1_minus_tt_s)) > _MAX_DAILY_CHANGE_S * np.diff(self.mjd_utc)
        if jumps.any():
            k = int(np.argmax(jumps))
            jump_s = float(ut1_minus_tt_s[k + 1] - ut1_minus_tt_s[k])
            leap = round(jump_s) != 0 and abs(jump_s - round(jump_s)) < _MAX_DAILY_CHANGE_S
            cause = (
                "UT1-UTC and the list of leap seconds disagree; update astropy-iers-data"
                if leap
                else "UT1-UTC of that day or the day before is wrong; correct the row, or fetch the file again"
            )
            raise InputError(f"UT1-TAI jumps by {jump_s:.3f} s at {day_of(self.mjd_utc[k + 1])}: {cause}")
        set_fields(self, _nodes_tt=nodes)
        values = np.column_stack([ut1_minus_tt_s, self.xp_rad, self.yp_rad, self.dx_rad, self.dy_rad])
        set_fields(self, _values=values)

    def __repr__(self) -> str:
        return f"<EopTable {self.first_date} to {self.last_date}, measured to {self.last_measured_date}>"

    @classmethod
    @cache
    def packaged(cls) -> EopTable:
        """Return C04 continued by Bulletin A, of the installed ``astropy-iers-data``; read once in a process."""
        package = f" of astropy-iers-data {version('astropy-iers-data')}"
        c04, measured = read_eop_rows(astropy_iers_data.IERS_B_FILE, _MJD_1972, package)
        start_mjd = float(c04["mjd_utc"][-1]) + 1.0
        bulletin_a, predicted = read_eop_rows(astropy_iers_data.IERS_A_FILE, start_mjd, package)
        columns: dict[str, Any] = {name: np.concatenate([c04[name], bulletin_a[name]]) for name in c04}
        return cls(**columns, sources=(*measured, *predicted))

    @classmethod
    def from_file(cls, path: str | Path) -> EopTable:
        """Read a C04 or finals2000A file without its part before 1972."""
        columns, sources = read_eop_rows(path, _MJD_1972)
        with in_file(path):
            table = cls(**columns, sources=sources)
        return table

    @property
    def first_date(self) -> str:
        """First day, UTC."""
        return day_of(self.mjd_utc[0])

    @property
    def last_date(self) -> str:
        """Last day, measured or predicted, UTC."""
        return day_of(self.mjd_utc[-1])

    @property
    def last_measured_date(self) -> str | None:
        """Last day with measured values only, UTC; None if the table has no such day."""
        measured = np.flatnonzero(~self.predicted)
        return day_of(self.mjd_utc[measured[-1]]) if len(measured) else None

    @property
    def at_0h_utc(self) -> tuple[Floats, Epochs]:
        """UT1 - TT (s), xp, yp, dX, dY (rad) of the days, shape (n, 5), and the days in TT."""
        return self._values, self._nodes_tt

    @accepts_quantities
    def interpolate(self, tt: EpochsLike, *, zonal: bool = True) -> EopValues:
        """Interpolate at epochs of TT within the table.

        Without `zonal` UT1 is interpolated with its zonal tides, with errors of up to 2.6 us (1.2 mm) in the middle
        between days. Near the table's ends the cubic through the outermost four days applies. The interpolant is
        continuous; its rate steps at 0h UTC, by some 7e-11 s/s in UT1 (0.03 um/s on the ground).
        """
        tt.require("TT")
        self._require_covered(tt)
        first = np.clip(
            np.searchsorted(self._nodes_tt.mjd, tt.mjd, side="right") - 2, 0, len(self.mjd_utc) - 4
        )
        stencil = first[:, None] + np.arange(4)
        node_values = self._values[stencil]
        _refuse(
            tt[~np.isfinite(node_values).all(axis=(1, 2))],
            "the table of celestial pole offsets dX, dY",
            self.mjd_utc[np.isfinite(self._values).all(axis=1)],
            f"two days are needed on each side: update astropy-iers-data, {_BEYOND}",
        )
        if zonal:
            days, inverse = np.unique(stencil, return_inverse=True)
            tide_at_days, _ = zonal_tides(self._nodes_tt[days].centuries_since_j2000())
            node_values[..., 0] -= tide_at_days[inverse.reshape(stencil.shape)]
        to_nodes_d = (self._nodes_tt.jd[stencil] - tt.jd[:, None]) + (
            self._nodes_tt.fraction[stencil] - tt.fraction[:, None]
        )
        value, rate_per_day = _cubic_through(to_nodes_d, node_values)
        rate = rate_per_day / SECONDS_PER_DAY
        if zonal:
            tide, tide_rate = zonal_tides(tt.centuries_since_j2000())
            value[:, 0] += tide
            rate[:, 0] += tide_rate
        return EopValues(*(*value.T, *rate.T, self.predicted[stencil].any(axis=1)))

    def _require_covered(self, tt: Epochs) -> None:
        after_first = tt.seconds_since(self._nodes_tt[:1])
        before_last = self._nodes_tt[np.full(len(tt), -1)].seconds_since(tt)
        early = bool((after_first < 0.0).any())
        _refuse(
            tt[(after_first < 0.0) | (before_last < 0.0)],
            "the table of Earth orientation",
            self.mjd_utc,
            "tables begin in 1972, when the present UTC did"
            if early and self.mjd_utc[0] == _MJD_1972
            else f"update astropy-iers-data, or give a file that covers it, {_BEYOND}",
        )


def _refuse(wrong: Epochs, source: str, mjd_utc: Floats, advice: str) -> None:
    """Raise a :class:`CoverageError` about epochs that the days of a table do not cover."""
    if len(wrong):
        days = np.sort(wrong.day_strings())
        first, last = (
            [f"{day_of(mjd)} UTC" for mjd in mjd_utc[[0, -1]]] if len(mjd_utc) else ["no date", "none"]
        )
        raise CoverageError(source, (first, last), (f"{days[0]} TT", f"{days[-1]} TT"), advice)


def _cubic_through(to_nodes: Floats, node_values: Floats) -> tuple[Floats, Floats]:
    """Lagrange's cubic through four nodes, and its derivative, at the origin of ``to_nodes`` (n, 4); both (n, k)."""
    weights = np.empty_like(to_nodes)
    slopes = np.empty_like(to_nodes)
    for j in range(4):
        a, b, c = (to_nodes[:, m] for m in range(4) if m != j)
        x = to_nodes[:, j]
        scale = (x - a) * (x - b) * (x - c)
        weights[:, j] = -a * b * c / scale
        slopes[:, j] = (a * b + b * c + c * a) / scale
    return np.einsum("nj,njk->nk", weights, node_values), np.einsum("nj,njk->nk", slopes, node_values)


class _Layout(NamedTuple):
    """Places of the columns in a row, counted from 1 as in the descriptions of the formats."""

    series: str
    row: re.Pattern[bytes]
    width: int
    places: dict[str, tuple[int, int]]
    pole_offset_arcsec: float  # unit of dX, dY


_C04 = _Layout(
    "C04",
    re.compile(rb"\d{4}[ \d]{4}[ \d]{4}[ \d]{4} *\d{5}\.\d\d "),
    218,
    {"MJD": (17, 26), "x": (27, 38), "y": (39, 50), "UT1-UTC": (51, 62), "dX": (63, 74), "dY": (75, 86)},
    1.0,
)
_FLAGS = {"flag of x, y": (17, 17), "flag of UT1": (58, 58), "flag of dX, dY": (96, 96)}  # P is a prediction
_BULLETIN_A = _Layout(
    "Bulletin A",
    re.compile(rb"[ \d]{6} \d{5}\.\d\d [IP ]"),
    187,
    {"MJD": (8, 15), "x": (19, 27), "y": (38, 46), "UT1-UTC": (59, 68), "dX": (98, 106), "dY": (117, 125)}
    | _FLAGS,
    1e-3,
)


class _Rows(NamedTuple):
    """Rows of a file, divided into columns, with their line numbers."""

    path: Path
    layout: _Layout
    columns: NDArray[Any]
    lines: Indices

    @classmethod
    def read(cls, path: Path) -> _Rows:
        texts = b"".join(block for _, block in read_blocks(path, encoding="latin-1")).split(b"\n")
        lines = (
            np.array([k for k, text in enumerate(texts) if text.strip() and not text.startswith(b"#")]) + 1
        )
        if not len(lines):
            raise FileFormatError(path, "has no rows; fetch or write it again")
        if len(texts) > 1 and 0 < len(texts[-1]) < len(texts[-2]):
            raise FileFormatError(path, "the last row was cut; fetch or write the file again", len(texts))
        layout = next(
            (candidate for candidate in (_C04, _BULLETIN_A) if candidate.row.match(texts[lines[0] - 1])), None
        )
        if layout is None:
            raise FileFormatError(
                path,
                "this is a row of neither IERS 20 C04 (year, month, day, hour, MJD, x, y, UT1-UTC, dX, dY ...) "
                "nor finals2000A; download eopc04.1962-now or finals2000A.all",
                int(lines[0]),
            )
        places = layout.places.values()
        fields: Any = {
            "names": list(layout.places),
            "formats": [f"S{last - first + 1}" for first, last in places],
            "offsets": [first - 1 for first, _ in places],
            "itemsize": layout.width,
        }
        rows = np.array([texts[k - 1] for k in lines], dtype=f"S{layout.width}")
        return cls(path, layout, rows.view(np.dtype(fields)), lines)

    def fail(self, row: int, problem: str) -> NoReturn:
        raise FileFormatError(self.path, problem, int(self.lines[row]))

    def numbers(self, name: str, blank_allowed: bool = False) -> Floats:
        text = self.columns[name]
        if blank_allowed:
            text = np.where(np.char.strip(text) != b"", text, b"nan")
        try:
            values = text.astype(np.float64)
        except ValueError:
            values = np.array([_number(item) for item in text])
        wrong = np.flatnonzero(~np.isfinite(values) & ~(blank_allowed & (text == b"nan")))
        if len(wrong):
            first, last = self.layout.places[name]
            shown = text[wrong[0]].decode("ascii", "replace")
            self.fail(wrong[0], f"columns {first} to {last} should hold {name}, but hold {shown!r}")
        return np.asarray(values)


def read_eop_rows(
    path: str | Path, first_mjd_utc: float = 0.0, package: str = ""
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read a C04 or finals2000A file, plain or gzip: the columns of an EopTable from a date on, and its sources."""
    path = Path(path)
    rows = _Rows.read(path)
    mjd = rows.numbers("MJD")
    used = mjd >= first_mjd_utc
    of_bulletin_a = rows.layout is _BULLETIN_A
    if of_bulletin_a:  # rows after the last prediction hold a date alone
        filled = np.flatnonzero(np.char.strip(rows.columns["UT1-UTC"]) != b"")
        used[filled[-1] + 1 if len(filled) else 0 :] = False
    rows = rows._replace(columns=rows.columns[used], lines=rows.lines[used])
    mjd, (x, y, ut1) = mjd[used], (rows.numbers(name) for name in ("x", "y", "UT1-UTC"))
    for k in np.flatnonzero(np.diff(mjd) != 1.0)[:1]:
        rows.fail(k + 1, f"MJD {mjd[k + 1]:.2f} follows {mjd[k]:.2f}; daily rows are needed")
    for k in np.flatnonzero((x == 0.0).astype(int) + (y == 0.0) + (ut1 == 0.0) >= 2)[:1]:
        problem = f"x, y and UT1-UTC of {day_of(mjd[k])} are zero, as in rows that are not filled in yet"
        rows.fail(k, f"{problem}; remove the row, or fetch the file again")
    dx, dy = (rows.layout.pole_offset_arcsec * rows.numbers(name, of_bulletin_a) for name in ("dX", "dY"))
    for k in np.flatnonzero(np.maximum(np.abs(dx), np.abs(dy)) > _MAX_POLE_OFFSET_ARCSEC)[:1]:
        rows.fail(
            k,
            "the celestial pole offset is too large to be dX, dY of IAU 2000A: offsets of the 1980 nutation "
            "theory (dPsi, dEpsilon) cannot be used; take the file with dX, dY",
        )
    predicted = np.zeros(len(mjd), dtype=np.bool_)
    for flag in _FLAGS if of_bulletin_a else ():
        predicted |= rows.columns[flag] == b"P"
    angles = {"xp_rad": x, "yp_rad": y, "dx_rad": dx, "dy_rad": dy}
    columns: dict[str, Any] = {name: arcsec * ARCSEC_RAD for name, arcsec in angles.items()}
    columns |= {"mjd_utc": mjd, "ut1_minus_utc_s": ut1, "predicted": predicted}
    if not len(mjd):
        return columns, ()
    name, sha256 = path.name + package, hashlib.sha256(path.read_bytes()).hexdigest()
    return columns, (f"{rows.layout.series} {name}, {day_of(mjd[0])} to {day_of(mjd[-1])}, sha256 {sha256}",)


def day_of(mjd_utc: float) -> str:
    """Return a date as text, yyyy-mm-dd."""
    return str(Epochs.from_jd(MJD_ZERO_JD, mjd_utc, "UTC").day_strings()[0])


def _number(text: bytes) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
