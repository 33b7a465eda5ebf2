"""The light-time solution and its partials against 40 digits."""

import mpmath as mp
import numpy as np
import pytest

from radioloc.constants import C_M_S
from radioloc.errors import ConvergenceError
from radioloc.measurements.light_path import (
    BOUNCE,
    RECEIVE,
    TRANSMIT,
    MovingPoint,
    Signal,
    path_length_partials,
    solve_light_path,
)

# Positions of 4e8 m have a last place of 6e-8 m, durations of 1.3 s one of 2.2e-16 s = 7e-8 m.
FEW_LAST_PLACES_M = 3e-7
# The partials are the exact derivatives of the equations that are solved; only round-off remains.
PARTIALS_RELATIVE = 1e-11
TAGS = {"transmit": TRANSMIT, "receive": RECEIVE, "bounce": BOUNCE}
UP_DELAY_M, DOWN_DELAY_M = 9.25, 11.5


def moving(offset_s, position_m, velocity_m_s):
    return MovingPoint(np.array([offset_s]), np.array([position_m]), np.array([velocity_m_s]))


# Two stations and a point on the Moon: barycentric positions some seconds from the tag, and velocities.
TRANSMITTER = moving(-0.4, [4.1e6, -2.2e6, 4.3e6], [2.1e4, -2.0e4, -8.7e3])
RELAY = moving(1.1, [2.6e8, 2.5e8, -1.1e8], [2.05e4, -1.95e4, -8.9e3])
RECEIVER = moving(2.7, [-3.9e6, 3.0e6, 4.1e6], [2.13e4, -2.08e4, -8.7e3])


HOLD_S = 1.3e-6


def path_to_40_digits(
    tag,
    sign=1,
    tag_offset_s=0.3,
    move_m=(0, 0, 0),
    hold_s=0.0,
    up_delay_m=UP_DELAY_M,
    down_delay_m=DOWN_DELAY_M,
):
    """Up and down in seconds by repeated substitution in 40 digits; with sign -1 "up" runs from the point, too."""
    with mp.workdps(40):

        def at(point, t):
            return [
                mp.mpf(float(p)) + mp.mpf(float(v)) * (t - mp.mpf(float(point.offset_s[0]))) + d
                for p, v, d in zip(
                    point.position_m[0],
                    point.velocity_m_s[0],
                    move_m if point is RELAY else (0, 0, 0),
                    strict=True,
                )
            ]

        def length(a, b):
            return mp.sqrt(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)))

        c = mp.mpf(C_M_S)
        tagged, hold = mp.mpf(tag_offset_s), mp.mpf(hold_s)
        up = down = mp.mpf("1.3")
        for _ in range(14):  # contracts by 1e-4 each time
            bounce = {TRANSMIT: tagged + sign * up, RECEIVE: tagged - down - hold, BOUNCE: tagged}[tag]
            leave = bounce + hold
            up = (length(at(RELAY, bounce), at(TRANSMITTER, bounce - sign * up)) + mp.mpf(up_delay_m)) / c
            down = (length(at(RECEIVER, leave + down), at(RELAY, leave)) + mp.mpf(down_delay_m)) / c
        return up, down, bounce


def solve(tag, sign=1, tag_offset_s=0.3, hold_s=0.0):
    tags, offsets_s = np.array([tag], dtype=np.int8), np.array([tag_offset_s])
    signal = Signal(TRANSMITTER, RELAY, RECEIVER, tags, offsets_s, sign, hold_s)
    return solve_light_path(signal, UP_DELAY_M, DOWN_DELAY_M)


# A differenced delay has no transponder delay.
both_signs = pytest.mark.parametrize(
    ("sign", "hold_s"),
    [(1, 0.0), (1, HOLD_S), (-1, 0.0)],
    ids=["range", "range over a transponder", "differenced delay"],
)


@both_signs
@pytest.mark.parametrize("tag", TAGS.values(), ids=TAGS)
def test_solution_against_40_digits(tag, sign, hold_s):
    up, down, bounce = path_to_40_digits(tag, sign, hold_s=hold_s)
    path = solve(tag, sign, hold_s=hold_s)
    assert abs(float(path.up_s[0] - up)) * C_M_S < FEW_LAST_PLACES_M
    assert abs(float(path.down_s[0] - down)) * C_M_S < FEW_LAST_PLACES_M
    assert float(path.bounce_s[0]) == pytest.approx(float(bounce), rel=0, abs=1e-15)
    assert path.transmit_s[0] == pytest.approx(path.bounce_s[0] - sign * path.up_s[0], rel=0, abs=1e-15)
    assert path.receive_s[0] == pytest.approx(path.bounce_s[0] + hold_s + path.down_s[0], rel=0, abs=1e-15)
    tagged = {TRANSMIT: path.transmit_s, RECEIVE: path.receive_s, BOUNCE: path.bounce_s}[tag]
    assert tagged.tolist() == [0.3]


def test_paths_with_mixed_tags_equal_separate_ones():
    tags = np.array([TRANSMIT, RECEIVE, BOUNCE], dtype=np.int8)
    three = [
        MovingPoint(*(np.repeat(a, 3, axis=0) for a in (p.offset_s, p.position_m, p.velocity_m_s)))
        for p in (TRANSMITTER, RELAY, RECEIVER)
    ]
    mixed = solve_light_path(Signal(*three, tags, np.full(3, 0.3)), UP_DELAY_M, DOWN_DELAY_M)
    separate = [solve(tag) for tag in tags]
    assert mixed.up_s == pytest.approx([a.up_s[0] for a in separate], rel=0, abs=1e-15)
    assert mixed.down_s == pytest.approx([a.down_s[0] for a in separate], rel=0, abs=1e-15)
    partials = path_length_partials(mixed, *three, tags)
    for row in range(3):
        expected = path_length_partials(separate[row], TRANSMITTER, RELAY, RECEIVER, tags[row : row + 1])
        np.testing.assert_allclose(partials.by_position[row], expected.by_position[0], rtol=0, atol=1e-13)
        np.testing.assert_allclose(partials.by_tag[row], expected.by_tag[0], rtol=0, atol=1e-8)


@both_signs
@pytest.mark.parametrize("tag", TAGS.values(), ids=TAGS)
def test_partials_against_40_digits(tag, sign, hold_s):
    path = solve(tag, sign, hold_s=hold_s)
    analytic = path_length_partials(path, TRANSMITTER, RELAY, RECEIVER, np.array([tag], dtype=np.int8), sign)
    with mp.workdps(40):

        def slope(step, **changed):
            """Central difference; its error, step^2 over distance^2, is 1e-17 by length and 1e-13 by time."""
            lengths = []
            for sense in (1, -1):
                changes = {"hold_s": mp.mpf(hold_s)} | {
                    key: value(sense * step) for key, value in changed.items()
                }
                up, down, _ = path_to_40_digits(tag, sign, **changes)
                lengths.append(mp.mpf(C_M_S) * (sign * up + changes["hold_s"] + down))
            return float((lengths[0] - lengths[1]) / (2 * step))

        metre, second = mp.mpf(1), mp.mpf("1e-3")
        by_position = [
            slope(metre, move_m=lambda s, k=k: [s * (k == axis) for axis in range(3)]) for k in range(3)
        ]
        by_tag = slope(second, tag_offset_s=lambda s: mp.mpf(0.3) + s)
        by_up = slope(metre, up_delay_m=lambda s: mp.mpf(UP_DELAY_M) + s)
        by_down = slope(metre, down_delay_m=lambda s: mp.mpf(DOWN_DELAY_M) + s)
        by_hold = slope(second, hold_s=lambda s: mp.mpf(hold_s) + s)
    assert np.linalg.norm(analytic.by_position[0] - by_position) < PARTIALS_RELATIVE * np.linalg.norm(
        by_position
    )
    assert abs(analytic.by_tag[0] - by_tag) < PARTIALS_RELATIVE * abs(by_tag)
    assert abs(analytic.by_up_delay[0] - by_up) < PARTIALS_RELATIVE
    assert abs(analytic.by_down_delay[0] - by_down) < PARTIALS_RELATIVE
    if sign > 0:
        assert abs(analytic.by_hold[0] - by_hold) < PARTIALS_RELATIVE * C_M_S


@pytest.mark.parametrize("broken", ["transmitter", "relay", "receiver"])
def test_nan_is_not_converged(broken):
    points = {"transmitter": TRANSMITTER, "relay": RELAY, "receiver": RECEIVER}
    points[broken] = moving(0.0, [np.nan, 0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(ConvergenceError, match="1 of 1 paths"):
        solve_light_path(Signal(*points.values(), np.zeros(1, dtype=np.int8), np.zeros(1)), 0.0, 0.0)


def test_points_near_the_speed_of_light_do_not_converge():
    fast = moving(0.0, [1e8, 0.0, 0.0], [0.9 * C_M_S, 0.0, 0.0])
    with pytest.raises(ConvergenceError, match="1 of 1 paths"):
        solve_light_path(
            Signal(TRANSMITTER, fast, RECEIVER, np.zeros(1, dtype=np.int8), np.zeros(1)), 0.0, 0.0
        )
