"""Range and VLBI delay computed in the geocentric frame (GCRS, TT), for comparison with the library.

The library solves the light-time equation in the barycentric frame, in TDB. This module places stations, Moon and light
in the GCRS, where speeds are small, and measures time in TT. It does not use the light path of the library; shared are
the ephemeris, the rotations of the Earth and of the Moon, and ERFA's TDB - TT at the geocentre, which only determines
the epochs of the ephemeris.

From the ephemeris to the GCRS an *event* is carried over (IAU 2000 resolution B1.3; Soffel et al. 2003, Astron. J. 126,
2687, eq. 8; in the units of TDB on one side and of TT on the other), with r from the geocentre at the event's TDB, and
v, a, w the geocentre's velocity, acceleration and the potential there of all other bodies:

    TT = TDB - (TDB - TT)_geocentre - v.r / c^2 (1 + (v^2 / 2 + 3 w) / c^2 + L_B - L_G)
    X  = r (1 + w/c^2 + L_B - L_G) + v (v.r) / (2 c^2) + r (a.r) / c^2 - a r^2 / (2 c^2)

At the Moon these terms are, in this order: up to 130 microseconds (in which it moves 13 cm), 9.8 m, up to 1.9 m, and
together 5 mm. The next order in the time of the event is up to 6 ps, 2 mm of a one-way range, and cancels in two-way.

In the GCRS light takes |X2 - X1| / c + 2/c^3 times the integral of the potential W along the way. W is the Earth's own
(4 to 5 cm for a leg) and of each other body the tidal part: its potential less value and gradient at the geocentre. For
the Moon that is 0.5 mm, for the Sun 0.02 mm. The 7.6 m of the Sun in the barycentric frame correspond to the lengths
and the clocks that the potential of the Sun changes: 3.8 m each.

The rotation of the Earth at the TT of a station determines its place. Differences of TDB - TT between stations enter
three-way range only in the barycentric frame. With v the Earth's velocity and r1, r2 the stations at
transmission and reception, TDB - TT grows along the path by

    v.(r2 - r1) / c^2 + (rate at the geocentre) * (time of flight)

Times c, the first part is up to 1e-4 of the baseline, more than a kilometre to the other side of the Earth: events that
are simultaneous for the Earth are not so for the barycentre. Measured values do not change; the barycentric legs are
longer or shorter by as much, as one station moves away from the light and the other towards it. In two-way range
r2 - r1 is how far the station turns in 2.6 s, 1.2 km at most, which leaves 0.12 m; the second part, the eccentricity of
the Earth's orbit (3.3e-10 at most), adds up to 0.26 m. Formulations that have this term and have it not agree only if
it is right.
"""

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from radioloc.constants import C_M_S, L_B, L_G
from radioloc.earth.orientation import EarthOrientation
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.lunar import rot_icrf_to_pa
from radioloc.time import Epochs

_ITERATIONS = 4  # each reduces the error by the speed of the Moon or of a station over that of light, 3e-6

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)

Vectors = NDArray[np.float64]


def _dot(a: Vectors, b: Vectors) -> Vectors:
    return np.einsum("...i,...i->...", a, b)


def _norm(a: Vectors) -> Vectors:
    return np.sqrt(_dot(a, a))


def gcrs_terms(
    r_m: Vectors, velocity_m_s: Vectors, acceleration_m_s2: Vectors, potential_m2_s2: Vectors
) -> dict[str, Vectors]:
    """Return the terms between a geocentric vector in TDB units and the GCRS vector in TT units, m.

    Velocity, acceleration and external potential are those of the geocentre.
    """
    v, a = velocity_m_s / C_M_S, acceleration_m_s2 / C_M_S**2
    return {
        "scale": r_m * (potential_m2_s2 / C_M_S**2 + L_B - L_G)[:, None],
        "lorentz": v * (0.5 * _dot(v, r_m))[:, None],
        "acceleration": r_m * _dot(a, r_m)[:, None] - a * (0.5 * _dot(r_m, r_m))[:, None],
    }


@dataclass(frozen=True)
class Leg:
    """Leg of the light path between an event on the Moon and one on the Earth."""

    length_s: Vectors
    """TT between the events, s."""
    gravity_m: Vectors
    """Gravitational part, m."""


@dataclass(frozen=True)
class MoonEvent:
    """Point on the Moon at one TDB, and positions of the other bodies."""

    tt_s: Vectors
    """TT of the event, s from the tag."""
    point_m: Vectors
    """The point, GCRS."""
    moon_tt_s: Vectors
    """TT of the Moon's centre at the same TDB, s from the tag."""
    moon_m: Vectors
    """The Moon's centre then, GCRS."""
    geocentre_s: Vectors
    """TT at the geocentre at the TDB of the event, s from the tag."""
    external: tuple[tuple[float, Vectors], ...]
    """GM and geocentric position of all bodies but the Earth and the Moon."""


class GeocentricFormulation:
    """Light times in the GCRS for tags in TT.

    Parameters
    ----------
    tt : Epochs
        The tags.
    point_pa_m : ndarray, shape (3,)
        The point on the Moon, principal axes, as a local ruler measures it.
    """

    def __init__(
        self,
        ephemeris: Ephemeris,
        libration: LunarOrientation,
        orientation: EarthOrientation,
        tt: Epochs,
        point_pa_m: Vectors,
    ) -> None:
        self.ephemeris, self.libration, self.orientation = ephemeris, libration, orientation
        self.tt, self.point_pa_m = tt, point_pa_m
        self.geocentric_s = erfa.dtdb(tt.jd, tt.fraction, 0.0, 0.0, 0.0, 0.0)
        self.tdb = Epochs.from_jd(tt.jd, tt.fraction + self.geocentric_s / 86400.0, "TDB")

    def range_m(self, transmitter_itrf_m: Vectors, receiver_itrf_m: Vectors, tag: str) -> Vectors:
        """Speed of light times the TT from transmission to reception; one of them is tagged."""
        tagged = {"transmit": transmitter_itrf_m, "receive": receiver_itrf_m}[tag]
        untagged = receiver_itrf_m if tag == "transmit" else transmitter_itrf_m
        sense = 1.0 if tag == "transmit" else -1.0
        event, tagged_leg = self._moon_from(tagged, sense)
        untagged_leg = self._station_from(event, untagged, sense)
        return C_M_S * (tagged_leg.length_s + untagged_leg.length_s)

    def vlbi_delay_m(self, first_itrf_m: Vectors, second_itrf_m: Vectors) -> Vectors:
        """Speed of light times TT of arrival at the second station less that at the first, which is tagged."""
        event, first = self._moon_from(first_itrf_m, -1.0)
        second = self._station_from(event, second_itrf_m, 1.0)
        return C_M_S * (second.length_s - first.length_s)

    def one_way_by_own_clock_m(self, receiver_itrf_m: Vectors, since: Epochs | None = None) -> Vectors:
        """Speed of light times TT of the reception, tagged, less the transmission by the point's own clock."""
        event, _ = self._moon_from(receiver_itrf_m, -1.0)
        return -C_M_S * (event.tt_s + self.gained_s(event, self.tt[:1] if since is None else since))

    def one_way_m(self, receiver_itrf_m: Vectors, tag: str) -> Vectors:
        """Speed of light times TT of the reception less the geocentre's TT at the TDB of the transmission."""
        if tag == "receive":
            event, _ = self._moon_from(receiver_itrf_m, -1.0)
            return -C_M_S * event.geocentre_s
        event = self.moon_event(np.zeros(len(self.tt)))
        return C_M_S * (event.tt_s + self._station_from(event, receiver_itrf_m, 1.0).length_s)

    def gained_s(self, event: MoonEvent, since: Epochs) -> Vectors:
        """Return the gain of a clock at the point on TT from an epoch to the event: proper time of the GCRS.

        In TT the rate is L_G - (V^2 / 2 + W) / c^2, with the local velocity V and the potential W of the Earth and the
        tidal ones of the others (Soffel et al. 2003, section 3.4). The velocity of the Earth does not enter.
        """
        since_s = self.tt.seconds_since(since) + event.tt_s
        knots_s = np.linspace(since_s.min() - 3600.0, since_s.max() + 3600.0, 121)
        first = since[np.zeros(len(knots_s), dtype=int)]
        grid = GeocentricFormulation(
            self.ephemeris, self.libration, self.orientation, first.shifted(knots_s), self.point_pa_m
        )
        grid_event = grid.moon_event(np.zeros(len(knots_s)))
        grid_s = knots_s + grid_event.tt_s
        gm = self.ephemeris.constants.gm_m3_s2
        slower = 0.5 * (CubicSpline(grid_s, grid_event.point_m).derivative()(grid_s) ** 2).sum(axis=1)
        slower = slower + gm("earth") / _norm(grid_event.point_m)
        distance_m = _norm(grid_event.moon_m)
        projection = _dot(grid_event.point_m, grid_event.moon_m) / distance_m**2
        slower = slower + gm("moon") * (
            1.0 / _norm(grid_event.point_m - grid_event.moon_m) - (1.0 + projection) / distance_m
        )
        for gm_body, body_m in grid_event.external:
            slower = slower + gm_body * _tidal(grid_event.point_m, body_m)
        grown = CubicSpline(grid_s, L_G - slower / C_M_S**2).antiderivative()
        return grown(since_s) - grown(0.0)

    def moon_event(self, tdb_s: Vectors) -> MoonEvent:
        """Carry the point on the Moon from the ephemeris to the GCRS.

        Parameters
        ----------
        tdb_s : ndarray, shape (n,)
            TDB of the event, s from the TDB that the geocentre has at the tag.
        """
        tdb = self.tdb.shifted(tdb_s)
        earth = self.ephemeris.earth(tdb)
        gm = self.ephemeris.constants.gm_m3_s2
        moon_m, moon_m_s = self.ephemeris.geocentric("moon", tdb)
        external = tuple(
            (gm(body), self.ephemeris.geocentric(body, tdb)[0])
            for body in self.ephemeris.bodies
            if body != "moon"
        )
        seen_m = moon_m + self._seen_from_barycentre(tdb, earth.velocity_m_s + moon_m_s, moon_m, external)

        potential = gm("moon") / _norm(moon_m)
        for gm_body, body_m in external:
            potential = potential + gm_body / _norm(body_m)

        def to_gcrs(r_m: Vectors) -> Vectors:
            terms_m = gcrs_terms(r_m, earth.velocity_m_s, earth.acceleration_m_s2, potential)
            return r_m + sum(terms_m.values())

        v = earth.velocity_m_s
        next_order = (0.5 * _dot(v, v) + 3.0 * potential) / C_M_S**2 + L_B - L_G

        def tt_s(r_m: Vectors) -> Vectors:
            return geocentre_s - (1.0 + next_order) * _dot(v, r_m) / C_M_S**2

        geocentre_s = tdb_s - (erfa.dtdb(tdb.jd, tdb.fraction, 0.0, 0.0, 0.0, 0.0) - self.geocentric_s)
        return MoonEvent(tt_s(seen_m), to_gcrs(seen_m), tt_s(moon_m), to_gcrs(moon_m), geocentre_s, external)

    def _seen_from_barycentre(
        self, tdb: Epochs, moon_m_s: Vectors, moon_m: Vectors, external: tuple[tuple[float, Vectors], ...]
    ) -> Vectors:
        """Return the point from the Moon's centre at one TDB, with the barycentric contraction."""
        angles_rad, _ = self.libration.angles(tdb)
        ruler_m = np.einsum("nji,j->ni", rot_icrf_to_pa(angles_rad), self.point_pa_m)
        potential = self.ephemeris.constants.gm_m3_s2("earth") / _norm(moon_m)
        for gm_body, body_m in external:
            potential = potential + gm_body / _norm(body_m - moon_m)
        v = moon_m_s / C_M_S
        scale = (potential / C_M_S**2 + L_B - L_G)[:, None]
        return ruler_m - ruler_m * scale - v * (0.5 * _dot(v, ruler_m))[:, None]

    def station_m(self, itrf_m: Vectors, tt_s: Vectors) -> Vectors:
        """Return a station in the GCRS at TT seconds from the tag."""
        rotation = self.orientation.evaluate(self.tt.shifted(tt_s)).rot_itrf_to_gcrs
        return rotation @ itrf_m

    def _moon_from(self, itrf_m: Vectors, sense: float) -> tuple[MoonEvent, Leg]:
        """Return the event on the Moon that light from the tagged station reaches (sense 1) or comes from (-1)."""
        station_m = self.station_m(itrf_m, np.zeros(len(self.tt)))
        tdb_s = np.full(len(self.tt), sense * 1.3)
        for _ in range(_ITERATIONS):
            event = self.moon_event(tdb_s)
            leg = self._leg(event, station_m)
            tdb_s = tdb_s + (sense * leg.length_s - event.tt_s)
        return event, leg

    def _station_from(self, event: MoonEvent, itrf_m: Vectors, sense: float) -> Leg:
        """Return the leg between the event on the Moon and a station later (sense 1) or earlier (-1)."""
        tt_s = event.tt_s + sense * 1.3
        for _ in range(_ITERATIONS):
            leg = self._leg(event, self.station_m(itrf_m, tt_s))
            tt_s = event.tt_s + sense * leg.length_s
        return leg

    def _leg(self, event: MoonEvent, station_m: Vectors) -> Leg:
        gm = self.ephemeris.constants.gm_m3_s2
        way_m = event.point_m - station_m
        length_m = _norm(way_m)
        integral = gm("earth") * _inverse_distance(station_m, event.point_m, np.zeros(3))
        # The Moon's tidal potential: exact, as its two other parts are constant and linear along the way.
        distance_m = _norm(event.moon_m)
        half_way_m = 0.5 * (station_m + event.point_m)
        integral = integral + gm("moon") * (
            _inverse_distance(station_m, event.point_m, event.moon_m)
            - length_m / distance_m
            - length_m * _dot(half_way_m, event.moon_m) / distance_m**3
        )
        for gm_body, body_m in event.external:
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                place_m = station_m + way_m * (0.5 * (1.0 + node))
                integral = integral + 0.5 * weight * length_m * gm_body * _tidal(place_m, body_m)
        gravity_m = 2.0 / C_M_S**2 * integral
        return Leg((length_m + gravity_m) / C_M_S, gravity_m)


def _inverse_distance(start_m: Vectors, end_m: Vectors, body_m: Vectors) -> Vectors:
    """Return the integral of 1 / distance from a body along a straight line."""
    unit = (end_m - start_m) / _norm(end_m - start_m)[:, None]

    def primitive(place_m: Vectors) -> Vectors:
        from_body_m = place_m - body_m
        return np.arcsinh(_dot(from_body_m, unit) / _norm(np.cross(from_body_m, unit)))

    return primitive(end_m) - primitive(start_m)


def _tidal(place_m: Vectors, body_m: Vectors) -> Vectors:
    """Return 1 / distance of a body less its value and its slope at the geocentre, 1/m, without loss of digits.

    With q = (|B - X|^2 - B^2) / B^2 and f = (1 + q)^(1/2) - 1, 1 / (1 + f) - 1 + q / 2 is rearranged to cancel the
    first order analytically.
    """
    square = _dot(body_m, body_m)
    slope = _dot(place_m, body_m) / square
    quadratic = _dot(place_m, place_m) / square
    q = quadratic - 2.0 * slope
    root = np.sqrt(1.0 + q)
    # 1/root - 1 = -q / (root (1 + root)), and adding q/2 leaves q (root^2 + root - 2) / (2 root (1 + root)).
    second_order = q * q * (root + 2.0) / (2.0 * root * (1.0 + root) ** 2)
    return (second_order - 0.5 * quadratic) / np.sqrt(square)
