"""Positions of the Earth, the Moon, the Sun and large planets, and rates of clocks there: ICRF axes, TDB, SI units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radioloc.constants import C_M_S, J2000_JD, SECONDS_PER_DAY
from radioloc.ephemeris.constants import CONSTANTS, EphemerisConstants
from radioloc.errors import CoverageError, InputError, KernelError
from radioloc.kernels import Kernel, KernelFile, Segment
from radioloc.kernels.daf import span_dates
from radioloc.kernels.files import open_kernel
from radioloc.quantities import EpochsLike, accepts_quantities
from radioloc.time import Epochs, utc_strings
from radioloc.vectors import Floats, chebyshev_sums, dot, length

_M_PER_KM = 1000.0
_SOLAR_SYSTEM_BARYCENTRE, _EARTH_MOON_BARYCENTRE, _EARTH, _MOON = 0, 3, 399, 301

BODIES = {"sun": 10, "moon": _MOON, "venus": 2, "jupiter": 5, "saturn": 6}
"""Bodies with their NAIF codes; the planets are the barycentres of their systems."""

_State = tuple[Floats, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class EarthState:
    """Barycentric state of the geocentre, ICRF axes; derivatives with respect to TDB, shapes (n, 3)."""

    position_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Ephemeris:
    """A planetary and lunar ephemeris; opened by :meth:`Ephemeris.open`."""

    name: str  #: such as DE421
    constants: EphemerisConstants  #: masses, Love numbers and axes that belong to it
    spk: Kernel

    @classmethod
    def open(cls, spk: str | Path = "DE421", constants: EphemerisConstants | None = None) -> Ephemeris:
        """Open an ephemeris: ``"DE421"`` or the path of an SPK made of a JPL ephemeris with the Earth, Moon and Sun.

        An ephemeris that is not in :data:`radioloc.ephemeris.CONSTANTS` needs its `constants`.
        """
        kernel = open_kernel(spk, "SPK")
        for target, center in (
            (_EARTH_MOON_BARYCENTRE, _SOLAR_SYSTEM_BARYCENTRE),
            (_EARTH, _EARTH_MOON_BARYCENTRE),
            (_MOON, _EARTH_MOON_BARYCENTRE),
            (BODIES["sun"], _SOLAR_SYSTEM_BARYCENTRE),
        ):
            kernel.segments_of(target, center)
        if constants is not None:
            return cls(constants.name, constants, kernel)
        labels = sorted({segment.name for segment in kernel.segments_of(_EARTH, _EARTH_MOON_BARYCENTRE)})
        name = ", ".join(sorted({re.sub(r".*?DE-?0*(\d+).*", r"DE\1", label) for label in labels}))
        if name not in CONSTANTS:
            raise KernelError(
                f"{kernel.file.path} calls itself {', '.join(labels)!r}, an ephemeris without constants "
                f"in radioloc ({', '.join(CONSTANTS)} have them); use one of these, or give constants= in Python"
            )
        return cls(name, CONSTANTS[name], kernel)

    @property
    def kernel(self) -> KernelFile:
        """Path, SHA-256 and span of the file."""
        return self.spk.file

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that the kernel holds."""
        held = {(segment.target, segment.center) for segment in self.spk.segments}
        centers = {_MOON: _EARTH_MOON_BARYCENTRE}
        return tuple(
            name
            for name, code in BODIES.items()
            if (code, centers.get(code, _SOLAR_SYSTEM_BARYCENTRE)) in held
        )

    @accepts_quantities
    def earth(self, tdb: EpochsLike) -> EarthState:
        """Barycentric position, velocity and acceleration of the geocentre at epochs of TDB.

        Round-off of the position is some 1e-5 m. The acceleration is the second derivative of the Chebyshev series.
        """
        return self.states((), tdb)[0]

    @accepts_quantities
    def states(self, bodies: Sequence[str], tdb: EpochsLike) -> tuple[EarthState, dict[str, _State]]:
        """Return the Earth as :meth:`earth`, and bodies as :meth:`geocentric`; the Earth is computed once for all."""
        barycentre = self._relative(_EARTH_MOON_BARYCENTRE, _SOLAR_SYSTEM_BARYCENTRE, tdb, derivatives=2)
        earth = self._relative(_EARTH, _EARTH_MOON_BARYCENTRE, tdb, derivatives=2)
        body_states = {body: self._geocentric(BODIES[body], tdb, barycentre, earth) for body in bodies}
        return EarthState(*((b + e) * _M_PER_KM for b, e in zip(barycentre, earth, strict=True))), body_states

    @accepts_quantities
    def geocentric(self, body: str, tdb: EpochsLike) -> _State:
        """Geocentric position and velocity of a body, geometric (no light time), in barycentric coordinates, ICRF axes.

        The Moon is the difference of its position and the Earth's relative to the Earth-Moon barycentre, without the
        1.5e11 m from the solar system barycentre; its round-off is below 1e-6 m. Velocities are with respect to TDB.

        Raises
        ------
        InputError
            The body is not one of :data:`BODIES`, or the epochs are not in TDB.
        KernelError
            The kernel does not hold the body.
        CoverageError
            An epoch lies outside the kernel's span.

        Examples
        --------
        >>> from radioloc.ephemeris import Ephemeris
        >>> from radioloc.time import epochs_from_strings
        >>> position_m, _ = Ephemeris.open().geocentric("moon", epochs_from_strings("2020-12-01", "TDB"))
        >>> bool(3.5e8 < (position_m**2).sum() ** 0.5 < 4.1e8)
        True
        """
        if body not in BODIES:
            raise InputError(f"body: expected one of {', '.join(BODIES)}, got {body!r}")
        return self.geocentric_center(BODIES[body], tdb)

    @accepts_quantities
    def geocentric_center(self, code: int, tdb: EpochsLike) -> _State:
        """Geocentric position and velocity of a trajectory's centre by NAIF code; as :meth:`geocentric`."""
        if code == _EARTH:
            return np.zeros((len(tdb), 3)), np.zeros((len(tdb), 3))
        barycentre = self._relative(_EARTH_MOON_BARYCENTRE, _SOLAR_SYSTEM_BARYCENTRE, tdb)
        return self._geocentric(code, tdb, barycentre, self._relative(_EARTH, _EARTH_MOON_BARYCENTRE, tdb))

    def _geocentric(
        self, code: int, tdb: Epochs, barycentre: tuple[Floats, ...], earth: tuple[Floats, ...]
    ) -> _State:
        """Return position and velocity, m, by those of the Earth-Moon barycentre and of the Earth about it, km."""
        if code in (_MOON, _EARTH_MOON_BARYCENTRE):
            center = self._relative(code, _EARTH_MOON_BARYCENTRE, tdb)
        else:
            center = self._relative(code, _SOLAR_SYSTEM_BARYCENTRE, tdb)
            center = center[0] - barycentre[0], center[1] - barycentre[1]
        return (center[0] - earth[0]) * _M_PER_KM, (center[1] - earth[1]) * _M_PER_KM

    @accepts_quantities
    def barycentric(self, body: str, tdb: EpochsLike) -> _State:
        """Barycentric position and velocity of a body; as :meth:`geocentric`, with the rounding of :meth:`earth`."""
        earth = self.earth(tdb)
        position_m, velocity_m_s = self.geocentric(body, tdb)
        return earth.position_m + position_m, earth.velocity_m_s + velocity_m_s

    def _relative(self, target: int, center: int, tdb: Epochs, derivatives: int = 1) -> tuple[Floats, ...]:
        """Position, velocity and as many derivatives of one NAIF code relative to another, km and s."""
        if target == center:
            return (np.zeros((len(tdb), 3)),) * (derivatives + 1)
        return evaluate(self.spk, target, center, tdb, derivatives)


def clock_rate(
    ephemeris: Ephemeris, tdb: Epochs, place_m: Floats, velocity_m_s: Floats, leave_out: str = ""
) -> Floats:
    """Return the rate of an ideal clock against TCG at the geocentre, d(tau - TCG)/d(TDB), shape (n,)."""
    # -[(v^2 - v_E^2) / 2 + w(x) - w_E(x_E)] / c^2 (IERS Conventions 2010, section 10.1; Soffel et al. 2003); places are
    # from the geocentre; the potential of the body `leave_out` does not act, for coordinate time in its centre.
    gm = ephemeris.constants.gm_m3_s2
    slower = dot(ephemeris.earth(tdb).velocity_m_s + 0.5 * velocity_m_s, velocity_m_s)
    slower = slower + gm("earth") / length(place_m)
    for body in ephemeris.bodies:
        body_m, _ = ephemeris.geocentric(body, tdb)
        slower = slower - gm(body) / length(body_m)
        if body != leave_out:
            slower = slower + gm(body) / length(place_m - body_m)
    return np.asarray(-slower / C_M_S**2)


def evaluate(
    kernel: Kernel, target: int, center: int, tdb: Epochs, derivatives: int = 1
) -> tuple[Floats, ...]:
    """Evaluate the segments of a target: components and derivatives up to an order, (n, 3), in the file's units."""
    tdb.require("TDB")
    segments = kernel.segments_of(target, center)
    # The two floats of an epoch meet within a record only, which resolves it to 1e-10 s: 0.1 micrometre of the Moon.
    midnight_s = (tdb.jd - J2000_JD) * SECONDS_PER_DAY  # exact: a whole number of half days
    rest_s = tdb.fraction * SECONDS_PER_DAY
    indices = np.full(len(tdb), -1)
    for k, segment in enumerate(segments):
        in_span = ((midnight_s - segment.start_s) + rest_s >= 0) & (
            (midnight_s - segment.end_s) + rest_s <= 0
        )
        indices[in_span] = k
    uncovered = tdb[indices < 0]
    if len(uncovered):
        first, last = utc_strings(uncovered[np.lexsort((uncovered.fraction, uncovered.jd))[[0, -1]]], 3)
        raise CoverageError(
            f"{kernel.file.path} (NAIF code {target})",
            span_dates((s.start_s, s.end_s) for s in segments),
            (f"{first} TDB", f"{last} TDB"),
            "open a kernel that covers these epochs, or leave them out",
        )
    if len(segments) == 1:
        return _chebyshev(segments[-1], midnight_s, rest_s, derivatives)
    out = tuple(np.empty((len(tdb), 3)) for _ in range(derivatives + 1))
    for k in np.unique(indices):
        rows = indices == k
        for values, part in zip(
            out, _chebyshev(segments[k], midnight_s[rows], rest_s[rows], derivatives), strict=True
        ):
            values[rows] = part
    return out


def _chebyshev(segment: Segment, midnight_s: Floats, rest_s: Floats, derivatives: int) -> tuple[Floats, ...]:
    length_s = segment.record_length_s
    index, offset_s = np.divmod(midnight_s - segment.first_record_s, length_s)
    carry, offset_s = np.divmod(offset_s + rest_s, length_s)
    record = (index + carry).astype(np.int64)
    # The very end of the last record belongs to it.
    past_end = record == len(segment.coefficients)
    record = record - past_end
    offset_s = offset_s + past_end * length_s
    s = 2.0 * offset_s / length_s - 1.0
    present, indices = np.unique(record, return_inverse=True)
    coefficients = np.take(segment.coefficients[present].transpose(2, 1, 0), indices.reshape(-1), axis=2)
    sums = chebyshev_sums(coefficients, s, derivatives)
    per_second = 2.0 / length_s
    return tuple(part.T if order == 0 else part.T * per_second**order for order, part in enumerate(sums))
