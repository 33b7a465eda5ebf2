"""Several targets of different kinds in one arc, and the motions that predictors accept."""

import numpy as np
import pytest
from arc_cases import APOLLO15, APOLLO15_PA_M, LASER, REFLECTORS_PA_M, epochs_tai, observations
from low_orbit import EPOCH
from tracked_orbit import STATE, craft

from radioloc.dynamics import Forces, GravityField
from radioloc.errors import InputError
from radioloc.lunar.position import LunarPosition
from radioloc.measurements import (
    EquipmentDelays,
    ExactPredictor,
    FixedPoint,
    Observations,
    OrbitMotion,
    PhysicalModel,
    TrajectoryMotion,
    prepare_predictor,
)
from radioloc.time.scales import tdb_to_tt, tt_to_tai

SAME_M = 1e-9  # rows of an arc are independent
TAI = tt_to_tai(tdb_to_tt(EPOCH.shifted(np.arange(1200.0, 4800.0, 300.0))))
LANDER = APOLLO15
STEPS = np.array([30.0, 30.0, 30.0, 0.03, 0.03, 0.03])
CASES = (
    ("DSS-24>{}>DSS-24", "receive", "range", {}),
    ("DSS-24>{}>DSS-65", "receive", "doppler", {"count_s": 60.0}),
    ("{}>DSS-24", "receive", "one_way_range", {}),
    ("{}>DSS-24", "receive", "one_way_doppler", {"count_s": 60.0}),
    ("DSS-24<{}>DSS-65", "receive", "vlbi_delay", {}),
)


@pytest.fixture(scope="module")
def model():
    return PhysicalModel.build(delays=EquipmentDelays(transponder_s=1e-6)).without("troposphere")


@pytest.fixture(scope="module")
def table():
    parts = [
        observations(path.format(name), TAI, tag, kind, wavelength_um=3.6e4, **columns)
        for path, tag, kind, columns in CASES
        for name in ("lander", "craft")
    ]
    mixed = Observations.concatenate(parts)
    return mixed.select(np.random.default_rng(30).permutation(len(mixed)))


@pytest.fixture(scope="module")
def orbit(model, table):
    forces = Forces(GravityField.open("GRGM660PRIM", degree=20), gradient_degree=20)
    return craft(STATE, forces).orbit(model, table, ())


@pytest.fixture(scope="module")
def is_craft(table):
    return np.array([link.target == "craft" for link in table.links])[table.link]


def joint_arc(model, table, motions):
    return ExactPredictor(model, table, motions, targets=("lander", "craft"), more_partials=True)


def assert_rows_equal_separate_arcs(model, table, is_craft, motions):
    computed = joint_arc(model, table, motions).compute()
    begin = 0
    for motion, rows in zip(motions, (~is_craft, is_craft), strict=True):
        separate = ExactPredictor(model, table.select(rows), motion, more_partials=True).compute()
        for name in ("value_m", "by_position_pa", "by_time_m_s", "elevation_rad", "by_station_itrf"):
            np.testing.assert_allclose(
                getattr(computed, name)[rows], getattr(separate, name), rtol=1e-13, atol=SAME_M
            )
        np.testing.assert_array_equal(computed.status[rows], separate.status)
        end = begin + separate.by_motion.shape[1]
        np.testing.assert_allclose(
            computed.by_motion[rows, begin:end], separate.by_motion, rtol=1e-12, atol=SAME_M
        )
        assert not computed.by_motion[~rows, begin:end].any()
        begin = end
    assert begin == computed.by_motion.shape[1]


@pytest.mark.parametrize("fixed", [False, True], ids=["orbit", "trajectory"])
def test_joint_arc_of_lander_and_orbiter_equals_separate_arcs(model, table, orbit, is_craft, fixed):
    motion = TrajectoryMotion(orbit.nearest()) if fixed else OrbitMotion(orbit)
    assert_rows_equal_separate_arcs(model, table, is_craft, (LANDER, motion))


def test_partials_of_both_motions_agree_with_differences(model, table, orbit):
    arc = joint_arc(model, table, (LANDER, orbit))
    by_motion = arc.compute().by_motion
    for k in range(9):
        changed_m = []
        for sign in (1.0, -1.0):
            point_m, x = APOLLO15_PA_M.copy(), np.zeros(6)
            if k < 3:
                point_m[k] += 100.0 * sign
            else:
                x[k - 3] = sign * STEPS[k - 3]
            changed_m.append(arc.predict((FixedPoint(point_m), OrbitMotion(orbit, x))).value_m)
        step = 100.0 if k < 3 else STEPS[k - 3]
        slope = (changed_m[0] - changed_m[1]) / (2.0 * step)
        size = np.abs(slope).max()
        np.testing.assert_allclose(by_motion[:, k] / size, slope / size, rtol=0.0, atol=2e-4)


def test_interpolated_partials_of_two_points_are_in_their_own_columns():
    tai = epochs_tai(600, 10.0)
    parts = [observations(f"GRASSE>{name}>GRASSE", tai, "transmit", **LASER) for name in ("a", "b")]
    points = [APOLLO15, FixedPoint(REFLECTORS_PA_M["luna17"])]
    arcs = [
        prepare_predictor(
            PhysicalModel.build(), Observations.concatenate(parts), points, evaluation, ("a", "b")
        )
        for evaluation in ("interpolated", "exact")
    ]
    interpolated, exact = (arc.compute().by_motion for arc in arcs)
    assert interpolated.shape == (1200, 6)
    np.testing.assert_allclose(interpolated, exact, rtol=0.0, atol=2e-9)
    assert not interpolated[:600, 3:].any()
    assert not interpolated[600:, :3].any()


def test_position_in_mean_earth_axes_is_accepted(model, table, is_craft):
    constants = model.ephemeris.constants
    position = LunarPosition(f"PA_{constants.name}", APOLLO15_PA_M).to_axes("ME", constants)
    arc = ExactPredictor(model, table.select(~is_craft), position)
    np.testing.assert_allclose(arc.motions[0].position_pa_m, APOLLO15_PA_M, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("motions", [APOLLO15_PA_M, APOLLO15_PA_M[None], [1.0, 2.0, 3.0]])
def test_arrays_are_refused_as_motions(model, table, is_craft, motions):
    with pytest.raises(InputError, match=r"FixedPoint\(position_pa_m\)|expected 1"):
        ExactPredictor(model, table.select(~is_craft), motions)
    with pytest.raises(InputError, match=r"FixedPoint\(position_pa_m\)|expected 1"):
        ExactPredictor(model, table.select(~is_craft), LANDER).predict(motions)


def test_number_and_kinds_of_motions_are_those_of_the_targets(model, table, orbit):
    arc = joint_arc(model, table, (LANDER, orbit))
    with pytest.raises(InputError, match="expected 2, one for each target"):
        arc.predict(LANDER)
    with pytest.raises(InputError, match="in the order"):
        arc.predict((OrbitMotion(orbit), LANDER))


@pytest.mark.parametrize("position_pa_m", [[1.0, 2.0], [np.nan, 0.0, 0.0], np.zeros((2, 3))])
def test_invalid_coordinates_of_a_point(position_pa_m):
    with pytest.raises(InputError, match="three finite coordinates"):
        FixedPoint(position_pa_m)
