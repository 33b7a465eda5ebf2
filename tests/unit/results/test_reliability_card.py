"""Lines of the card on reliability."""

import math

from radioloc.estimation.reliability import Reliability
from radioloc.results.reliability_card import reliability_lines


def item(
    name, minimal, unit="m", *, shift_m=1.0, per_unit_m=1.0, kind="parameter", components=("",), sigma=None
):
    return Reliability(kind, name, components, unit, minimal, shift_m, per_unit_m, sigma)


def test_the_smallest_error_and_the_largest_effect_of_each_kind_are_named():
    sizes, effect, hidden = reliability_lines(
        [
            item("range_bias.A", 4.0, shift_m=20.0),
            item("range_bias.B", 3.0),
            item("clock.C", 2e-9, "s"),
            item("moon_position.radial", 500.0, shift_m=400.0),  # no fault of a station, link or target
            item("range_bias.range", 1.0),  # of a type
            item("time_bias.all", 5e-3, "s", shift_m=120.0),
            item("transponder_delay", math.inf, "s", per_unit_m=1.5e8, sigma=1e-8),
            item("term.troposphere", 0.1, "1", shift_m=500.0),  # switched off by the user
        ]
    )
    assert (
        sizes
        == "smallest detectable errors (power 80 %): clock 2 ns (C), range bias 3 m (B), time bias 5 ms (common)"
    )
    effects = "120 m (common time bias, 5 ms), 20.0 m (range bias of A, 4 m), 1.00 m (clock of C, 2 ns)"
    assert effect == f"largest effects of undetected errors: {effects}"
    assert hidden == "not revealed: transponder delay (0.150 m of position per ns, sigma 10 ns)"
