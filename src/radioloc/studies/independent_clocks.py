"""Doppler between two oscillators that nothing ties together: their offset is estimated unless a study says otherwise.

Three-way Doppler is counted against the receiving station's frequency standard and transmitted by another's; one-way
Doppler has the target's oscillator at its start. An offset of 1e-12, usual of all but hydrogen masers, moves a lander
by hundreds of metres, a listener's quartz by more than the Moon is large, and the residuals do not show it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import kind_of
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.design import tracking_of
from radioloc.parameters.kind import Scope
from radioloc.studies.study import EstimateChoice, Study


def with_frequency_offsets(study: Study, estimate: EstimateChoice, arc: Predictor) -> EstimateChoice:
    """The same with a free frequency offset for each link and pass of one- and three-way Doppler.

    Unless the study estimates, holds or considers frequency offsets, estimates clock rates, or wants nothing by default
    (``[consider] defaults = false``); of one-way Doppler also unless it has the target's frequency.
    """
    said = estimate.parameters.keys() | (study.consider.keys() & {"frequency_offset"})
    if not study.consider_defaults or said & {"frequency_offset", "clock_rate"}:
        return estimate
    observations = tracking_of(arc).observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in said:
        free |= observations.kind == kind_of("one_way_doppler")
    if not free.any():
        return estimate
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    chosen = {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)}
    return replace(estimate, parameters={**estimate.parameters, **chosen})
