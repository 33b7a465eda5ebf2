"""Offsets of clocks that nothing ties together, which are estimated unless a study states otherwise.

Three-way Doppler is counted against the receiving station's frequency standard and transmitted by another's; one-way
Doppler begins with the target's oscillator. An offset of 1e-12, typical of all but hydrogen masers, moves a lander by
hundreds of metres, a receiver's quartz by more than the lunar radius, and the residuals do not show it. Where quasar
delays are present, the stations' clock offsets of some microseconds remain in all delays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import kind_of
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.kind import Scope
from radioloc.parameters.rows import networks
from radioloc.study.study import EstimateChoice, Study

_CLOCK_RATE_SIGMA = 1e-11
"""Ten times that of an unsteered hydrogen maser; a single scan per source cannot determine a rate."""


def with_independent_clocks(study: Study, estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """Return the choice with offsets of independent clocks, unless ``[consider] defaults = false``.

    Held at zero, offsets of 1e-11 displace the estimate unnoticed (`tests/unit/jobs/test_independent_clocks.py`).
    """
    if not study.consider_defaults:
        return estimate
    estimated, considered = set(estimate.parameters), set(study.consider)
    chosen = _frequency_offsets(estimated | (considered & {"frequency_offset"}), arc)
    chosen |= _clocks(estimated | considered, arc)
    return replace(estimate, parameters={**estimate.parameters, **chosen}) if chosen else estimate


def _frequency_offsets(stated: set[str], arc: Predictor) -> dict[str, ParameterChoice]:
    """Return a free offset for each link and pass of one- and three-way Doppler, unless the study states its own."""
    if stated & {"frequency_offset", "clock_rate"}:
        return {}
    observations = arc.observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in stated:
        free |= observations.kind == kind_of("one_way_doppler")
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    return {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)} if paths else {}


def _clocks(stated: set[str], arc: Predictor) -> dict[str, ParameterChoice]:
    """Return free offsets and rates of stations with quasar delays, but for the first of each network."""
    of_quasars = (arc.target < 0) & (arc.observations.kind == kind_of("vlbi_delay"))
    if stated & {"clock", "clock_rate"} or not of_quasars.any():
        return {}
    ends = np.stack([arc.transmitters, arc.receivers], axis=-1)[of_quasars]
    network, stations = networks(ends, len(arc.stations)), np.unique(ends)
    references = {network[k]: k for k in stations[::-1]}
    names = tuple(arc.stations[k] for k in stations if references[network[k]] != k)
    return {"clock": ParameterChoice(names), "clock_rate": ParameterChoice(names, sigma=_CLOCK_RATE_SIGMA)}
