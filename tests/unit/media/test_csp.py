"""Media calibrations of the Deep Space Network: the cards, and what they do to radio paths."""

import math

import numpy as np
import pytest
from arc_cases import APOLLO15
from legs import end, leg

from radioloc import Observations
from radioloc.constants import C_M_S
from radioloc.earth import StationCatalogue, geodetic_from_itrf
from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.measurements import ExactPredictor, Link, PhysicalModel
from radioloc.measurements.registry import KINDS
from radioloc.media.csp import DRY, WET, read_csp
from radioloc.media.ionosphere import Ionosphere, UniformTec
from radioloc.media.neutral_atmosphere import standard_weather, zenith_hydrostatic_delay_m
from radioloc.media.radio_atmosphere import air_above
from radioloc.media.status import Status
from radioloc.time import epochs_from_strings, utc_to_tt

PRINTED_M = 1e-12
"""Rounding of sums of some metres; epochs of MJD are known to a microsecond, in which polynomials change by less."""
LEVER_M = 1e-5
"""A delay of metres moves the events by nanoseconds, and the rest of the path changes by less than this."""

# The span of the first is that of a real card; line breaks, comments and the lack of spaces are as in archives.
ION = """\
CCSD3ZF0000100000001NJPL3KS0L015$$MARK$$
ADJUST(DOPRNG)BY NRMPOW(   0.7048,   0.0938,   0.8502,  -0.2993,   1.0217,
   0.0260)                                                         MODEL(CHPART)
FROM(20/12/02,01:21)TO(20/12/02,15:01)DSN(C10)SCID(177).    #S20 ADJ 201203 11:19
# a comment with ADJUST( in it
ADJUST(DOPPLER) BY DNRMPOW(-.5, 1.) MODEL(CHPART) FROM(20/12/02,15:01:00.001)
TO(20/12/02,20:00:00) DSN(14,24) SCID(177).
ADJUST(RANGE) BY CNSTNT(3.0) MODEL(CHPART) FROM(20/12/02,15:01:00) TO(20/12/02,20:00:00) DSN(24) SCID(177).
ADJUST(VLBI) BY CONST(99.0) MODEL(CHPART) FROM(20/12/02,00:00) TO(20/12/03,00:00) DSN(C10) QUASAR(5).
"""
COEFFICIENTS = (0.7048, 0.0938, 0.8502, -0.2993, 1.0217, 0.0260)
TRO = """\
ADJUST(ALL) BY NRMPOW(-.0048, .0077, .0238, -.0872) MODEL(WET NUPART)
  FROM(20/12/02,12:00:00.001) TO(20/12/02,18:00:00) DSN(C10).
ADJUST(ALL) BY
NRMPOW(.0018, .0039) MODEL(DRY
NUPART) FROM(20/12/02,12:00:00.001) TO(20/12/02,18:00:00) DSN(C10).
ADJUST(ALL) BY CONST(.01) MODEL(DRY NUPART) FROM(20/12/02,18:00:00.001) TO(20/12/02,20:00:00) DSN(C10).
"""
DSS_24, KASHI = (StationCatalogue.default()[name] for name in ("DSS-24", "KASHI"))


@pytest.fixture
def calibrations(tmp_path):
    """Reads texts as files of their own."""

    def reader(*texts, **given):
        paths = [tmp_path / f"{k}.csp" for k in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return read_csp(paths, **given)

    return reader


def utc(*times, day="2020-12-02"):
    return epochs_from_strings([f"{day}T{time}" for time in times], "UTC")


def test_normalized_powers_go_from_minus_one_to_one(calibrations):
    cards = calibrations(ION)
    hours = np.array([1.35, 3.0, 8.0 + 11 / 60, 15.0])
    delay_m, rate_m_s = cards.charged(DSS_24, utc("01:21:00", "03:00:00", "08:11:00", "15:00:00"), phase=True)
    x = (hours - (1.35 + 15 + 1 / 60) / 2) / ((15 + 1 / 60 - 1.35) / 2)
    by_hand_m = sum(c * x**k for k, c in enumerate(COEFFICIENTS))
    assert delay_m == pytest.approx(by_hand_m, abs=1e-9)
    slope = sum(k * c * x ** (k - 1) for k, c in enumerate(COEFFICIENTS) if k)
    assert rate_m_s == pytest.approx(slope / (0.5 * (15 + 1 / 60 - 1.35) * 3600), rel=1e-9)


def test_cards_are_of_codes_or_phases_and_the_later_one_counts(calibrations):
    cards = calibrations(ION)
    late = utc("17:30:30")
    assert cards.charged(DSS_24, late, phase=False).tolist() == [[3.0], [0.0]]
    assert cards.charged(DSS_24, late, phase=True)[0] == pytest.approx(-0.5, abs=1e-6)
    later = "ADJUST(ALL) BY CONST(7.0) MODEL(CHPART) FROM(20/12/02,17:00) TO(20/12/02,18:00) DSN(C10)."
    both = calibrations(ION, later)
    assert both.charged(DSS_24, utc("17:30:30", "19:00:00"), phase=False)[0].tolist() == [7.0, 3.0]
    assert cards.charged(KASHI, late, phase=True) is None


def test_a_day_can_end_at_24_hours(calibrations):
    card = "ADJUST(ALL) BY NRMPOW(1.0, 0.5) MODEL(CHPART) FROM(20/12/02,20:00) TO(20/12/02,24:00:00.000) DSN(C10)."
    assert calibrations(card).cards[0].stop_mjd == 59186.0  # 2020-12-03


def test_fourier_terms_count_from_the_start_in_seconds(calibrations):
    card = (
        "ADJUST(ALL) BY TRIG(7200., 2.1, .1, -.2, .03, .04) MODEL(DRY NUPART) FROM(20/12/02,00:00) DSN(C10)."
    )
    found_m = calibrations(card).zenith_m(DSS_24, utc("00:00:00", "00:15:00", "01:10:00"), DRY, phase=True)
    angles = [2.0 * math.pi * t / 7200.0 for t in (0.0, 900.0, 4200.0)]
    by_hand_m = [
        2.1 + 0.1 * math.cos(x) - 0.2 * math.sin(x) + 0.03 * math.cos(2 * x) + 0.04 * math.sin(2 * x)
        for x in angles
    ]
    assert found_m == pytest.approx(by_hand_m, abs=1e-7)  # MJD, some microseconds of two hours


@pytest.mark.parametrize("name", ["DSS-24", "DSS-34", "DSS-54"])
def test_the_seasonal_model_is_that_of_the_place(name, calibrations):
    """Of dry air the standard atmosphere's, to 20 hPa; of wet air 2 to 17 cm, more in the summer of the hemisphere.

    Sea-level pressure is some hPa above the standard's, and each model is for a height of its own in the complex.
    """
    station = StationCatalogue.default()[name]
    place = geodetic_from_itrf(station.itrf_m)
    complex_of = {"2": "C10", "3": "C40", "5": "C60"}[name[4]]
    nothing = "ADJUST(ALL) BY CONST(0.) MODEL({}) FROM(20/01/01,00:00) TO(21/01/01,00:00) DSN({})."
    cards = calibrations(*(nothing.format(model, complex_of) for model in (DRY, WET)))
    dates = epochs_from_strings(["2020-01-20", "2020-07-20"], "UTC")
    dry_m, wet_m = (cards.zenith_m(station, dates, model, phase=True) for model in (DRY, WET))
    standard_m = zenith_hydrostatic_delay_m(
        standard_weather(place.height_m)[0], place.latitude_rad, place.height_m
    )
    assert dry_m == pytest.approx(float(standard_m), abs=0.045)
    assert ((wet_m > 0.02) & (wet_m < 0.17)).all()
    assert (wet_m[1] > wet_m[0]) == (place.latitude_rad > 0)


def test_corrections_are_added_to_the_seasonal_model_of_the_files_or_to_ours(calibrations):
    seasonal = "ADJUST(ALL) BY TRIG(31557600., 2., 0., 0.) MODEL(DRY NUPART) FROM(20/01/01,00:00) DSN(C10)."
    noon = utc("15:00:00", "17:59:59", "19:00:00")
    with_theirs_m = calibrations(seasonal, TRO).zenith_m(DSS_24, noon, DRY, phase=True)
    assert with_theirs_m == pytest.approx([2.0018, 2.0018 + 0.0039 * (1 - 1 / 10800), 2.01], abs=1e-7)
    ours = "ADJUST(ALL) BY CONST(0.) MODEL(DRY NUPART) FROM(20/12/02,00:00) TO(20/12/03,00:00) DSN(C10)."
    base_m = calibrations(ours).zenith_m(DSS_24, noon, DRY, phase=True)
    found_m = calibrations(TRO).zenith_m(DSS_24, noon, DRY, phase=True)
    assert found_m - base_m == pytest.approx(with_theirs_m - 2.0, abs=1e-12)


@pytest.mark.parametrize("time", ["11:59:50", "20:00:02"])
def test_an_epoch_without_a_card_is_an_error(time, calibrations):
    cards = calibrations(TRO)
    with pytest.raises(CoverageError, match=r"MODEL\(DRY NUPART\) for DSS-24 covers 2020-12-02T12:00:00"):
        cards.zenith_m(DSS_24, utc("15:00:00", time), DRY, phase=True)
    # Between cards that follow each other some milliseconds are no gap, minutes are.
    assert np.isfinite(cards.zenith_m(DSS_24, utc("18:00:00.0005"), DRY, phase=True)).all()
    gap = calibrations(TRO.replace("18:00:00.001", "18:05:00"))
    with pytest.raises(CoverageError, match=r"for DSS-24, which has gaps, .* got 2020-12-02T18:02:00"):
        gap.zenith_m(DSS_24, utc("18:02:00"), DRY, phase=True)


def test_cards_of_several_spacecraft_want_a_number(calibrations):
    other = ION.replace("0.7048", "0.1").replace("SCID(177)", "SCID(85)")
    noon = utc("08:11:00")
    with pytest.raises(InputError, match=r"spacecraft 85, 177; say which, \[model\] csp_scid"):
        calibrations(ION, other)
    assert calibrations(ION, other, scid=177).charged(DSS_24, noon, phase=True)[0] == pytest.approx(0.7048)
    assert calibrations(ION, other, scid=85).charged(DSS_24, noon, phase=True)[0] == pytest.approx(0.1)
    with pytest.raises(InputError, match="of the spacecraft 177, not of 85"):
        calibrations(ION, scid=85)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("SCID(177).    #", "SCID(177)     #", "line 6: ADJUST comes twice in a card"),
        ("QUASAR(5).\n", "QUASAR(5)", "line 9: KEYWORD(...) is wanted, or the full stop that ends a card"),
        ("MODEL(CHPART)\n", "MODEL(IONO)\n", "line 3: MODEL(IONO) is none of CHPART, DRY NUPART, WET NUPART"),
        ("ADJUST(DOPRNG)", "ADJUST(DOPLER)", "line 2: ADJUST(DOPLER) is none of ALL, DOPPLER"),
        ("BY NRMPOW", "BY CHEB", "line 2: BY CHEB is none of BY CONST, BY NRMPOW, BY TRIG"),
        ("0.0938", "0.O938", "line 2: '0.O938' is not a number"),
        ("0.7048", "7048", "line 2: a delay of 7048 m is none of CHPART; metres are wanted"),
        ("20/12/02,01:21", "20/13/02,01:21", "line 4: FROM(20/13/02,01:21) is no epoch such as"),
        ("20/12/02,15:01", "20/12/02,24:01", "line 4: TO(20/12/02,24:01) is no epoch such as"),
        ("20/12/02,01:21", "336/01:21", "line 4: FROM(336/01:21) is no epoch such as"),
        ("TO(20/12/02,15:01)", "TO(20/12/02,01:20)", "line 4: TO must follow FROM"),
        ("TO(20/12/02,15:01)", "", "line 4: TO must follow FROM; only TRIG and CONST do without TO"),
        ("TO(20/12/02,15:01)", "AFTER(20/12/02,15:01)", "line 4: AFTER is not known"),
        ("DSN(C10)SCID(177)", "SCID(177)", "line 4: the card that ends here lacks DSN(...)"),
        ("SCID(177).    #", "SCID(LRO).    #", "line 4: SCID(LRO) is no number of a spacecraft"),
        ("BY CNSTNT(3.0)", "BY CONST(3.0, 1.0)", "line 8: CONST has one number"),
        ("BY CNSTNT(3.0)", "BY TRIG(0., 1.0)", "line 8: CONST has one number, TRIG a period above zero"),
        ("ADJUST", "DELETE", "there is no card ADJUST(...)"),
    ],
)
def test_a_card_that_is_none_is_one_error(old, new, problem, calibrations):
    text = ION.replace(old, new) if old == "ADJUST" else ION.replace(old, new, 1)
    with pytest.raises(FileFormatError) as caught:
        calibrations(text)
    assert problem in str(caught.value)
    assert "0.csp" in str(caught.value)


def test_zenith_delays_take_the_place_of_the_weather_s_and_are_mapped_as_before(calibrations):
    cards = calibrations(TRO, ION)
    ends = end(2, station="DSS-24", epoch=utc_to_tt(utc("15:00:00", "16:30:00")), pressure_hpa=905.0)
    plain, found = air_above(ends, None), air_above(ends, None, cards)
    for name, model in (("hydrostatic_m", DRY), ("wet_m", WET)):
        wanted_m = cards.zenith_m(DSS_24, ends.epoch, model, phase=False)
        assert getattr(found, name).tolist() == wanted_m.tolist()
        assert 1e-3 < np.abs(wanted_m - getattr(plain, name)).max() < 0.1
    np.testing.assert_array_equal(found.hydrostatic_abc, plain.hydrostatic_abc)
    other = end(2, epoch=ends.epoch)
    assert air_above(other, None, cards).wet_m.tolist() == air_above(other, None).wet_m.tolist()


def test_the_ray_s_delay_falls_with_the_square_of_the_frequency_and_is_an_advance_of_the_phase(calibrations):
    cards = calibrations(ION)
    times = utc_to_tt(utc("08:11:00", "08:11:00", "08:11:10", "08:11:00", "08:11:00"))
    frequency_hz = np.array([2295e6, 8.4e9, 2295e6, 2295e6, np.nan])
    phase = np.array([False, False, False, True, False])
    some = leg([30.0] * 5, station="DSS-24", epoch=times, frequency_hz=frequency_hz, phase=phase)
    medium = Ionosphere(calibrations=cards)
    found = medium.delay(some, medium.prepare(some.end))
    at_s_m, rate_m_s = cards.charged(DSS_24, times[:3], phase=False)
    expected_m = [at_s_m[0], at_s_m[0] * (2295e6 / 8.4e9) ** 2, at_s_m[2], -at_s_m[0], 0.0]
    assert found.delay_m == pytest.approx(expected_m, abs=PRINTED_M)
    assert found.status.tolist() == [0, 0, 0, 0, Status.NO_FREQUENCY]
    assert (found.by_elevation_m_rad == 0.0).all()
    assert found.rate_m_s[:2] == pytest.approx([rate_m_s[0], rate_m_s[0] * (2295e6 / 8.4e9) ** 2])
    assert found.rate_m_s[0] == pytest.approx((at_s_m[2] - at_s_m[0]) / 10.0, rel=0.01)
    # Another network's station has the source, or nothing.
    other = leg([30.0], epoch=times[:1])
    mixed, by_content = Ionosphere(UniformTec(10.0), cards), Ionosphere(UniformTec(10.0)).delay(other, None)
    assert mixed.delay(other, mixed.prepare(other.end)).delay_m == by_content.delay_m
    assert medium.delay(other, medium.prepare(other.end)) is None


@pytest.mark.parametrize("kind", ["range", "doppler"])
def test_round_trips_have_the_calibrations_at_both_events(kind, calibrations):
    uplink_hz, downlink_hz = 2.1e9, 2.1e9 * 240 / 221
    observations = Observations.from_columns(
        epoch=utc("06:00:00", "07:30:00"),
        links=[Link("DSS-24", "apollo15", "DSS-24")],
        kind=KINDS.index(kind),
        tag=1,
        value_m=1.0,
        sigma_m=1.0,
        uplink_hz=uplink_hz,
        wavelength_um=C_M_S / downlink_hz * 1e6,
        **({"count_s": 600.0} if kind == "doppler" else {}),
    )
    cards = calibrations(ION)
    values_m = [
        ExactPredictor(PhysicalModel.build(media_calibrations=given), observations, APOLLO15)
        .compute()
        .value_m
        for given in (None, cards)
    ]

    def path_m(epochs):
        # Two-way light time of the Moon is 2.6 s, in which the calibration changes by micrometres.
        at_s_m = cards.charged(DSS_24, epochs, phase=kind == "doppler")[0]
        return at_s_m * ((2295e6 / uplink_hz) ** 2 + (2295e6 / downlink_hz) ** 2)

    expected_m = path_m(observations.epoch)
    if kind == "doppler":
        expected_m = -(path_m(utc("06:05:00", "07:35:00")) - path_m(utc("05:55:00", "07:25:00")))
    assert np.abs(expected_m).min() > 100 * LEVER_M
    assert values_m[1] - values_m[0] == pytest.approx(expected_m, abs=LEVER_M + 2.6 * 1e-5)
