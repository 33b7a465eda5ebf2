import dataclasses

import numpy as np
import pytest
import spiceypy

from radioloc.ephemeris import BODIES, CONSTANTS, Ephemeris, LunarOrientation
from radioloc.errors import CoverageError, InputError, KernelError
from radioloc.time import Epochs

# The series and Newton's law differ by Mars and the smaller planets (1.4e-8 m/s^2 at most).
OTHER_PLANETS_M_S2 = 2e-8
SERIES_ACCELERATION_M_S2 = 1e-9


@pytest.fixture(scope="module")
def ephemeris():
    return Ephemeris.open()


@pytest.fixture(scope="module")
def epochs():
    rng = np.random.default_rng(421)
    return Epochs.from_jd(2440222.5 + rng.integers(3, 29580, 200), rng.uniform(0, 1, 200), "TDB")


def test_velocity_and_acceleration_are_derivatives(ephemeris, epochs):
    step_s = 600.0
    ahead, behind = ephemeris.earth(epochs.shifted(step_s)), ephemeris.earth(epochs.shifted(-step_s))
    state = ephemeris.earth(epochs)
    slope = (ahead.velocity_m_s - behind.velocity_m_s) / (2 * step_s)
    # Central differences leave h^2/6 of the third derivative of the velocity: 1e-11 m/s^2.
    np.testing.assert_allclose(slope, state.acceleration_m_s2, rtol=0, atol=SERIES_ACCELERATION_M_S2)
    slope = (ahead.position_m - behind.position_m) / (2 * step_s)
    np.testing.assert_allclose(slope, state.velocity_m_s, rtol=0, atol=1e-4)


def test_acceleration_is_newtons(ephemeris, epochs):
    total = np.zeros((len(epochs), 3))
    for body in BODIES:
        position_m, _ = ephemeris.geocentric(body, epochs)
        distance_m = np.linalg.norm(position_m, axis=1, keepdims=True)
        total += ephemeris.constants.gm_m3_s2(body) * position_m / distance_m**3
    np.testing.assert_allclose(
        ephemeris.earth(epochs).acceleration_m_s2, total, rtol=0, atol=OTHER_PLANETS_M_S2
    )


def test_acceleration_does_not_jump_between_records(ephemeris):
    segment = ephemeris.spk.segments_of(399, 3)[-1]
    starts = Epochs.from_jd(
        2451545.0 + segment.first_record_s / 86400.0 + 4.0 * np.arange(1, 7390), 0.0, "TDB"
    )
    earlier, later = ephemeris.earth(starts.shifted(-1e-3)), ephemeris.earth(starts)
    np.testing.assert_allclose(
        earlier.acceleration_m_s2, later.acceleration_m_s2, rtol=0, atol=SERIES_ACCELERATION_M_S2
    )


def test_moon_is_free_of_the_barycentric_round_off(ephemeris):
    # Over half a second the Moon moves along a parabola to 1e-9 m; any rough round-off would show.
    step_s = np.linspace(0.0, 0.5, 400)
    tdb = Epochs.from_jd(2459000.5, 0.123456789012345, "TDB").shifted(step_s)
    elapsed_s = tdb.seconds_since(tdb[0])
    position_m, _ = ephemeris.geocentric("moon", tdb)
    for component in position_m.T:
        offset = component - component[0]
        rough = offset - np.polyval(np.polyfit(elapsed_s, offset, 2), elapsed_s)
        assert np.abs(rough).max() < 1e-6
    barycentric_m, _ = ephemeris.barycentric("moon", tdb)
    offset = barycentric_m[:, 0] - barycentric_m[0, 0]
    assert np.abs(offset - np.polyval(np.polyfit(elapsed_s, offset, 2), elapsed_s)).max() > 1e-6


def test_both_ends_of_the_span_are_inside(ephemeris):
    ends = Epochs.from_jd([2440222.5, 2469807.5], 0.0, "TDB")
    assert np.isfinite(ephemeris.earth(ends).acceleration_m_s2).all()
    assert np.isfinite(LunarOrientation.open().angles(ends)[0]).all()


@pytest.mark.parametrize(
    ("jd", "fraction", "date"),
    [(2440221.5, 0.99999999, "1968-12-31T23:59:59.999"), (2469807.5, 1e-9, "2050-01-01T00:00:00.000")],
)
def test_outside_the_span(ephemeris, jd, fraction, date):
    tdb = Epochs.from_jd([2451545.0, jd], [0.0, fraction], "TDB")
    for evaluate in (
        lambda: ephemeris.earth(tdb),
        lambda: ephemeris.geocentric("moon", tdb),
        lambda: ephemeris.barycentric("sun", tdb),
        lambda: LunarOrientation.open().angles(tdb),
    ):
        with pytest.raises(CoverageError, match="1969-01-01 TDB to 2050-01-01 TDB") as caught:
            evaluate()
        assert any(text.startswith(date) for text in caught.value.requested)


def test_wrong_scale_and_wrong_body(ephemeris, epochs):
    with pytest.raises(InputError, match="TDB"):
        ephemeris.earth(Epochs.from_jd(2451545.0, 0.0, "TT"))
    with pytest.raises(InputError, match="got 'mars'"):
        ephemeris.geocentric("mars", epochs)
    with pytest.raises(InputError, match="body:"):
        ephemeris.constants.gm_m3_s2("mars")


def chebyshev_spk(path, name, pairs, n_days=40):
    """An SPK of type 2 whose series are made up: two coefficients for each pair."""
    handle = spiceypy.spkopn(str(path), name, 0)
    for (target, center), length_s in pairs.items():
        n_records = int(np.ceil(n_days * 86400.0 / length_s))
        series = np.zeros((n_records, 3, 3))
        series[:, :, 0] = 1e5 * target
        series[:, :, 1] = np.arange(n_records)[:, None]
        series[:, :, 2] = 0.5
        spiceypy.spkw02(
            handle,
            target,
            center,
            "J2000",
            0.0,
            n_days * 86400.0,
            name,
            length_s,
            n_records,
            2,
            series.ravel(),
            0.0,
        )
    spiceypy.spkcls(handle)
    return path


PAIRS_OF_DE440 = {
    (3, 0): 16 * 86400.0,
    (10, 0): 16 * 86400.0,
    (1, 0): 8 * 86400.0,
    (2, 0): 16 * 86400.0,
    (301, 3): 4 * 86400.0,
    (399, 3): 4 * 86400.0,
    (199, 1): 40 * 86400.0,
    (299, 2): 40 * 86400.0,
}


def test_another_ephemeris(tmp_path):
    path = chebyshev_spk(tmp_path / "other.bsp", "DE-0440LE-0440", PAIRS_OF_DE440)
    ephemeris = Ephemeris.open(path)
    assert ephemeris.name == "DE440"
    assert ephemeris.constants.me_frame == "ME_DE421"
    assert not ephemeris.kernel.registered
    assert ephemeris.bodies == ("sun", "moon", "venus")
    tdb = Epochs.from_tdb_seconds(np.array([0.0, 1e5, 1.9e6, 40 * 86400.0]))
    spiceypy.furnsh(str(path))
    try:
        states = np.array(
            [spiceypy.spkgeo(301, et, "J2000", 399)[0] for et in (0.0, 1e5, 1.9e6, 40 * 86400.0)]
        )
    finally:
        spiceypy.kclear()
    position_m, velocity_m_s = ephemeris.geocentric("moon", tdb)
    np.testing.assert_allclose(position_m, 1e3 * states[:, :3], rtol=0, atol=1e-5)
    np.testing.assert_allclose(velocity_m_s, 1e3 * states[:, 3:], rtol=0, atol=1e-9)
    with pytest.raises(KernelError, match=r"NAIF.*5"):
        ephemeris.geocentric("jupiter", tdb)


def test_ephemeris_without_the_moon_or_of_unknown_name(tmp_path):
    remaining = {pair: length_s for pair, length_s in PAIRS_OF_DE440.items() if pair[0] != 301}
    with pytest.raises(KernelError, match=r"NAIF.*301.*3"):
        Ephemeris.open(chebyshev_spk(tmp_path / "no_moon.bsp", "DE-0440LE-0440", remaining))
    unknown = chebyshev_spk(tmp_path / "unknown.bsp", "INPOP21A", PAIRS_OF_DE440)
    with pytest.raises(KernelError, match="constants="):
        Ephemeris.open(unknown)
    constants = dataclasses.replace(CONSTANTS["DE440"], name="INPOP21A")
    assert Ephemeris.open(unknown, constants).name == "INPOP21A"


def test_a_short_kernel_says_what_it_covers(tmp_path):
    ephemeris = Ephemeris.open(chebyshev_spk(tmp_path / "short.bsp", "DE-0421LE-0421", PAIRS_OF_DE440))
    with pytest.raises(
        CoverageError, match=r"short\.bsp.*2000-01-01T12:00:00 TDB to 2000-02-10T12:00:00 TDB"
    ):
        ephemeris.earth(Epochs.from_jd(2459000.5, 0.0, "TDB"))


def test_constants():
    for name, constants in CONSTANTS.items():
        assert constants.name == name
        # The Earth is 81.3 Moons, and the Sun 332946 Earths.
        assert constants.gm_m3_s2("earth") / constants.gm_m3_s2("moon") == pytest.approx(81.30057, abs=1e-5)
        assert constants.gm_m3_s2("sun") / constants.gm_m3_s2("earth") == pytest.approx(332946.05, abs=0.01)
