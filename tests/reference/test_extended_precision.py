"""The path of the signal in 40 digits, from barycentric vectors and the kernels' own coefficients.

The library works from the geocentre at the observation's epoch so that 1.5e11 m never enter a sum; here they do, but in
40 digits. Independent of the library are the Chebyshev series, the rotation of the Moon, the light-time iteration and
the vectors' origin. Not independent are TDB - TT (ERFA) and the rotation of the Earth, which only ERFA has; the noise
of those shows in the smoothness of successive ranges.
"""

from __future__ import annotations

import erfa
import mpmath as mp
import numpy as np
import pytest
from arc_cases import APOLLO15_PA_M, LASER, epochs_tai, observations

from radioloc.constants import C_M_S, L_B, L_G
from radioloc.earth.orientation import EarthOrientation
from radioloc.earth.stations import StationCatalogue
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.measurements.exact_predictor import ExactPredictor
from radioloc.measurements.measurement_type import TIME_TAGS
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.measurements.terms import TERMS
from radioloc.time import Epochs, utc_to_tt

GOAL_M = 5e-5
"""What the numerical noise of a range has to stay below."""

# What is reached, with a margin: at 60 random epochs and paths 0.5 micrometres at most from 40 digits. Smoothness has
# also the Earth's rotation in it and the tides, 0.4 micrometres at most in 29 stretches of 2003 to 2024.
FROM_40_DIGITS_M = 2e-6
ROUGHNESS_M = 1e-6

DIGITS = 40
GEOMETRIC_TERMS = ("tdb_tt", "earth_scale", "earth_lorentz", "lunar_scale", "lunar_lorentz")


def mpf(x):
    return mp.mpf(float(x))


class FortyDigits:
    """The same model written again, slowly, from the solar system's barycentre."""

    def __init__(self, terms):
        self.terms = terms
        self.spk = Ephemeris.open().spk
        self.pck = LunarOrientation.open().pck
        self.constants = Ephemeris.open().constants
        self.earth_orientation = EarthOrientation.default()

    @staticmethod
    def series(segment, t):
        """Value and derivative of a segment's three components, file's units and seconds."""
        length = mpf(segment.record_length_s)
        since = t - mpf(segment.first_record_s)
        record = int(mp.floor(since / length))
        s = 2 * (since - record * length) / length - 1
        values, rates = [], []
        for row in segment.coefficients[record]:
            previous, polynomial, previous_rate, rate = mp.mpf(1), s, mp.mpf(0), mp.mpf(1)
            value, derivative = mpf(row[0]) + mpf(row[1]) * s, mpf(row[1])
            for coefficient in row[2:]:
                previous, polynomial, previous_rate, rate = (
                    polynomial,
                    2 * s * polynomial - previous,
                    rate,
                    2 * polynomial + 2 * s * rate - previous_rate,
                )
                value += mpf(coefficient) * polynomial
                derivative += mpf(coefficient) * rate
            values.append(value)
            rates.append(derivative * 2 / length)
        return mp.matrix(values), mp.matrix(rates)

    def body(self, code, t):
        """Barycentric state, m and m/s."""
        centre = 0 if code == 10 else 3
        position, velocity = self.series(self.spk.segment(code, centre), t)
        if centre == 3:
            barycentre = self.series(self.spk.segment(3, 0), t)
            position, velocity = position + barycentre[0], velocity + barycentre[1]
        return 1000 * position, 1000 * velocity

    @staticmethod
    def epochs(t, scale):
        days = t / 86400 + mp.mpf("0.5")
        whole = mp.floor(days)
        return Epochs.from_jd(2451544.5 + float(whole), float(days - whole), scale)

    def geocentric_s(self, t):
        tdb = self.epochs(t, "TDB")
        return mpf(erfa.dtdb(tdb.jd, tdb.fraction, 0.0, 0.0, 0.0, 0.0)[0])

    def scaled(self, vector, velocity, potential_m2_s2, scale, lorentz):
        """A body's own lengths as seen from the barycentre."""
        c2 = mpf(C_M_S) ** 2
        seen = vector.copy()
        if scale in self.terms:
            seen -= vector * (potential_m2_s2 / c2 + mpf(L_B) - mpf(L_G))
        if lorentz in self.terms:
            seen -= velocity * (velocity.T * vector)[0] / (2 * c2)
        return seen

    def gm(self, name):
        return mpf(self.constants.gm_m3_s2(name))

    def station(self, itrf_m, t):
        """Barycentric place of a station and its TDB - TT, at TDB seconds t."""
        earth_m, earth_m_s = self.body(399, t)
        geocentric_s = self.geocentric_s(t)
        topocentric_s = mp.mpf(0)
        for _ in range(3):  # the station's own TT turns the Earth, which moves the station
            tt = self.epochs(t - geocentric_s - topocentric_s, "TT")
            rotation = self.earth_orientation.evaluate(tt)
            # The epoch's last place is 1e-11 s, over which the Earth turns by 5e-9 m.
            place = mp.matrix(rotation.rot_itrf_to_gcrs[0].tolist()) * mp.matrix([mpf(x) for x in itrf_m])
            topocentric_s = (earth_m_s.T * place)[0] / mpf(C_M_S) ** 2
        potential = self.gm("sun") / mp.norm(self.body(10, t)[0] - earth_m)
        potential += self.gm("moon") / mp.norm(self.body(301, t)[0] - earth_m)
        seen = self.scaled(place, earth_m_s, potential, "earth_scale", "earth_lorentz")
        return earth_m + seen, geocentric_s + topocentric_s

    def reflector(self, pa_m, t):
        moon_m, moon_m_s = self.body(301, t)
        (phi, theta, psi), _ = self.series(self.pck.segments[0], t)

        def about(axis, angle):
            c, s = mp.cos(angle), mp.sin(angle)
            rows = [[c, s, 0], [-s, c, 0], [0, 0, 1]] if axis == "z" else [[1, 0, 0], [0, c, s], [0, -s, c]]
            return mp.matrix(rows)

        rotation = about("z", psi) * about("x", theta) * about("z", phi)
        place = rotation.T * mp.matrix([mpf(x) for x in pa_m])
        potential = self.gm("sun") / mp.norm(self.body(10, t)[0] - moon_m)
        potential += self.gm("earth") / mp.norm(self.body(399, t)[0] - moon_m)
        return moon_m + self.scaled(place, moon_m_s, potential, "lunar_scale", "lunar_lorentz")

    def value_m(self, transmitter_m, receiver_m, pa_m, tag, tt):
        """Whole path for a tag at one epoch of TT (the station's own, or the geocentre's for the bounce)."""
        c = mpf(C_M_S)
        tt_s = mpf(tt.jd[0] - 2451545.0) * 86400 + mpf(tt.fraction[0]) * 86400
        owner = {"transmit": transmitter_m, "receive": receiver_m}.get(tag)
        tdb_s = tt_s
        for _ in range(4):
            tdb_s = tt_s + (self.geocentric_s(tdb_s) if owner is None else self.station(owner, tdb_s)[1])
        up = down = mp.mpf("1.3")
        for _ in range(10):
            bounce = {"transmit": tdb_s + up, "receive": tdb_s - down, "bounce": tdb_s}[tag]
            there = self.reflector(pa_m, bounce)
            sent, up_tdb_tt = self.station(transmitter_m, bounce - up)
            back, down_tdb_tt = self.station(receiver_m, bounce + down)
            new_up, new_down = mp.norm(there - sent) / c, mp.norm(back - there) / c
            moved = abs(new_up - up) + abs(new_down - down)
            up, down = new_up, new_down
            if moved < mp.mpf("1e-17"):
                break
        flight = up + down
        if "tdb_tt" in self.terms:
            flight -= down_tdb_tt - up_tdb_tt
        return flight * c


CASES = [
    ("APOLLO", "APOLLO", "transmit", 2454040.5, 0.31),
    ("GRASSE", "GRASSE", "receive", 2460440.5, 0.77),
    ("KASHI", "JIAMUSI", "receive", 2459185.5, 0.62),
    ("NEUQUEN", "KASHI", "transmit", 2459186.5, 0.10),
    ("JIAMUSI", "NEUQUEN", "bounce", 2459187.5, 0.999),
]


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build()


@pytest.mark.parametrize(("sender", "receiver", "tag", "jd", "fraction"), CASES)
def test_path_against_40_digits(model, sender, receiver, tag, jd, fraction):
    fewer = model.without(*(set(TERMS) - {*GEOMETRIC_TERMS, "subdaily_eop"}))
    table = observations(f"{sender}>apollo15>{receiver}", Epochs.from_jd(jd, fraction, "TAI"), tag)
    ours_m = ExactPredictor(fewer, table, APOLLO15_PA_M).compute(APOLLO15_PA_M).value_m[0]
    catalogue = StationCatalogue.default()
    with mp.workdps(DIGITS):
        exact_m = FortyDigits(fewer.terms).value_m(
            catalogue[sender].itrf_m, catalogue[receiver].itrf_m, APOLLO15_PA_M, tag, utc_to_tt(table.epoch)
        )
        difference_m = float(mpf(ours_m) - exact_m)
    assert abs(difference_m) < FROM_40_DIGITS_M < GOAL_M


@pytest.mark.parametrize("tag", TIME_TAGS)
@pytest.mark.parametrize(("path", "spacing_s"), [("GRASSE>x>GRASSE", 0.01), ("APOLLO>x>GRASSE", 1.0)])
def test_successive_ranges_are_smooth(model, tag, path, spacing_s):
    """With all terms: what a polynomial of low order leaves of 101 ranges is noise."""
    count = 101
    tai = epochs_tai(count, spacing_s * (count - 1) / 3600.0, 2460310.5, 0.28)
    table = observations(path, tai, tag, **LASER)
    computed = ExactPredictor(model, table, APOLLO15_PA_M).compute(APOLLO15_PA_M)
    assert computed.usable.all()
    elapsed_s = tai.seconds_since(tai[np.zeros(count, dtype=int)])
    # Counted from the first, which is exact: a fit to 7.7e8 m itself is rounded by 1 to 20 micrometres, by how the
    # linear algebra of the day orders its sums. Over 100 s what a fourth order leaves is far below a micrometre.
    grown_m = computed.value_m - computed.value_m[0]
    noise_m = grown_m - np.polynomial.Polynomial.fit(elapsed_s, grown_m, 4)(elapsed_s)
    assert np.abs(noise_m).max() < ROUGHNESS_M < GOAL_M
