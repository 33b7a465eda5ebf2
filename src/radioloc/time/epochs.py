"""Epochs as two floats: a Julian date at midnight and the fraction of the day after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radioloc.constants import J2000_JD, MJD_ZERO_JD, SECONDS_PER_DAY, UNIX_JD
from radioloc.errors import InputError
from radioloc.units import as_float_array, set_fields
from radioloc.vectors import Floats

SCALES = ("UTC", "TAI", "TT", "TDB", "UT1")


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """A one-dimensional array of epochs in one time scale.

    The fraction is kept in [0, 1), so an epoch is resolved to 1e-11 s whatever its date, and the date is exact.
    For UTC the pair is ERFA's quasi Julian date: on a day with a leap second the fraction runs over 86401 s.
    """

    jd: Floats  #: (n,), Julian date of the midnight before the epoch (ends in .5)
    fraction: Floats  #: (n,), fraction of the day since then, 0 <= fraction < 1
    scale: str  #: "UTC", "TAI", "TT", "TDB", "UT1": time scale

    def __post_init__(self) -> None:
        for name in ("jd", "fraction"):
            if type(getattr(self, name)) is not np.ndarray:
                set_fields(self, **{name: np.atleast_1d(_days(getattr(self, name), name))})

    @classmethod
    def from_time(cls, time: Any) -> Epochs:
        """Build from an astropy ``Time`` of any shape, without loss, in its own scale: UTC, TAI, TT, TDB or UT1.

        Examples
        --------
        >>> from astropy.time import Time
        >>> Epochs.from_time(Time("2020-12-01T15:11:00", scale="tdb"))
        <Epochs 1 TDB 2020-12-01 to 2020-12-01>
        """
        if not (hasattr(time, "jd1") and hasattr(time, "scale")):
            raise InputError(f"expected an astropy Time, got {time!r}")
        if np.any(getattr(time, "mask", False)):
            raise InputError("an epoch of the Time is masked; leave it out")
        return cls.from_jd(np.ravel(time.jd1), np.ravel(time.jd2), str(time.scale).upper())

    def to_time(self) -> Any:
        """Return the epochs as an astropy ``Time`` of the same scale, to 5e-12 s.

        Examples
        --------
        >>> Epochs.from_jd(2459184.5, [0.25, 0.5], "TDB").to_time()
        <Time object: scale='tdb' format='isot' value=['2020-12-01T06:00:00.000' '2020-12-01T12:00:00.000']>
        """
        from astropy.time import Time

        time = Time(self.jd, self.fraction, format="jd", scale=self.scale.lower())
        time.format = "isot"
        return time

    @classmethod
    def from_jd(cls, jd: ArrayLike, fraction: ArrayLike, scale: str) -> Epochs:
        """Build from any split of Julian dates in two, shapes () or (n,), without loss."""
        if scale not in SCALES:
            raise InputError(f"time scale {scale!r} is not known; use one of {', '.join(SCALES)}")
        jd_in, fraction_in = np.broadcast_arrays(
            np.atleast_1d(_days(jd, "jd")), np.atleast_1d(_days(fraction, "fraction"))
        )
        if not (np.isfinite(jd_in).all() and np.isfinite(fraction_in).all()):
            raise InputError("a Julian date is not a finite number")
        midnight = np.floor(jd_in - 0.5)
        midnight += 0.5
        day_part = jd_in - midnight
        day_part += fraction_in
        carry = np.floor(day_part)
        day_part -= carry
        midnight += carry
        # A fraction that rounds up to one belongs to the next day.
        late = day_part >= 1.0
        midnight += late
        day_part[late] = 0.0
        return cls(midnight, day_part, scale)

    @classmethod
    def from_tdb_seconds(cls, seconds: ArrayLike) -> Epochs:
        """Build from TDB seconds since J2000 (SPICE's ephemeris time), resolved to 0.12 microseconds today."""
        days, day_part = np.divmod(np.atleast_1d(_days(seconds, "seconds", "s")), SECONDS_PER_DAY)
        return cls.from_jd(J2000_JD + days, day_part / SECONDS_PER_DAY, "TDB")

    def __len__(self) -> int:
        return len(self.jd)

    def __getitem__(self, index: Any) -> Epochs:
        """Select by anything that indexes an array; one epoch stays an array of length one."""
        return Epochs(np.atleast_1d(self.jd[index]), np.atleast_1d(self.fraction[index]), self.scale)

    def __repr__(self) -> str:
        if len(self) == 0:
            return f"<Epochs none {self.scale}>"
        first, last = self.day_strings()[[0, -1]] if len(self) > 1 else self.day_strings()[[0, 0]]
        return f"<Epochs {len(self)} {self.scale} {first} to {last}>"

    @property
    def mjd(self) -> Floats:
        """Modified Julian date in one float (resolves about a microsecond), shape (n,)."""
        return (self.jd - MJD_ZERO_JD) + self.fraction

    def require(self, scale: str) -> None:
        """Raise :class:`InputError` unless the epochs are in the given scale."""
        if self.scale != scale:
            raise InputError(f"epochs in {scale} are needed here, but {self.scale} was given")

    def shifted(self, seconds: ArrayLike) -> Epochs:
        """Return the epochs shifted by SI seconds of their own scale, also one epoch by many; UTC cannot be shifted."""
        if self.scale == "UTC":
            raise InputError("UTC cannot be moved by seconds across a leap second; convert to TAI first")
        return Epochs.from_jd(
            self.jd, self.fraction + as_float_array(seconds, "s", "seconds") / SECONDS_PER_DAY, self.scale
        )

    def seconds_since(self, reference: Epochs) -> Floats:
        """Seconds since reference epochs in the same scale (not UTC), shape (n,)."""
        self.require(reference.scale)
        if self.scale == "UTC":
            raise InputError("UTC cannot be differenced across a leap second; convert to TAI first")
        return ((self.jd - reference.jd) + (self.fraction - reference.fraction)) * SECONDS_PER_DAY

    def centuries_since_j2000(self) -> Floats:
        """Julian centuries of 36525 days since J2000 in the epochs' own scale, shape (n,)."""
        return ((self.jd - J2000_JD) + self.fraction) / 36525.0

    def day_strings(self) -> NDArray[np.str_]:
        """Calendar dates yyyy-mm-dd of the midnights, shape (n,)."""
        days = (self.jd - UNIX_JD).astype(np.int64).astype("datetime64[D]")
        return np.datetime_as_string(days)

    @staticmethod
    def concatenate(parts: list[Epochs]) -> Epochs:
        """Join epochs of one scale, in order."""
        if not parts:
            raise InputError("no epochs to join")
        for part in parts[1:]:
            part.require(parts[0].scale)
        return Epochs(
            np.concatenate([p.jd for p in parts]), np.concatenate([p.fraction for p in parts]), parts[0].scale
        )


def _days(value: Any, name: str, unit: str = "d") -> Floats:
    if hasattr(value, "jd1"):
        raise InputError(f"{name} is an astropy Time, which has its own scale; use Epochs.from_time")
    if str(getattr(value, "dtype", "")) in ("float16", "float32"):
        raise InputError(
            f"{name} is of single precision, which resolves minutes at best; give double precision"
        )
    return as_float_array(value, unit, name)


Tdb = Annotated[Epochs, "TDB"]
"""Epochs in TDB: the type of fields whose dates in a study file are TDB, not UTC."""
