"""Measurement noise of a study, errors that delays of one epoch share, and offsets of independent clocks.

The error of a VLBI station's arrival time (its receiver, its clock, the air above it) is in every delay of that epoch
which the station has part in, with one sign as the second station and the other as the first. Likewise the error of how
much that time grows over a count interval is in every delay rate of that epoch and interval. The error of the phase
between two contiguous counts of Doppler is in both.

Offsets of clocks that nothing ties together are estimated unless a study states otherwise. Three-way Doppler is counted
against the receiving station's frequency standard and transmitted by another's; one-way Doppler begins with the
target's oscillator. An offset of 1e-12, typical of all but hydrogen masers, moves a lander by hundreds of metres, a
receiver's quartz by more than the lunar radius, and the residuals do not show it. Where quasar delays are present, the
stations' clock offsets of some microseconds remain in all delays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from radioloc.errors import InputError, error_context
from radioloc.estimation.noise_structure import SAME_EPOCH_S, epoch_numbers
from radioloc.labels import changed
from radioloc.measurements.observations import DOPPLER, VLBI_DELAY, VLBI_DELAY_RATE
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.registry import kind_of
from radioloc.noise import ALONE, DopplerPhase, NoiseTerm, ObservationCovariance, SharedAtEpoch, White
from radioloc.parameters.choice import ParameterChoice
from radioloc.parameters.kind import Scope
from radioloc.parameters.rows import networks
from radioloc.study.observation_choice import ObservationChoice
from radioloc.study.study import EstimateChoice, Study
from radioloc.time import Epochs, utc_to_tai
from radioloc.vectors import Floats, Indices

_CLOCK_RATE_SIGMA = 1e-11
"""Ten times that of an unsteered hydrogen maser; a single scan per source cannot determine a rate."""


def with_independent_clocks(study: Study, estimate: EstimateChoice, predictor: Predictor) -> EstimateChoice:
    """Return the choice with offsets of independent clocks, unless ``[consider] defaults = false``.

    Held at zero, offsets of 1e-11 displace the estimate unnoticed (`tests/unit/jobs/test_independent_clocks.py`).
    """
    if not study.consider_defaults:
        return estimate
    estimated, considered = set(estimate.parameters), set(study.consider)
    chosen = _frequency_offsets(estimated | (considered & {"frequency_offset"}), predictor)
    chosen |= _clocks(estimated | considered, predictor)
    return replace(estimate, parameters={**estimate.parameters, **chosen}) if chosen else estimate


def _frequency_offsets(stated: set[str], predictor: Predictor) -> dict[str, ParameterChoice]:
    """Return a free offset for each link and pass of one- and three-way Doppler, unless the study states its own."""
    if stated & {"frequency_offset", "clock_rate"}:
        return {}
    observations = predictor.observations
    three_way = [bool(link.transmitter) and link.transmitter != link.receiver for link in observations.links]
    free = (observations.kind == kind_of("doppler")) & np.array(three_way)[observations.link]
    if "target_frequency" not in stated:
        free |= observations.kind == kind_of("one_way_doppler")
    paths = tuple(observations.links[k].path for k in np.unique(observations.link[free]))
    return {"frequency_offset": ParameterChoice(paths, per=Scope.LINK_AND_PASS)} if paths else {}


def _clocks(stated: set[str], predictor: Predictor) -> dict[str, ParameterChoice]:
    """Return free offsets and rates of stations with quasar delays, but for the first of each network."""
    of_quasars = (predictor.target < 0) & (predictor.observations.kind == kind_of("vlbi_delay"))
    if stated & {"clock", "clock_rate"} or not of_quasars.any():
        return {}
    ends = np.stack([predictor.transmitters, predictor.receivers], axis=-1)[of_quasars]
    network, stations = networks(ends, len(predictor.stations)), np.unique(ends)
    references = {network[k]: k for k in stations[::-1]}
    names = tuple(predictor.stations[k] for k in stations if references[network[k]] != k)
    return {"clock": ParameterChoice(names), "clock_rate": ParameterChoice(names, sigma=_CLOCK_RATE_SIGMA)}


_CONTIGUOUS = 0.01
"""Part of a count interval up to which the next count may begin earlier or later than it ends."""


@runtime_checkable
class NoiseSource(Protocol):
    """Record of a table of a study (:class:`~radioloc.study.StudyTable`) that adds noise to its observations."""

    def noise_term(self, predictor: Predictor) -> White | NoiseTerm:
        """Return the errors of the observations of a prepared arc that the table stands for."""
        ...


def observation_covariance(study: Study, predictor: Predictor) -> ObservationCovariance:
    """Covariance of a study's arc: that of its observations, and the terms of tables of other packages."""
    sources = [record for record in study.extensions.values() if isinstance(record, NoiseSource)]
    return stated_noise(predictor, study.observations).plus(
        *(source.noise_term(predictor) for source in sources)
    )


def stated_noise(predictor: Predictor, choice: ObservationChoice) -> ObservationCovariance:
    """Covariance of an arc's observations: stated sigmas, additions of the study, shared errors."""
    terms: list[NoiseTerm] = []
    n = len(predictor.transmitters)
    source = np.stack([predictor.transmitters, predictor.receivers], axis=-1)
    for kind, key in ((VLBI_DELAY, "vlbi_station_sigma_m"), (VLBI_DELAY_RATE, "vlbi_station_rate_sigma_m")):
        rows = np.flatnonzero(predictor.observations.kind == kind)
        ends_m = _ends_m(predictor, key, getattr(choice, key), rows)
        if not ends_m.any():
            continue
        number = same_epoch(predictor.observations.epoch[rows])
        if kind == VLBI_DELAY_RATE:
            keys = np.stack([number, predictor.observations.count_s[rows]], axis=1)
            _, number = np.unique(keys, axis=0, return_inverse=True)
        group, effect_m = np.full(n, ALONE, dtype=np.int32), np.zeros((n, 2))
        group[rows] = number.reshape(-1)
        effect_m[rows] = ends_m * [-1.0, 1.0]
        terms.append(SharedAtEpoch(group, source, effect_m))
    sigma_m = predictor.observations.sigma_m
    white = White(np.hypot(sigma_m, choice.extra_sigma_m) if choice.extra_sigma_m else sigma_m)
    return ObservationCovariance((white, *terms, *_phase_noise(predictor, choice)))


def _phase_noise(predictor: Predictor, choice: ObservationChoice) -> Iterator[DopplerPhase]:
    """Noise of the phase that Doppler is counted of, which contiguous counts of a link share; none where not stated."""
    observations = predictor.observations
    rows = np.flatnonzero(np.isin(observations.kind, [DOPPLER, kind_of("one_way_doppler")]))
    n = len(observations.kind)
    phase_m = _ends_m(predictor, "doppler_phase_sigma_m", choice.doppler_phase_sigma_m, rows)[:, 1]
    rows, phase_m = rows[phase_m > 0.0], phase_m[phase_m > 0.0]
    if not len(rows):
        return
    tai, count_s = utc_to_tai(observations.epoch), observations.count_s
    time_s = tai.seconds_since(tai[:1])
    order = np.lexsort((time_s[rows], observations.link[rows], observations.kind[rows]))
    rows, phase_m = rows[order], phase_m[order]
    new = changed(observations.kind[rows], observations.link[rows])
    silent_s = np.diff(time_s[rows]) - 0.5 * (count_s[rows[:-1]] + count_s[rows[1:]])
    joined = np.abs(silent_s) <= _CONTIGUOUS * np.minimum(count_s[rows[:-1]], count_s[rows[1:]])
    sigma_m, link, start = np.zeros(n), np.full(n, ALONE), np.zeros(n, dtype=np.intp)
    sigma_m[rows], link[rows] = phase_m, np.cumsum(new) - 1
    # A count begins with the phase at which the one before it ends, or with one of its own.
    start[rows[1:]] = np.cumsum(np.where(joined, 1, 2))
    yield DopplerPhase(sigma_m, link, start, start + 1)


def _ends_m(predictor: Predictor, key: str, sigma: float | Mapping[str, float], rows: Indices) -> Floats:
    """Error of the first and of the second station of some observations, shape (n, 2)."""
    if not isinstance(sigma, Mapping):
        return np.full((len(rows), 2), sigma)
    with error_context(f"[observations] {key}:"):
        sigma_m = {predictor.model.catalogue.get(name).name: sigma for name, sigma in sigma.items()}
    of_station_m = np.array([sigma_m.get(name, 0.0) for name in predictor.stations])
    return of_station_m[np.stack([predictor.transmitters[rows], predictor.receivers[rows]], axis=-1)]


def same_epoch(epoch: Epochs) -> Indices:
    """Return the number of the epoch of each time tag (UTC) of delays, in order of time, shape (n,)."""
    tai = utc_to_tai(epoch)
    elapsed_s = tai.seconds_since(tai[np.zeros(len(tai), dtype=int)])
    number = epoch_numbers(elapsed_s).astype(np.intp)
    first_s = np.full(number.max() + 1, np.inf)
    np.minimum.at(first_s, number, elapsed_s)
    if (elapsed_s - first_s[number]).max() > SAME_EPOCH_S:
        raise InputError(
            "VLBI delays or their rates are closer than 0.1 s, so that those of one epoch cannot be found; leave "
            "[observations] vlbi_station_sigma_m and vlbi_station_rate_sigma_m out"
        )
    return number
