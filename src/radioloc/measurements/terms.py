"""The named terms of the measurement model: what can be left out, and what that means.

A study leaves terms out with ``[model] off = [...]``; a table of terms gives, for each observation, how much each
term changes the computed value.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

from radioloc.errors import InputError
from radioloc.media import MEDIA
from radioloc.plugins import DerivedMapping


def _terms() -> dict[str, str]:
    terms = {
        "shapiro": "gravitational delay by the Sun, the Earth, the Moon and the planets",
        "tdb_tt": "difference of TDB - TT between the ends of the light path",
        "galactic_aberration": "motion of quasars since 2015.0 by the solar system's acceleration in the Galaxy",
        "station_proper_time": "rate of the stations' clocks by their heights, where they are said to run free",
        "target_proper_time": "rate of the target's own clock by its speed and by gravity where it is, one-way",
        "troposphere": MEDIA["troposphere"].description,
        "ionosphere": MEDIA["ionosphere"].description,
        "transponder_delay": "time for which the point's transponder holds the signal, where one is given",
        "station_delay": "delay in the stations' equipment between clock and reference point, where one is given",
        "antenna_axis_offset": MEDIA["antenna_axis_offset"].description,
        "solid_earth_tide": "displacement of the stations by the solid Earth tide",
        "pole_tide": "displacement of the stations by the solid Earth pole tide",
        "ocean_loading": "displacement of the stations by ocean tide loading",
        "tidal_geocentre": "motion of the stations with the solid Earth about the centre of mass, by the ocean tides",
        "station_velocity": "motion of the stations since the epoch of their coordinates",
        "subdaily_eop": "diurnal and semidiurnal ocean tides and libration in pole and UT1",
        "earth_scale": "scale (TT to TDB, solar potential) of geocentric station positions seen from the barycentre",
        "earth_lorentz": "Lorentz contraction of geocentric station positions along the Earth's velocity",
        "lunar_tide": "displacement of the point on the Moon by the solid tide of Earth and Sun",
        "lunar_tide_constant": "the constant part of that tide",
        "lunar_scale": "scale of positions on the Moon, as for the Earth, seen from the barycentre",
        "lunar_lorentz": "Lorentz contraction of the point's position along the Moon's velocity",
    }
    return terms | {name: medium.description for name, medium in MEDIA.items() if name not in terms}


TERMS: Mapping[str, str] = DerivedMapping(_terms)
"""Term names and what each stands for."""


def active_terms(off: Iterable[str] = ()) -> frozenset[str]:
    """Return the terms of the model, :data:`TERMS`, that remain when some are left out."""
    off, terms = list(off), tuple(TERMS)
    for name in off:
        if name not in terms:
            near = difflib.get_close_matches(name, terms, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise InputError(f"{name!r} is not a term of the model{hint}; the terms are {', '.join(terms)}")
    return frozenset(terms) - frozenset(off)
