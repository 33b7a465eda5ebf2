"""Clocks that nothing ties together: how they differ is estimated unless a study says otherwise.

Three-way Doppler is counted against the receiving station's frequency standard and transmitted by another's; one-way
Doppler has the target's oscillator at its start. An offset of 1e-12, usual of all but hydrogen masers, moves a lander
by hundreds of metres, a listener's quartz by more than the Moon is large, and the residuals do not show it. Where there
are delays of quasars, the stations' clocks, by which they are off by some microseconds, are in all delays still.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import kind_of
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.design import tracking_of
from radioloc.parameters.kind import Scope
from radioloc.parameters.rows import networks
from radioloc.studies.study import EstimateChoice, Study

_RATE_SIGMA = 1e-11
"""Ten times that of a hydrogen maser which nobody has set; from one scan of each target a rate is not told."""


def with_independent_clocks(study: Study, estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """The same with what tells clocks apart that are independent: frequency offsets, and clocks beside quasars.

    Unless the study wants nothing by default (``[consider] defaults = false``).
    """
    if not study.consider_defaults:
        return estimate
    tracking, estimated, considered = tracking_of(arc), set(estimate.parameters), set(study.consider)
    chosen = _frequency_offsets(estimated | (considered & {"frequency_offset"}), tracking)
    chosen |= _clocks(estimated | considered, tracking)
    return replace(estimate, parameters={**estimate.parameters, **chosen}) if chosen else estimate


def _frequency_offsets(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """A free one for each link and pass of one- and three-way Doppler.

    Unless frequency offsets are estimated, held or considered, or clock rates estimated; of one-way Doppler also unless
    the target's frequency is.
    """
    if said & {"frequency_offset", "clock_rate"}:
        return {}
    observations = tracking.observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in said:
        free |= observations.kind == kind_of("one_way_doppler")
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    return {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)} if paths else {}


def _clocks(said: set[str], tracking: Predictor) -> dict[str, ParameterChoice]:
    """Offsets, free, and rates of the stations that have delays of quasars, but for the first, unless any are said."""
    of_quasars = (tracking.target < 0) & (tracking.observations.kind == kind_of("vlbi_delay"))
    if said & {"clock", "clock_rate"} or not of_quasars.any():
        return {}
    ends = np.stack([tracking.transmitters, tracking.receivers], axis=-1)[of_quasars]
    network, there = networks(ends, len(tracking.stations)), np.unique(ends)
    first = {network[k]: k for k in there[::-1]}
    names = tuple(tracking.stations[k] for k in there if first[network[k]] != k)
    return {"clock": ParameterChoice(names), "clock_rate": ParameterChoice(names, sigma=_RATE_SIGMA)}
