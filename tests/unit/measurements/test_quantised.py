"""Readings that are multiples of a step: the step is found, and sigmas are not below its rounding error."""

import warnings

import numpy as np
import pytest
from arc_cases import observed_at

from radioloc import read_observations
from radioloc.constants import C_M_S
from radioloc.errors import DataQualityWarning
from radioloc.io import FrequencyAgreement
from radioloc.measurements.quantised import common_step, with_rounding_in_sigmas

RNG = np.random.default_rng(5)
SMOOTH = 7.7e8 + 4e5 * np.sin(np.linspace(0.0, 3.0, 400))


@pytest.mark.parametrize("step", [0.15, 3.547, 64.0, 1000.0])
def test_the_step_of_rounded_values_is_found(step):
    offset = 0.37 * step
    rounded = offset + step * np.rint((SMOOTH - offset) / step)
    assert common_step(rounded, 0.5 * step) == pytest.approx(step, rel=1e-3)
    assert common_step(rounded, 1.5 * step) == 0.0
    assert common_step(rounded[:5], 0.5 * step) == 0.0


@pytest.mark.parametrize(
    "values",
    [
        SMOOTH,
        SMOOTH + RNG.normal(size=400),
        np.empty(0),
        np.append(100.0 * np.rint(SMOOTH / 100.0), 33.3),
        3.8e8 + 100.0 * np.arange(50),
        np.where(np.arange(50) == 20, 3.8e8 + 300.0, 3.8e8),
    ],
    ids=["smooth", "noise", "none", "one off the raster", "straight line", "outlier"],
)
def test_values_without_a_step_have_none(values):
    assert common_step(values, 0.1) == 0.0


def test_steps_under_two_transmitted_frequencies_are_found():
    hz = 100.0 * np.rint((1e6 + 2e4 * np.cos(np.linspace(0.0, 2.0, 40))) / 100.0)
    uplink_hz = np.repeat([7.2e9, 7.2004e9], 20)
    observations = observed_at(
        [f"2021-03-28T14:{k:02d}:00" for k in range(40)],
        "KASHI>lander>KASHI",
        kind="doppler",
        count_s=60.0,
        value_m=C_M_S * 60.0 * hz / uplink_hz,
        sigma_m=0.01,
        uplink_hz=uplink_hz,
    )
    with pytest.warns(DataQualityWarning, match=r"20.*249"):
        sigma_m = with_rounding_in_sigmas(observations).sigma_m
    assert sigma_m == pytest.approx(C_M_S * 60.0 * 100.0 / uplink_hz / np.sqrt(12.0), rel=1e-6)


@pytest.mark.parametrize(("sigma_hz", "expected_hz"), [(0.5, 100.0 / np.sqrt(12.0)), (40.0, 40.0)])
def test_sigmas_of_frequencies_in_steps_are_at_least_those_of_rounding(tmp_path, sigma_hz, expected_hz):
    hz = 100.0 * np.rint((8.45e9 + 2e4 * np.cos(np.linspace(0.0, 2.0, 300))) / 100.0)
    lines = [
        f"59184.{k:06d}\t{value:.3f}\t10.0\t4171\n"
        for k, value in zip(range(0, 300000, 1000), hz, strict=True)
    ]
    (tmp_path / "night.dat").write_text("".join(lines))
    agreement = FrequencyAgreement(transmit_hz=8.45e9, sigma_hz=sigma_hz, count_s=10.0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read = read_observations(tmp_path / "night.dat", frequencies=[agreement])
    assert [warning.category for warning in caught] == [DataQualityWarning] * (sigma_hz < 28.0)
    assert read.sigma_m == pytest.approx(C_M_S * 10.0 / 8.45e9 * expected_hz, rel=1e-3)
