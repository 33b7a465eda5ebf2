"""Constants that belong to one ephemeris: masses, Love numbers, angles from principal to mean-Earth axes.

Sources
-------
DE421
    Masses: Folkner, Williams and Boggs (2009), IPN Progress Report 42-178, and the ephemeris' header. Angles:
    Williams, Boggs and Folkner (2008), JPL IOM 335-JW,DB,WF-20080314-001, as in NAIF's moon_080317.tf.
DE430
    Masses: Folkner, Williams, Boggs, Park and Kuchynka (2014), IPN Progress Report 42-196, table 8. Angles:
    the same, and Williams, Boggs and Folkner (2013), JPL IOM 335-JW,DB,WF-20130722-016.
DE440
    Masses and angles: Park, Folkner, Williams and Boggs (2021), Astron. J. 161, 105, as in the ephemeris'
    header and NAIF's moon_de440_220930.tf. These angles lead to the mean-Earth axes of DE421, to which lunar
    maps refer.
Love numbers
    A reflector's published position goes with the tide it was fitted with, so DE421 keeps the pair that its lunar
    solution is quoted with, h2 = 0.0379 and l2 = 0.0105. DE430 and DE440 have the model of Williams et al. (2014), J.
    Geophys. Res. Planets 119, 1546. Fits to laser ranges and altimetry spread over h2 = 0.037 to 0.048, 0.14 m of the
    constant and 0.04 m of the variable tide under the Earth. To use others:
    ``dataclasses.replace(constants, h2=..., l2=...)``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from radioloc.errors import InputError

_MASSIVE = ("sun", "earth", "moon", "venus", "jupiter", "saturn")


@dataclass(frozen=True, slots=True)
class EphemerisConstants:
    """Constants of one ephemeris, TDB-compatible."""

    name: str  #: such as DE421
    gm_sun_m3_s2: float
    gm_earth_m3_s2: float
    gm_moon_m3_s2: float
    gm_venus_m3_s2: float
    gm_jupiter_m3_s2: float  #: of the planet with its moons, as Saturn's
    gm_saturn_m3_s2: float
    pa_to_me_arcsec: tuple[float, float, float]  #: about x, y, z: ME = Rx(x) Ry(y) Rz(z) PA, of the axes
    me_frame: str  #: the mean-Earth axes that the angles lead to
    h2: float  #: degree-2 displacement Love number, radial
    l2: float  #: and tangential

    def gm_m3_s2(self, body: str) -> float:
        """Return the GM of a body, m^3/s^2."""
        if body not in _MASSIVE:
            raise InputError(f"body: expected one of {', '.join(_MASSIVE)}, got {body!r}")
        return float(getattr(self, f"gm_{body}_m3_s2"))


_DE421 = EphemerisConstants(
    name="DE421",
    gm_sun_m3_s2=132712440040.944e9,
    gm_earth_m3_s2=398600.436233e9,
    gm_moon_m3_s2=4902.800076e9,
    gm_venus_m3_s2=324858.592e9,
    gm_jupiter_m3_s2=126712764.8e9,
    gm_saturn_m3_s2=37940585.2e9,
    pa_to_me_arcsec=(-0.30, -78.56, -67.92),
    me_frame="ME_DE421",
    h2=0.0379,
    l2=0.0105,
)
_DE430 = replace(
    _DE421,
    name="DE430",
    gm_sun_m3_s2=132712440041.9394e9,
    gm_earth_m3_s2=398600.435436e9,
    gm_moon_m3_s2=4902.800066e9,
    pa_to_me_arcsec=(-0.285, -78.580, -67.573),
    me_frame="ME_DE430",
    h2=0.0424,
    l2=0.0107,
)
_DE440 = replace(
    _DE430,
    name="DE440",
    gm_sun_m3_s2=132712440041.279419e9,
    gm_earth_m3_s2=398600.435507e9,
    gm_moon_m3_s2=4902.800118e9,
    gm_jupiter_m3_s2=126712764.1e9,
    gm_saturn_m3_s2=37940584.8418e9,
    pa_to_me_arcsec=(-0.2785, -78.6944, -67.8526),
    me_frame="ME_DE421",
)
CONSTANTS = {constants.name: constants for constants in (_DE421, _DE430, _DE440)}
"""Constants by the ephemeris' name."""
