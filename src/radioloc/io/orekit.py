"""Measurement objects and propagators of Orekit, by ``orekit_jpype``, from observations and orbits, and back.

The Java machine must run (``orekit_jpype.initVM()``) and Orekit must have its data; nothing is downloaded here.
Values of Orekit are light times without tides, media and relativity, which its modifiers add. ``Range`` of two ways is
half of the round trip, ``BistaticRange`` the length up and down, ``TDOA`` the arrival at the prime station less that
at the second.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import floor
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.constants import C_M_S, J2000_JD, SECONDS_PER_DAY
from radioloc.dynamics import Orbit
from radioloc.earth import StationCatalogue, geodetic_from_itrf
from radioloc.errors import InputError
from radioloc.io.ccsds import write_orbit_oem
from radioloc.lazy import optional
from radioloc.measurements import Link, Observations
from radioloc.measurements.registry import KINDS, TIME_TAGS
from radioloc.text_files import scratch_folder
from radioloc.time import Epochs, tai_to_utc, utc_to_tt
from radioloc.time.scales import tt_to_tai

_ATTOSECONDS = 10**18  # in a second


def to_orekit(item: Observations | Orbit, catalogue: StationCatalogue | None = None) -> Any:
    """Return observations as a list of Orekit's measurements, or an orbit as its ``BoundedPropagator``.

    Parameters
    ----------
    item : Observations or Orbit
        Ranges (two- or three-way) and VLBI delays; or an orbit about the Moon. Satellites are numbered in the order of
        the targets.
    catalogue : StationCatalogue, optional
        Stations; by default those of the package. A station stands where it is at the mean epoch of its list.

    Raises
    ------
    InputError
        Orekit has no measurement of the type (counted Doppler, differences), or orekit_jpype is not installed.

    Examples
    --------
    >>> import radioloc
    >>> ranges = radioloc.read_observations("examples/change5/change5.csv").select(slice(0, 2))
    >>> [str(item.getMeasurementType()) for item in radioloc.io.to_orekit(ranges)]  # doctest: +SKIP
    ['Range', 'BistaticRange']
    """
    _require_orekit("to_orekit")
    if isinstance(item, Orbit):
        return _propagator(item)
    for kind in {KINDS[code] for code in np.unique(item.kind)} - {"range", "vlbi_delay"}:
        raise InputError(
            f"to_orekit: expected types range and vlbi_delay, got {kind}; use radioloc.io.write_tdm for the others"
        )
    return list(_measurements(item, catalogue or StationCatalogue.default()))


def from_orekit(measurements: Iterable[Any]) -> Observations:
    """Return observations from Orekit's two-way ``Range``, ``BistaticRange`` and ``TDOA``.

    Raises
    ------
    InputError
        A measurement is of another type, the list is empty, or orekit_jpype is not installed.

    Examples
    --------
    >>> import radioloc
    >>> radioloc.io.from_orekit(radioloc.io.to_orekit(ranges))  # doctest: +SKIP
    <Observations 2 2020-12-01 to 2020-12-01>
    """
    _require_orekit("from_orekit")
    rows = [_row(item) for item in measurements]
    if not rows:
        raise InputError("from_orekit: expected measurements, got none")
    paths, kinds, values_m, sigmas_m, seconds, remainders_s = zip(*rows, strict=True)
    days, seconds_of_day = np.divmod(np.array(seconds), int(SECONDS_PER_DAY))
    tt = Epochs.from_jd(J2000_JD + days, (seconds_of_day + np.array(remainders_s)) / SECONDS_PER_DAY, "TT")
    return Observations.from_columns(
        epoch=tai_to_utc(tt_to_tai(tt)),
        links=paths,
        link=np.arange(len(rows)),
        kind=kinds,
        tag="receive",
        value_m=values_m,
        sigma_m=sigmas_m,
    )


def _require_orekit(function: str) -> None:
    optional("orekit_jpype", f"{function}:", "bench")
    if not optional("jpype", f"{function}:", "bench").isJVMStarted():
        raise InputError(
            f"{function}: expected a running Java machine; call orekit_jpype.initVM() and load Orekit's data"
        )


def _measurements(observations: Observations, catalogue: StationCatalogue) -> Iterator[Any]:
    from org.orekit.estimation.measurements import TDOA, BistaticRange, ObservableSatellite, Range

    tt = utc_to_tt(observations.epoch)
    stations = _stations(observations, catalogue)
    targets = dict.fromkeys(link.target for link in observations.links)
    satellites = {name: ObservableSatellite(k, name) for k, name in enumerate(targets)}
    is_receive = observations.tag == TIME_TAGS.index("receive")
    if (observations.tag == TIME_TAGS.index("bounce")).any():
        raise InputError("to_orekit: expected time tags of transmission or reception, got bounce")
    # A range is the interval of the station's clock from the transmission to the reception.
    delays_s = np.where(is_receive, 0.0, observations.value_m / C_M_S)
    links = [observations.links[code] for code in observations.link]
    columns = (links, tt.jd, tt.fraction, delays_s, observations.value_m, observations.sigma_m)
    for link, jd, fraction, delay_s, value_m, sigma_m in zip(*columns, strict=True):
        date, satellite = _date(jd, fraction, delay_s), satellites[link.target]
        first, last = stations[link.transmitter], stations[link.receiver]
        if link.differenced:  # the signs of the values are opposite
            yield TDOA(first, last, date, -value_m / C_M_S, sigma_m / C_M_S, 1.0, satellite)
        elif link.transmitter == link.receiver:
            yield Range(last, True, date, value_m / 2.0, sigma_m / 2.0, 1.0, satellite)
        else:
            yield BistaticRange(first, last, date, value_m, sigma_m, 1.0, satellite)


def _stations(observations: Observations, catalogue: StationCatalogue) -> dict[str, Any]:
    """Return ground stations by name, at the mean epoch."""
    from org.orekit.bodies import GeodeticPoint, OneAxisEllipsoid
    from org.orekit.estimation.measurements import GroundStation
    from org.orekit.frames import FramesFactory, TopocentricFrame
    from org.orekit.utils import Constants, IERSConventions

    shape = Constants.GRS80_EARTH_EQUATORIAL_RADIUS, Constants.GRS80_EARTH_FLATTENING
    earth = OneAxisEllipsoid(*shape, FramesFactory.getITRF(IERSConventions.IERS_2010, False))
    tt = utc_to_tt(observations.epoch)
    stations = {}
    for name in {name for link in observations.links for name in (link.transmitter, link.receiver)}:
        place = geodetic_from_itrf(catalogue.get(name).position_at(tt).mean(axis=0))
        point = GeodeticPoint(float(place.latitude_rad), float(place.longitude_rad), float(place.height_m))
        stations[name] = GroundStation(TopocentricFrame(earth, point, name))
    return stations


def _date(jd: float, fraction: float, delay_s: float) -> Any:
    """Return Orekit's date, which has integers of seconds and attoseconds, some seconds after an epoch of TT."""
    from org.orekit.time import AbsoluteDate, TimeOffset

    seconds = round((jd - J2000_JD) * SECONDS_PER_DAY)
    remainder_s = fraction * SECONDS_PER_DAY + delay_s
    whole_s = floor(remainder_s)
    offset = TimeOffset(seconds + whole_s, int((remainder_s - whole_s) * _ATTOSECONDS))
    return AbsoluteDate(AbsoluteDate.J2000_EPOCH, offset)


def _row(item: Any) -> tuple[Link, str, float, float, int, float]:
    """Return link, type, value and sigma, m, and the time of reception, TT, in seconds and a remainder since J2000."""
    from org.orekit.time import AbsoluteDate

    target = str(item.getSatellites().get(0).getName())
    value, sigma = float(item.getObservedValue()[0]), float(item.getTheoreticalStandardDeviation()[0])
    kind = str(item.getMeasurementType())
    if kind == "TDOA":
        first, last = item.getPrimeStation(), item.getSecondStation()
        value, sigma = -value * C_M_S, sigma * C_M_S
    elif kind == "BistaticRange":
        first, last = item.getEmitterStation(), item.getReceiverStation()
    elif kind == "Range" and item.isTwoWay():
        first = last = item.getStation()
        value, sigma = 2.0 * value, 2.0 * sigma
    else:
        raise InputError(f"from_orekit: expected two-way Range, BistaticRange or TDOA, got {kind}")
    names = [str(station.getBaseFrame().getName()) for station in (first, last)]
    elapsed = item.getDate().accurateDurationFrom(AbsoluteDate.J2000_EPOCH)
    link = Link(names[0], target, names[1], kind == "TDOA")
    time = int(elapsed.getSeconds()), elapsed.getAttoSeconds() / _ATTOSECONDS
    return link, "vlbi_delay" if kind == "TDOA" else "range", value, sigma, *time


def _propagator(orbit: Orbit) -> Any:
    """Return the orbit as Orekit interpolates its ephemeris message."""
    from org.orekit.data import DataSource
    from org.orekit.files.ccsds.ndm import ParserBuilder

    with scratch_folder() as folder:
        path = write_orbit_oem(Path(folder) / "orbit.oem", orbit, originator="radioloc")
        message = ParserBuilder().buildOemParser().parseMessage(DataSource(str(path)))
    [ephemeris] = message.getSatellites().values()
    return ephemeris.getPropagator()
