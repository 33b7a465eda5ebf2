"""Constants that belong to one ephemeris: masses, lunar Love numbers, angles from principal to mean-Earth axes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EphemerisConstants:
    """Constants of one ephemeris, TDB-compatible.

    Parameters
    ----------
    name : str
        Such as ``DE421``.
    gm_sun_m3_s2, gm_earth_m3_s2, gm_moon_m3_s2 : float
        GM of the Sun, the Earth and the Moon, m^3/s^2.
    gm_venus_m3_s2, gm_jupiter_m3_s2, gm_saturn_m3_s2 : float
        GM of Venus and of the systems of Jupiter and Saturn, m^3/s^2.
    h2, l2 : float
        Degree-2 displacement Love numbers of the Moon, radial and tangential.
    pa_to_me_arcsec : tuple of float
        Angles (about x, y, z) of the rotation from principal to mean-Earth axes, arcsec:
        ME = Rx(x) Ry(y) Rz(z) PA, each a rotation of the axes.
    me_frame : str
        The mean-Earth axes that the angles lead to.
    """

    name: str
    gm_sun_m3_s2: float
    gm_earth_m3_s2: float
    gm_moon_m3_s2: float
    gm_venus_m3_s2: float
    gm_jupiter_m3_s2: float
    gm_saturn_m3_s2: float
    h2: float
    l2: float
    pa_to_me_arcsec: tuple[float, float, float]
    me_frame: str

    def gm_m3_s2(self, body: str) -> float:
        """GM of ``"sun"``, ``"earth"``, ``"moon"``, ``"venus"``, ``"jupiter"`` or ``"saturn"``, m^3/s^2."""
        return float(getattr(self, f"gm_{body}_m3_s2"))


CONSTANTS = {
    c.name: c
    for c in (
        EphemerisConstants(
            name="DE421",
            gm_sun_m3_s2=132712440040.944e9,
            gm_earth_m3_s2=398600.436233e9,
            gm_moon_m3_s2=4902.800076e9,
            gm_venus_m3_s2=324858.592e9,
            gm_jupiter_m3_s2=126712764.8e9,
            gm_saturn_m3_s2=37940585.2e9,
            h2=0.0379,
            l2=0.0105,
            pa_to_me_arcsec=(-0.30, -78.56, -67.92),
            me_frame="ME_DE421",
        ),
        EphemerisConstants(
            name="DE430",
            gm_sun_m3_s2=132712440041.9394e9,
            gm_earth_m3_s2=398600.435436e9,
            gm_moon_m3_s2=4902.800066e9,
            gm_venus_m3_s2=324858.592e9,
            gm_jupiter_m3_s2=126712764.8e9,
            gm_saturn_m3_s2=37940585.2e9,
            h2=0.048,
            l2=0.0107,
            pa_to_me_arcsec=(-0.285, -78.580, -67.573),
            me_frame="ME_DE430",
        ),
        EphemerisConstants(
            name="DE440",
            gm_sun_m3_s2=132712440041.279419e9,
            gm_earth_m3_s2=398600.435507e9,
            gm_moon_m3_s2=4902.800118e9,
            gm_venus_m3_s2=324858.592e9,
            gm_jupiter_m3_s2=126712764.1e9,
            gm_saturn_m3_s2=37940584.8418e9,
            h2=0.0424,
            l2=0.0107,
            pa_to_me_arcsec=(-0.2785, -78.6944, -67.8526),
            me_frame="ME_DE421",
        ),
    )
}
"""Constants by ephemeris name."""
