"""Observations far apart, such as laser points, with the full model and its partials.

Run with ``make bench``.
"""

import time

import numpy as np
import pytest

import radioloc
from radioloc.measurements import FixedPoint
from radioloc.measurements.registry import kind_of
from radioloc.time import Epochs

PLACE = radioloc.LunarPosition.from_selenographic(3.628, 26.133, -1500.0)  # near Apollo 15
MOST_S = {"range": 4.0, "doppler": 3.0}
"""Limit of processor time for observations of fifty years, three times that of a quiet core."""


@pytest.mark.parametrize(
    ("kind", "count", "paths"), [("range", 30_000, "{0}>x>{0}"), ("doppler", 10_000, "{0}>x>{1}")]
)
def test_fifty_years(benchmark, model, kind, count, paths, capsys):
    """Prepare random epochs from 1973 to 2024, and compute values with all partials."""
    random = np.random.default_rng(1)
    stations = {"range": ("APOLLO", "GRASSE", "MATERA", "MLRS2", "WETTZELL"), "doppler": ("KASHI", "NEUQUEN")}
    links = [paths.format(a, b) for a in stations[kind] for b in stations[kind]]
    of_kind = {
        "range": {"value_m": 7.6e8, "wavelength_um": 0.532},
        "doppler": {"value_m": 1.0, "wavelength_um": 35_700.0, "count_s": 60.0},
    }
    observations = radioloc.Observations.from_columns(
        epoch=Epochs.from_jd(2441700.5 + np.sort(random.uniform(0.0, 18_900.0, count)), 0.0, "UTC"),
        links=[radioloc.measurements.Link.from_path(path) for path in links],
        link=random.integers(0, len(links), count),
        kind=kind_of(kind),
        sigma_m=0.02,
        pressure_hpa=900.0,
        temperature_k=285.0,
        relative_humidity=0.5,
        **of_kind[kind],
    )
    place_pa_m = PLACE.to_axes("PA", model.ephemeris.constants).xyz_m
    taken_s = []

    def prepared_and_computed():
        start = time.process_time()
        computed = radioloc.measurements.ExactPredictor(model, observations, FixedPoint(place_pa_m)).compute()
        taken_s.append(time.process_time() - start)
        return computed

    computed = benchmark.pedantic(prepared_and_computed, rounds=3, warmup_rounds=1)
    assert np.isfinite(computed.value_m).all()
    least_s = min(taken_s)
    with capsys.disabled():
        print(f"\n{count} of {kind} over fifty years: {least_s:.2f} s, {1e6 * least_s / count:.0f} us each")
    assert least_s < MOST_S[kind]
