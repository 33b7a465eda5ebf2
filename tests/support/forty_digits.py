"""Model of a path in 40 digits, from barycentric vectors and the coefficients of the kernels.

The library works from the geocentre at the epoch of the observation, which avoids sums with 1.5e11 m; 40 digits permit
them. Chebyshev series, rotation of the Moon, light-time iteration and origin are independent of the library; TDB - TT
and the rotation of the Earth are those of ERFA.
"""

import erfa
import mpmath as mp

from radioloc.constants import C_M_S, L_B, L_G
from radioloc.earth.orientation import EarthOrientation
from radioloc.ephemeris import Ephemeris, LunarOrientation
from radioloc.time import Epochs

DIGITS = 40


def mpf(x):
    return mp.mpf(float(x))


class FortyDigits:
    """Model of a path from the barycentre of the solar system."""

    def __init__(self, terms):
        self.terms = terms
        self.spk = Ephemeris.open().spk
        self.pck = LunarOrientation.open().pck
        self.constants = Ephemeris.open().constants
        self.earth_orientation = EarthOrientation.default()

    @staticmethod
    def series(segment, t):
        """Return values and derivatives of the three components of a segment, in units of the file and seconds."""
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
        """Return the barycentric state, m and m/s."""
        centre = 0 if code == 10 else 3
        position, velocity = self.series(self.spk.segments_of(code, centre)[-1], t)
        if centre == 3:
            barycentre = self.series(self.spk.segments_of(3, 0)[-1], t)
            position, velocity = position + barycentre[0], velocity + barycentre[1]
        return 1000 * position, 1000 * velocity

    @staticmethod
    def epochs(t, scale):
        days = t / 86400 + mp.mpf("0.5")
        day = mp.floor(days)
        return Epochs.from_jd(2451544.5 + float(day), float(days - day), scale)

    def geocentric_s(self, t):
        tdb = self.epochs(t, "TDB")
        return mpf(erfa.dtdb(tdb.jd, tdb.fraction, 0.0, 0.0, 0.0, 0.0)[0])

    def scaled(self, vector, velocity, potential_m2_s2, scale, lorentz):
        """Return a length of a body in the barycentric frame."""
        c2 = mpf(C_M_S) ** 2
        scaled = vector.copy()
        if scale in self.terms:
            scaled -= vector * (potential_m2_s2 / c2 + mpf(L_B) - mpf(L_G))
        if lorentz in self.terms:
            scaled -= velocity * (velocity.T * vector)[0] / (2 * c2)
        return scaled

    def gm(self, name):
        return mpf(self.constants.gm_m3_s2(name))

    def station(self, itrf_m, t):
        """Return the barycentric place of a station and its TDB - TT, at TDB seconds t."""
        earth_m, earth_m_s = self.body(399, t)
        geocentric_s = self.geocentric_s(t)
        topocentric_s = mp.mpf(0)
        for _ in range(3):  # TT of the station determines the rotation of the Earth
            tt = self.epochs(t - geocentric_s - topocentric_s, "TT")
            rotation = self.earth_orientation.evaluate(tt)
            # Epochs are rounded to 1e-11 s, in which the Earth turns by 5e-9 m.
            place = mp.matrix(rotation.rot_itrf_to_gcrs[0].tolist()) * mp.matrix([mpf(x) for x in itrf_m])
            topocentric_s = (earth_m_s.T * place)[0] / mpf(C_M_S) ** 2
        potential = self.gm("sun") / mp.norm(self.body(10, t)[0] - earth_m)
        potential += self.gm("moon") / mp.norm(self.body(301, t)[0] - earth_m)
        offset_m = self.scaled(place, earth_m_s, potential, "earth_scale", "earth_lorentz")
        return earth_m + offset_m, geocentric_s + topocentric_s

    def reflector(self, pa_m, t):
        moon_m, moon_m_s = self.body(301, t)
        (phi, theta, psi), _ = self.series(self.pck.segments[0], t)

        def turn(axis, angle):
            c, s = mp.cos(angle), mp.sin(angle)
            rows = [[c, s, 0], [-s, c, 0], [0, 0, 1]] if axis == "z" else [[1, 0, 0], [0, c, s], [0, -s, c]]
            return mp.matrix(rows)

        rotation = turn("z", psi) * turn("x", theta) * turn("z", phi)
        place = rotation.T * mp.matrix([mpf(x) for x in pa_m])
        potential = self.gm("sun") / mp.norm(self.body(10, t)[0] - moon_m)
        potential += self.gm("earth") / mp.norm(self.body(399, t)[0] - moon_m)
        return moon_m + self.scaled(place, moon_m_s, potential, "lunar_scale", "lunar_lorentz")

    def value_m(self, transmitter_m, receiver_m, pa_m, tag, tt):
        """Return the path for a tag at one epoch of TT (of the station, or of the geocentre for the bounce)."""
        c = mpf(C_M_S)
        tt_s = mpf(tt.jd[0] - 2451545.0) * 86400 + mpf(tt.fraction[0]) * 86400
        owner = {"transmit": transmitter_m, "receive": receiver_m}.get(tag)
        tdb_s = tt_s
        for _ in range(4):
            tdb_s = tt_s + (self.geocentric_s(tdb_s) if owner is None else self.station(owner, tdb_s)[1])
        up = down = mp.mpf("1.3")
        for _ in range(10):
            bounce = {"transmit": tdb_s + up, "receive": tdb_s - down, "bounce": tdb_s}[tag]
            reflector_m = self.reflector(pa_m, bounce)
            sent_m, up_tdb_tt = self.station(transmitter_m, bounce - up)
            received_m, down_tdb_tt = self.station(receiver_m, bounce + down)
            new_up, new_down = mp.norm(reflector_m - sent_m) / c, mp.norm(received_m - reflector_m) / c
            moved = abs(new_up - up) + abs(new_down - down)
            up, down = new_up, new_down
            if moved < mp.mpf("1e-17"):
                break
        flight = up + down
        if "tdb_tt" in self.terms:
            flight -= down_tdb_tt - up_tdb_tt
        return flight * c
