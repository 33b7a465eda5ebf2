"""Named terms of the measurement model.

A study switches terms off with ``[model] off = [...]``. A table of terms has the effect of each term on each computed
value.
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
        "station_proper_time": "rate of free-running clocks of stations by their heights",
        "target_proper_time": "rate of the target's clock by its speed and gravity, one-way",
        "troposphere": MEDIA["troposphere"].description,
        "ionosphere": MEDIA["ionosphere"].description,
        "transponder_delay": "delay of the target's transponder, if stated",
        "station_delay": "delay of the stations' equipment between clock and reference point, if stated",
        "antenna_axis_offset": MEDIA["antenna_axis_offset"].description,
        "solid_earth_tide": "displacement of the stations by the solid Earth tide",
        "pole_tide": "displacement of the stations by the solid Earth pole tide",
        "ocean_loading": "displacement of the stations by ocean tide loading",
        "tidal_geocentre": "motion of the stations with the solid Earth about the centre of mass, by the ocean tides",
        "station_velocity": "motion of the stations since the epoch of their coordinates",
        "subdaily_eop": "diurnal and semidiurnal ocean tides and libration in pole and UT1",
        "earth_scale": "scale (TT to TDB, solar potential) of geocentric station positions in the barycentric frame",
        "earth_lorentz": "Lorentz contraction of geocentric station positions along the Earth's velocity",
        "lunar_tide": "displacement of the point on the Moon by the solid tide of Earth and Sun",
        "lunar_tide_constant": "the constant part of that tide",
        "lunar_scale": "scale of positions on the Moon in the barycentric frame, as for the Earth",
        "lunar_lorentz": "Lorentz contraction of the point's position along the Moon's velocity",
    }
    return terms | {name: medium.description for name, medium in MEDIA.items() if name not in terms}


TERMS: Mapping[str, str] = DerivedMapping(_terms)
"""Names and descriptions of terms."""


def active_terms(off: Iterable[str] = ()) -> frozenset[str]:
    """Return the names of :data:`TERMS` without some."""
    off, terms = list(off), tuple(TERMS)
    for name in off:
        if name not in terms:
            matches = difflib.get_close_matches(name, terms, n=1)
            hint = f" (did you mean {matches[0]!r}?)" if matches else ""
            raise InputError(f"term of the model: expected one of {', '.join(terms)}, got {name!r}{hint}")
    return frozenset(terms) - frozenset(off)
