"""Lists of radio sources, and their place in the model."""

import numpy as np
import pytest
from arc_cases import observations
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from reader_cases import ICRF, SOURCES

from radioloc.constants import ARCSEC_RAD
from radioloc.errors import FileFormatError, InputError
from radioloc.measurements import FixedPoint, PhysicalModel, prepare_predictor, read_sources
from radioloc.measurements.sources import with_galactic_aberration
from radioloc.time import Epochs

SITE_M = np.array([1.7e6, 0.0, 0.0])
TAI = Epochs.from_jd(2459185.5, np.linspace(0.0, 1.0, 25), "TAI")


def written(tmp_path, text):
    path = tmp_path / "sources.txt"
    path.write_text(text)
    return path


def test_the_same_sources_of_a_table_and_of_the_icrf(tmp_path):
    table, icrf = (read_sources(written(tmp_path, text)) for text in (SOURCES, ICRF))
    assert set(table) == {"0059+581", "1741-038"}
    assert set(icrf) == set(table) | {"j010245.7+582411", "j174358.8-035004"}
    for name, direction in table.items():
        expected = SkyCoord(
            "01h02m45.7623824s +58d24m11.136605s" if name[0] == "0" else "17h43m58.8561335s -03d50m04.616675s"
        )
        xyz = expected.cartesian.xyz.value
        assert np.abs(icrf[name] - xyz).max() < 1e-15
        assert np.abs(direction - xyz).max() < 1e-8  # a milliarcsecond in the table's digits


def test_a_small_declination_keeps_its_sign(tmp_path):
    text = "ICRF J000000.0-003000 2357-008 00 00 00.00000000 -00 30 00.0000000 0.00003337 0.0009246\n"
    assert read_sources(written(tmp_path, text))["2357-008"][2] == pytest.approx(-np.sin(np.radians(0.5)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("source,ra\nx,1.0\n", "lines of the ICRF, or .* columns source,right_ascension_deg,declination_deg"),
        (SOURCES + "a,40.0\n", "line 4"),
        (ICRF + "ICRF J174358.8-035004   1741-038   D    17 43\n", "line 4"),
    ],
)
def test_invalid_tables_of_sources(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        read_sources(written(tmp_path, text))


def test_galactic_aberration_is_5_8_microarcseconds_a_year():
    """Towards the centre of the Galaxy, most of it for sources 90 degrees from there, none for the centre itself."""
    centre = SkyCoord(l=0.0 * u.deg, b=0.0 * u.deg, frame="galactic").icrs.cartesian.xyz.value
    pole = SkyCoord(l=0.0 * u.deg, b=90.0 * u.deg, frame="galactic").icrs.cartesian.xyz.value
    tdb = Epochs.from_jd([2457023.5 + 3652.5] * 2, 0.0, "TDB")
    moved = with_galactic_aberration(np.array([pole, centre]), tdb) - [pole, centre]
    assert moved[0] @ centre / ARCSEC_RAD == pytest.approx(58e-6, rel=1e-4)
    assert np.abs(moved[1]).max() < 1e-3 * 58e-6 * ARCSEC_RAD


def arc_of(path, kind="vlbi_delay"):
    model = PhysicalModel.build(sources={"1741-038": _direction("1741-038")}, off=["troposphere"])
    return prepare_predictor(model, observations(path, TAI, "receive", kind), FixedPoint(SITE_M), "exact")


def _direction(name):
    place = {"1741-038": (265.9952338, -3.8346158)}[name]
    return SkyCoord(*place, unit="deg").cartesian.xyz.value


@pytest.mark.study
def test_elevation_is_that_of_astropy():
    arc = arc_of("SESHAN25<1741-038>KASHI")
    for end, name in enumerate(("SESHAN25", "KASHI")):
        location = EarthLocation.from_geocentric(*arc.model.catalogue[name].itrf_m, unit="m")
        frame = AltAz(obstime=TAI.to_time(), location=location)
        expected_rad = SkyCoord(265.9952338, -3.8346158, unit="deg").transform_to(frame).alt.rad
        # Diurnal aberration, 0.3 arcseconds, is not in the model's elevations.
        assert np.abs(arc.compute().elevation_rad[:, end] - expected_rad).max() < 2e-6
    # Delays with the source below the horizon are unusable.
    computed = arc.compute()
    assert (computed.usable == (computed.elevation_rad > 0.0).all(axis=1)).all()
    assert 0 < computed.usable.sum() < len(TAI)


def test_ranges_to_sources_are_refused():
    with pytest.raises(InputError, match="KASHI>1741-038>KASHI"):
        arc_of("KASHI>1741-038>KASHI", "range")


def test_partials_by_position_are_zero():
    assert not arc_of("SESHAN25<1741-038>KASHI").compute().by_position_pa.any()
