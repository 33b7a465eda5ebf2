"""Unpublished transmitters: for each pass the candidate with the smallest residuals.

Coherent Doppler determines the uplink: range rates of stations on different sides of the Earth differ by hundreds of
metres per second. One frequency offset per pass is free. The turnaround ratio is determined in the same way, as it
scales the received frequency to that of the uplink.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from radioloc.errors import InputError, error_context
from radioloc.estimation.statistics import robust_scale
from radioloc.measurements.evaluation import prepare_predictor
from radioloc.measurements.observations import DOPPLER, Observations
from radioloc.measurements.predictor import Predictor
from radioloc.measurements.quantised import common_step
from radioloc.study.observation_choice import Uplink, with_transmitter, with_turnaround
from radioloc.study.study import Study
from radioloc.time import Epochs, utc_strings, utc_to_tai
from radioloc.vectors import Floats, Indices

_Rows = Indices
_Candidate = tuple[str, Fraction | None]

_MAX_COUNTS = 200  # counts of a pass, evenly spread, whose residuals are computed
_MIN_VISIBLE_FRACTION = 0.9  # of these with the target above a candidate's horizon
_MAX_RESIDUAL_SPREADS = 5.0  # in an rms: a pass may begin before the lock
_DECISIVE_RATIO = 1.5  # smallest ratio of the rms of other candidates to the best, for a decided pass
# Smallest step of the rate, beyond that of the surrounding counts, at which another station may have begun to transmit.
_MIN_JUMP_M_S = 3.0
# Smallest jump of rates that are multiples of a step: rounding alone causes steps of one, of medians two.
_MIN_JUMP_STEPS = 2.5
_MEDIAN_COUNTS = 9  # in the window of a median
_MIN_PASS_S = 600.0  # shorter passes, as before a lock, do not determine a transmitter


@dataclass(frozen=True, slots=True)
class TransmitterPass:
    """Candidates for the transmitter and the turnaround ratio of a pass at a receiving station."""

    receiver: str
    target: str
    span: Epochs  # first and last count, UTC
    count: int
    # Station (empty for that of the files) and turnaround ratio of each candidate by name.
    candidates: Mapping[str, _Candidate]
    # Rms of the round-trip residual rates by candidate, less one frequency offset; None without visible target.
    rms_m_s: Mapping[str, float | None]
    cycle_m: float | None  # wavelength of the downlink

    @property
    def ranking(self) -> list[str]:
        """Candidates with visible target, the smallest rms first."""
        visible = {name: rms_m_s for name, rms_m_s in self.rms_m_s.items() if rms_m_s is not None}
        return sorted(visible, key=lambda name: visible[name])

    @property
    def decided(self) -> bool:
        """True if the best candidate fits much better than all others."""
        smallest, *larger = ((self.rms_m_s[name] or 0.0) for name in self.ranking)
        return all(rms_m_s >= _DECISIVE_RATIO * smallest for rms_m_s in larger)

    def uplink(self) -> Uplink:
        """Return the best candidate as the uplink of the pass."""
        station, ratio = self.candidates[self.ranking[0]]
        return Uplink(
            self.receiver,
            self.span[[0]],
            self.span[[1]],
            station or None,
            None if ratio is None else (ratio.numerator, ratio.denominator),
            self.target,
        )

    def size(self, name: str) -> str:
        """Return the rms of a candidate, in hertz if the wavelength is available; a dash without visible target."""
        rms_m_s = self.rms_m_s[name]
        if rms_m_s is None:
            return "-"
        return f"{rms_m_s:.3g} m/s" if self.cycle_m is None else f"{rms_m_s / self.cycle_m:.3g} Hz"

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, the selected candidate, and whether the pass is decided."""
        first, last = utc_strings(self.span, decimals=0)
        fields = {key: value for key, value in asdict(self).items() if key not in ("span", "candidates")}
        spans = {"first_utc": str(first), "last_utc": str(last)}
        return fields | spans | {"taken": self.ranking[0], "decided": self.decided}


def compared_transmitters(study: Study, predictor: Predictor) -> list[TransmitterPass]:
    """Compare the candidates of a study in each pass of Doppler; InputError for unknown ones, or if none fits."""
    choice, observations, catalogue = study.observations, predictor.observations, predictor.model.catalogue
    with error_context("[observations] transmitters:"):
        stations = [catalogue.get(name).name for name in choice.transmitters or ()]
    ratios: list[Fraction | None] = [_ratio(text) for text in choice.turnarounds or ()]
    candidates = {
        _name(station, ratio): (station, ratio) for station in stations or [""] for ratio in ratios or [None]
    }
    passes = list(_passes(observations, 3600.0 * study.estimate.pass_gap_h))
    if not passes:
        raise InputError(
            "[observations] transmitters: expected Doppler of a transmitting station, got none; remove the key"
        )
    samples = [rows[np.unique(np.linspace(0, len(rows) - 1, _MAX_COUNTS).astype(int))] for rows in passes]
    sampled = np.concatenate(samples)
    computed_m = {station: _computed_m(study, predictor, sampled, station) for station in stations or [""]}
    rate_m_s = {
        name: (
            with_turnaround(observations, sampled, None if ratio is None else float(ratio))
            - computed_m[station]
        )
        / observations.count_s[sampled]
        for name, (station, ratio) in candidates.items()
    }
    passes_compared, begin = [], 0
    for rows, part in zip(passes, samples, strict=True):
        columns = slice(begin, begin := begin + len(part))
        link = observations.links[observations.link[rows[0]]]
        cycle_m = 1e-6 * float(np.median(observations.wavelength_um[rows]))
        item = TransmitterPass(
            receiver=link.receiver,
            target=link.target,
            span=observations.epoch[rows[[0, -1]]],
            count=len(rows),
            candidates=candidates,
            rms_m_s={name: _rms(column[columns]) for name, column in rate_m_s.items()},
            cycle_m=None if np.isnan(cycle_m) else cycle_m,
        )
        if not item.ranking:
            first, last = utc_strings(item.span, decimals=0)
            raise InputError(
                f"[observations] transmitters: the target is below the horizon of {', '.join(candidates)} while "
                f"{item.receiver} received it, {first} to {last} UTC; add a candidate"
            )
        passes_compared.append(item)
    return passes_compared


def _computed_m(study: Study, predictor: Predictor, rows: _Rows, station: str) -> Floats:
    """Return computed values of some rows for a transmitter, or those of the files; NaN for unusable rows."""
    observations = predictor.observations.select(rows)
    if station:
        changed = with_transmitter(observations, np.arange(len(rows)), station)
        used, link = np.unique(changed.link, return_inverse=True)
        observations = replace(
            changed, links=tuple(changed.links[k] for k in used), link=link.astype(np.int32)
        )
    predictor = prepare_predictor(
        predictor.model, observations, predictor.motions, study.model.evaluation, predictor.targets
    )
    computed = predictor.compute()
    return np.where(computed.usable, computed.value_m, np.nan)


def _passes(observations: Observations, gap_s: float) -> Iterator[_Rows]:
    """Yield the rows of each pass of Doppler of one target at a receiving station, in order of time.

    A pass also ends at a jump of the rate, as when the next station takes over the uplink.
    """
    rows = np.flatnonzero(observations.kind == DOPPLER)
    _, series = np.unique(
        [f"{link.target}>{link.receiver}" for link in observations.links], return_inverse=True
    )
    tai = utc_to_tai(observations.epoch[rows])
    time_s = tai.seconds_since(tai[:1])
    place = series[observations.link[rows]]
    order = np.lexsort((time_s, place))
    rows, time_s = rows[order], time_s[order]
    new = (np.diff(place[order]) != 0) | (np.diff(time_s) > gap_s)
    rate_m_s = observations.value_m[rows] / observations.count_s[rows]
    for part in np.split(np.arange(len(rows)), np.flatnonzero(new) + 1) if len(rows) else ():
        yield from np.split(rows[part], _jumps(time_s[part], rate_m_s[part]))


def _jumps(time_s: Floats, rate_m_s: Floats) -> list[int]:
    """Return indices of jumps of the rate and of gaps, at least ten minutes from each other and from the ends."""
    from scipy.ndimage import median_filter

    cuts: list[int] = []
    if len(rate_m_s) > 2:
        step_s = np.maximum(np.diff(time_s), 1e-3)
        usual_m_s = step_s * median_filter(np.diff(rate_m_s) / step_s, _MEDIAN_COUNTS, mode="nearest")
        # Medians suppress single outliers, but leave steps of twice the usual size beside them.
        beyond_m_s = np.diff(median_filter(rate_m_s, _MEDIAN_COUNTS, mode="nearest")) - usual_m_s
        rounding_m_s = _MIN_JUMP_STEPS * common_step(rate_m_s, _MIN_JUMP_M_S / _MIN_JUMP_STEPS)
        limit_m_s = np.maximum(
            2.0 * np.abs(usual_m_s),
            max(_MIN_JUMP_M_S, rounding_m_s, _MAX_RESIDUAL_SPREADS * robust_scale(beyond_m_s, 1)),
        )
        gaps = step_s > np.maximum(_MIN_PASS_S, 5.0 * np.median(step_s))  # steps over a gap are meaningless
        for k in (np.flatnonzero((np.abs(beyond_m_s) > limit_m_s) | gaps) + 1).tolist():
            start_s = time_s[cuts[-1] if cuts else 0]
            if min(time_s[k] - start_s, time_s[-1] - time_s[k]) >= _MIN_PASS_S:
                cuts.append(k)
    return cuts


def _ratio(text: str) -> Fraction:
    try:
        ratio = Fraction(text)
    except (ValueError, ZeroDivisionError):
        ratio = Fraction(0)
    if not ratio > 0:
        raise InputError(
            f'[observations] turnarounds: expected downlink over uplink frequency, such as "880/749", got {text!r}'
        )
    return ratio


def _name(station: str, ratio: Fraction | None) -> str:
    return " ".join(part for part in (station, "" if ratio is None else str(ratio)) if part)


def _rms(rate_m_s: Floats) -> float | None:
    """Return the rms about an offset, without outliers; None if too few rates are computed."""
    computed = rate_m_s[~np.isnan(rate_m_s)]
    if len(computed) < max(_MIN_VISIBLE_FRACTION * len(rate_m_s), 1):
        return None
    offsets = computed - np.median(computed)
    inliers = offsets[np.abs(offsets) <= _MAX_RESIDUAL_SPREADS * max(robust_scale(offsets, 1), 1e-12)]
    return float(np.sqrt(np.square(inliers - inliers.mean()).mean()))
