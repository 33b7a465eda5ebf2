"""Media calibrations of the Deep Space Network: cards, and delays of radio paths."""

import math

import numpy as np
import pytest
from arc_cases import APOLLO15, observed_at
from legs import end, leg

from radioloc.constants import C_M_S
from radioloc.earth import StationCatalogue, geodetic_from_itrf
from radioloc.errors import CoverageError, FileFormatError, InputError
from radioloc.measurements import ExactPredictor, PhysicalModel
from radioloc.media.csp import DRY, WET, read_csp
from radioloc.media.ionosphere import Ionosphere, UniformTec
from radioloc.media.medium import Status
from radioloc.media.neutral_atmosphere import standard_weather, zenith_hydrostatic_delay_m
from radioloc.media.radio_atmosphere import zenith_air
from radioloc.time import epochs_from_strings, utc_to_tt

PRINTED_M = 1e-12
"""Rounding of sums of some metres; MJD resolve a microsecond, in which polynomials change by less."""
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
    """Reader of texts, each in a file."""

    def reader(*texts, **options):
        paths = [tmp_path / f"{k}.csp" for k in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return read_csp(paths, **options)

    return reader


def utc(*times, day="2020-12-02"):
    return epochs_from_strings([f"{day}T{time}" for time in times], "UTC")


def test_normalized_powers_go_from_minus_one_to_one(calibrations):
    cards = calibrations(ION)
    hours = np.array([1.35, 3.0, 8.0 + 11 / 60, 15.0])
    delay_m, rate_m_s = cards.charged_delay(
        DSS_24, utc("01:21:00", "03:00:00", "08:11:00", "15:00:00"), phase=True
    )
    x = (hours - (1.35 + 15 + 1 / 60) / 2) / ((15 + 1 / 60 - 1.35) / 2)
    by_hand_m = sum(c * x**k for k, c in enumerate(COEFFICIENTS))
    assert delay_m == pytest.approx(by_hand_m, abs=1e-9)
    slope = sum(k * c * x ** (k - 1) for k, c in enumerate(COEFFICIENTS) if k)
    assert rate_m_s == pytest.approx(slope / (0.5 * (15 + 1 / 60 - 1.35) * 3600), rel=1e-9)


def test_last_card_of_codes_or_phases_counts(calibrations):
    cards = calibrations(ION)
    late = utc("17:30:30")
    assert cards.charged_delay(DSS_24, late, phase=False).tolist() == [[3.0], [0.0]]
    assert cards.charged_delay(DSS_24, late, phase=True)[0] == pytest.approx(-0.5, abs=1e-6)
    later = "ADJUST(ALL) BY CONST(7.0) MODEL(CHPART) FROM(20/12/02,17:00) TO(20/12/02,18:00) DSN(C10)."
    replaced = calibrations(ION, later)
    assert replaced.charged_delay(DSS_24, utc("17:30:30", "19:00:00"), phase=False)[0].tolist() == [7.0, 3.0]
    assert cards.charged_delay(KASHI, late, phase=True) is None


def test_fourier_terms_start_at_the_card(calibrations):
    card = (
        "ADJUST(ALL) BY TRIG(7200., 2.1, .1, -.2, .03, .04) MODEL(DRY NUPART) FROM(20/12/02,00:00) DSN(C10)."
    )
    delay_m = calibrations(card).zenith_m(DSS_24, utc("00:00:00", "00:15:00", "01:10:00"), DRY, phase=True)
    angles = [2.0 * math.pi * t / 7200.0 for t in (0.0, 900.0, 4200.0)]
    by_hand_m = [
        2.1 + 0.1 * math.cos(x) - 0.2 * math.sin(x) + 0.03 * math.cos(2 * x) + 0.04 * math.sin(2 * x)
        for x in angles
    ]
    assert delay_m == pytest.approx(by_hand_m, abs=1e-7)  # MJD, some microseconds of two hours


@pytest.mark.parametrize("name", ["DSS-24", "DSS-34", "DSS-54"])
def test_seasonal_model_of_each_complex(name, calibrations):
    """Dry air as in the standard atmosphere, to 20 hPa; wet air of 2 to 17 cm, more in the summer of the hemisphere.

    Sea-level pressure is some hPa above the standard's, and each model is for another height in the complex.
    """
    station = StationCatalogue.default()[name]
    place = geodetic_from_itrf(station.itrf_m)
    complex_of = {"2": "C10", "3": "C40", "5": "C60"}[name[4]]
    zero = "ADJUST(ALL) BY CONST(0.) MODEL({}) FROM(20/01/01,00:00) TO(21/01/01,00:00) DSN({})."
    cards = calibrations(*(zero.format(model, complex_of) for model in (DRY, WET)))
    dates = epochs_from_strings(["2020-01-20", "2020-07-20"], "UTC")
    dry_m, wet_m = (cards.zenith_m(station, dates, model, phase=True) for model in (DRY, WET))
    standard_m = zenith_hydrostatic_delay_m(
        standard_weather(place.height_m)[0], place.latitude_rad, place.height_m
    )
    assert dry_m == pytest.approx(float(standard_m), abs=0.045)
    assert ((wet_m > 0.02) & (wet_m < 0.17)).all()
    assert (wet_m[1] > wet_m[0]) == (place.latitude_rad > 0)


def test_corrections_add_to_the_seasonal_model_of_the_files_or_the_package(calibrations):
    seasonal = "ADJUST(ALL) BY TRIG(31557600., 2., 0., 0.) MODEL(DRY NUPART) FROM(20/01/01,00:00) DSN(C10)."
    noon = utc("15:00:00", "17:59:59", "19:00:00")
    with_files_m = calibrations(seasonal, TRO).zenith_m(DSS_24, noon, DRY, phase=True)
    assert with_files_m == pytest.approx([2.0018, 2.0018 + 0.0039 * (1 - 1 / 10800), 2.01], abs=1e-7)
    constant = "ADJUST(ALL) BY CONST(0.) MODEL(DRY NUPART) FROM(20/12/02,00:00) TO(20/12/03,00:00) DSN(C10)."
    base_m = calibrations(constant).zenith_m(DSS_24, noon, DRY, phase=True)
    corrected_m = calibrations(TRO).zenith_m(DSS_24, noon, DRY, phase=True)
    assert corrected_m - base_m == pytest.approx(with_files_m - 2.0, abs=1e-12)


@pytest.mark.parametrize("time", ["11:59:50", "20:00:02"])
def test_epochs_without_a_card_are_an_error(time, calibrations):
    cards = calibrations(TRO)
    with pytest.raises(CoverageError, match=r"for DSS-24 covers 2020-12-02T12:00:00"):
        cards.zenith_m(DSS_24, utc("15:00:00", time), DRY, phase=True)
    # Milliseconds between consecutive cards are allowed; minutes are a gap.
    assert np.isfinite(cards.zenith_m(DSS_24, utc("18:00:00.0005"), DRY, phase=True)).all()
    gap = calibrations(TRO.replace("18:00:00.001", "18:05:00"))
    with pytest.raises(CoverageError, match=r"gaps, .* got 2020-12-02T18:02:00"):
        gap.zenith_m(DSS_24, utc("18:02:00"), DRY, phase=True)


def test_cards_of_several_spacecraft_need_a_number(calibrations):
    other_cards = ION.replace("0.7048", "0.1").replace("SCID(177)", "SCID(85)")
    noon = utc("08:11:00")
    with pytest.raises(InputError, match=r"csp_scid:.*85.*177"):
        calibrations(ION, other_cards)
    assert calibrations(ION, other_cards, scid=177).charged_delay(DSS_24, noon, phase=True)[
        0
    ] == pytest.approx(0.7048)
    assert calibrations(ION, other_cards, scid=85).charged_delay(DSS_24, noon, phase=True)[
        0
    ] == pytest.approx(0.1)
    with pytest.raises(InputError, match="got 85"):
        calibrations(ION, scid=85)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("QUASAR(5).\n", "QUASAR(5)", 9, "KEYWORD(...)"),
        ("MODEL(CHPART)\n", "MODEL(IONO)\n", 3, "got IONO"),
        ("0.0938", "0.O938", 2, "'0.O938'"),
        ("20/12/02,01:21", "20/13/02,01:21", 4, "got 20/13/02,01:21"),
        ("TO(20/12/02,15:01)", "TO(20/12/02,01:20)", 4, "TO must follow FROM"),
        ("DSN(C10)SCID(177)", "SCID(177)", 4, "lacks DSN(...)"),
        ("SCID(177).    #", "SCID(LRO).    #", 4, "SCID: expected the number"),
        ("ADJUST", "DELETE", None, "ADJUST(...)"),
    ],
)
def test_damaged_cards(old, new, line, words, calibrations):
    text = ION.replace(old, new) if old == "ADJUST" else ION.replace(old, new, 1)
    with pytest.raises(FileFormatError) as caught:
        calibrations(text)
    assert caught.value.line == line
    assert words in str(caught.value)


def test_zenith_delays_replace_those_of_the_weather(calibrations):
    cards = calibrations(TRO, ION)
    ends = end(2, station="DSS-24", epoch=utc_to_tt(utc("15:00:00", "16:30:00")), pressure_hpa=905.0)
    plain, calibrated = zenith_air(ends, None), zenith_air(ends, None, cards)
    for name, model in (("hydrostatic_m", DRY), ("wet_m", WET)):
        expected_m = cards.zenith_m(DSS_24, ends.epoch, model, phase=False)
        assert getattr(calibrated, name).tolist() == expected_m.tolist()
        assert 1e-3 < np.abs(expected_m - getattr(plain, name)).max() < 0.1
    np.testing.assert_array_equal(calibrated.hydrostatic_abc, plain.hydrostatic_abc)
    other_end = end(2, epoch=ends.epoch)
    assert zenith_air(other_end, None, cards).wet_m.tolist() == zenith_air(other_end, None).wet_m.tolist()


def test_slant_delay_scales_with_inverse_square_of_frequency_and_advances_phases(calibrations):
    cards = calibrations(ION)
    times = utc_to_tt(utc("08:11:00", "08:11:00", "08:11:10", "08:11:00", "08:11:00"))
    frequency_hz = np.array([2295e6, 8.4e9, 2295e6, 2295e6, np.nan])
    phase = np.array([False, False, False, True, False])
    legs = leg([30.0] * 5, station="DSS-24", epoch=times, frequency_hz=frequency_hz, phase=phase)
    medium = Ionosphere(calibrations=cards)
    delay = medium.delay(legs, medium.prepare(legs.end))
    at_s_m, rate_m_s = cards.charged_delay(DSS_24, times[:3], phase=False)
    expected_m = [at_s_m[0], at_s_m[0] * (2295e6 / 8.4e9) ** 2, at_s_m[2], -at_s_m[0], 0.0]
    assert delay.delay_m == pytest.approx(expected_m, abs=PRINTED_M)
    assert delay.status.tolist() == [0, 0, 0, 0, Status.NO_FREQUENCY]
    assert (delay.by_elevation_m_rad == 0.0).all()
    assert delay.rate_m_s[:2] == pytest.approx([rate_m_s[0], rate_m_s[0] * (2295e6 / 8.4e9) ** 2])
    assert delay.rate_m_s[0] == pytest.approx((at_s_m[2] - at_s_m[0]) / 10.0, rel=0.01)
    # A station without cards has the delay of the source, if there is one.
    other_leg = leg([30.0], epoch=times[:1])
    mixed, by_content = (
        Ionosphere(UniformTec(10.0), cards),
        Ionosphere(UniformTec(10.0)).delay(other_leg, None),
    )
    assert mixed.delay(other_leg, mixed.prepare(other_leg.end)).delay_m == by_content.delay_m
    assert medium.delay(other_leg, medium.prepare(other_leg.end)) is None


@pytest.mark.parametrize("kind", ["range", "doppler"])
def test_round_trips_are_calibrated_at_both_events(kind, calibrations):
    uplink_hz, downlink_hz = 2.1e9, 2.1e9 * 240 / 221
    observations = observed_at(
        utc("06:00:00", "07:30:00"),
        "DSS-24>apollo15>DSS-24",
        kind=kind,
        uplink_hz=uplink_hz,
        wavelength_um=C_M_S / downlink_hz * 1e6,
        **{"count_s": 600.0} if kind == "doppler" else {},
    )
    cards = calibrations(ION)
    values_m = [
        ExactPredictor(PhysicalModel.build(media_calibrations=media_calibrations), observations, APOLLO15)
        .compute()
        .value_m
        for media_calibrations in (None, cards)
    ]

    def path_m(epochs):
        # The two-way light time of the Moon is 2.6 s, in which the calibration changes by micrometres.
        at_s_m = cards.charged_delay(DSS_24, epochs, phase=kind == "doppler")[0]
        return at_s_m * ((2295e6 / uplink_hz) ** 2 + (2295e6 / downlink_hz) ** 2)

    expected_m = path_m(observations.epoch)
    if kind == "doppler":
        expected_m = -(path_m(utc("06:05:00", "07:35:00")) - path_m(utc("05:55:00", "07:25:00")))
    assert np.abs(expected_m).min() > 100 * LEVER_M
    assert values_m[1] - values_m[0] == pytest.approx(expected_m, abs=LEVER_M + 2.6 * 1e-5)
