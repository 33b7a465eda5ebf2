"""Random streams by seed and label, and the parts of simulated noise."""

import numpy as np
import pytest

from radioloc.errors import InputError
from radioloc.simulation import Masks, Noise, NoiseModel, Schedule, Session, baselines, two_way
from radioloc.simulation.noise import NoiseDraws, gauss_markov, generator

START, STOP = "2020-12-01T15:11", "2020-12-01T21:00"
VLBI = ("SESHAN25", "MIYUN50", "KUNMING", "URUMQI")
NOISE = NoiseModel(
    {
        "range": Noise(
            white_m=1.0, coloured_m=2.0, correlation_s=3600.0, outlier_fraction=0.1, outlier_m=50.0
        ),
        "vlbi_delay": Noise(white_m=0.1),
    },
    vlbi_station=Noise(white_m=0.3, walk_m_sqrt_s=0.01),
)


def by_row(schedule, model, lander, seed=7, noise=NOISE):
    plan = schedule.plan(model, lander)
    noise_m, outliers = noise.draw(plan, seed)
    keys = zip(plan.observations.paths().tolist(), plan.observations.epoch.mjd.round(6).tolist(), strict=True)
    return dict(zip(keys, zip(noise_m.tolist(), outliers.tolist(), strict=True), strict=True))


def ranges(*stations):
    return Session("range", two_way(*stations), START, STOP, 300.0, 1.0)


def delays(*stations):
    return Session("vlbi_delay", baselines(*stations), START, STOP, 300.0, 1.0)


def test_noise_of_a_link_is_independent_of_other_sessions_masks_and_aliases(model, lander):
    subset = by_row(Schedule([ranges("KASHI"), delays(*VLBI[:2])]), model, lander)
    superset = by_row(Schedule([delays(*VLBI), ranges("JIAMUSI", "KASHI")]), model, lander)
    assert len(subset) > 100
    assert subset.items() < superset.items()
    high = by_row(Schedule([ranges("KS"), delays(*VLBI[:2])], Masks(50.0)), model, lander)
    assert high.items() < subset.items()


def test_station_noise_closes_around_triangles_and_thermal_noise_does_not(model, lander):
    plan = Schedule([delays(*VLBI)]).plan(model, lander)
    paths = plan.observations.paths()

    def closure_m(noise):
        noise_m, _ = noise.draw(plan, 3)
        ab, bc, ac = (
            noise_m[paths == f"{a}<lander>{b}"]
            for a, b in ((0, 1), (1, 2), (0, 2))
            for a, b in ((VLBI[a], VLBI[b]),)
        )
        return ab + bc - ac

    station = NoiseModel(vlbi_station=Noise(white_m=1.0, coloured_m=1.0, correlation_s=600.0))
    assert np.abs(closure_m(station)).max() < 1e-12
    assert closure_m(NoiseModel({"vlbi_delay": Noise(white_m=1.0)})).std() > 1.0


def test_outliers_have_the_stated_fraction_and_size():
    noise = Noise(white_m=1e-3, outlier_fraction=0.05, outlier_m=100.0)
    [error_m], [outliers] = noise.series(20000, 1.0, [1], "a")
    # Binomial of 20000 at 0.05: 1e-5 and 1 - 1e-5 quantiles.
    assert 872 <= outliers.sum() <= 1133
    assert np.abs(error_m[outliers]).min() > 49.9
    assert np.abs(error_m[outliers]).max() < 150.1
    assert 0.4 < (error_m[outliers] > 0.0).mean() < 0.6
    assert np.abs(error_m[~outliers]).max() < 0.01
    # The other epochs are unchanged.
    plain_m, _ = Noise(white_m=1e-3).series(20000, 1.0, [1], "a")
    assert (error_m[~outliers] == plain_m[0, ~outliers]).all()


def test_gauss_markov_process_is_its_recursion():
    drive = np.random.default_rng(3).standard_normal((2, 1000))
    f = 0.98
    expected = drive.copy()
    for k in range(1, 1000):
        expected[:, k] = f * expected[:, k - 1] + np.sqrt(1.0 - f * f) * drive[:, k]
    np.testing.assert_allclose(gauss_markov(drive, f), expected, rtol=0.0, atol=1e-13)
    for n in (0, 1, 2, 17):
        np.testing.assert_allclose(gauss_markov(drive[:, :n], f), expected[:, :n], rtol=0.0, atol=1e-13)


def test_flicker_noise_has_the_same_variance_in_each_decade():
    n, step_s = 4096, 10.0
    error_m, _ = Noise(flicker_m=2.0).series(n, step_s, range(200), "a")
    window = np.hanning(n)
    power = np.mean(np.abs(np.fft.rfft(error_m * window, axis=1)) ** 2, axis=0) / (window**2).sum()
    power *= 2.0 * step_s
    frequency = np.fft.rfftfreq(n, step_s)
    for low in (1e-4, 3e-4, 1e-3):
        band = (frequency >= low) & (frequency < 10.0 * low)
        # Correlation times are half a decade apart; aliases add power near half a cycle per step.
        assert power[band].sum() * frequency[1] == pytest.approx(2.0**2, rel=0.2)


def test_random_walk_starts_at_zero_and_grows_with_the_root_of_time():
    ends = [Noise(walk_m_sqrt_s=0.5).series(101, 4.0, [seed], "a")[0][0] for seed in range(400)]
    assert all(walk[0] == 0.0 for walk in ends)
    # 0.5 m per root second over 400 s is 10 m; the standard deviation of 400 normals is within 16 % (all but 1e-5).
    assert np.std([walk[-1] for walk in ends]) == pytest.approx(10.0, rel=0.16)


def test_streams_are_reproducible_between_versions():
    np.testing.assert_array_equal(
        generator(1, "a").standard_normal(3), [-0.3946934246141611, 1.2311401672853206, -1.4378506738724737]
    )
    np.testing.assert_array_equal(
        generator(2**40, "range KASHI").random(2), [0.5799109649627061, 0.4155108311970416]
    )


@pytest.mark.parametrize(
    ("fields", "words"),
    [({"white_m": -1.0}, "white_m: .* -1.0"), ({"coloured_m": 1.0}, "needs correlation_s")],
)
def test_invalid_noise_is_refused(fields, words):
    with pytest.raises(InputError, match=words):
        Noise(**fields)


def test_noise_of_a_seed_is_independent_of_other_seeds(lander, model):
    start, stop = "2020-12-01T15:11", "2020-12-03T15:10"
    plan = Schedule(
        [
            Session("range", two_way("JIAMUSI", "KASHI"), start, stop, 7200.0, 1.0),
            Session("vlbi_delay", baselines("SESHAN25", "URUMQI"), start, stop, 7200.0, 0.5),
            Session("doppler", two_way("NEUQUEN"), start, stop, 7200.0, 0.01, count_s=60.0),
        ]
    ).plan(model, lander)
    noise = NoiseModel(
        {"range": Noise(1.0, 2.0, 9000.0, 0.01, 0.1, 50.0), "doppler": Noise(white_m=0.01)},
        vlbi_station=Noise(white_m=0.1, coloured_m=0.2, correlation_s=3600.0),
    )
    many_m, outliers = NoiseDraws.from_plan(noise, plan).draw([3, 8, 2**100])
    for seed, noise_m, is_outlier in zip([3, 8, 2**100], many_m, outliers, strict=True):
        single_m, is_single_outlier = noise.draw(plan, seed)
        assert (single_m == noise_m).all()
        assert (is_single_outlier == is_outlier).all()
    assert not (many_m[0] == many_m[1]).any()
