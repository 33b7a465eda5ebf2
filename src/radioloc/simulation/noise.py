"""Random errors of simulated observations: white, coloured and flicker noise, random walks and outliers.

The stream of random numbers of a series depends on the seed and on a label: kind, link or station, first epoch and step
of the session. The errors of a link are therefore independent of the other links, of their order, and of the visible
part of the session. Series run over all epochs of a session.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.measurements.observations import Observations
from radioloc.measurements.registry import KINDS, is_integrated
from radioloc.noise import (
    ALONE,
    NONE,
    DopplerPhase,
    GaussMarkov,
    NoiseTerm,
    ObservationCovariance,
    Process,
    White,
)
from radioloc.noise.processes import recursions
from radioloc.quantities import convert_fields
from radioloc.simulation.schedule import Plan
from radioloc.time import utc_to_tai
from radioloc.vectors import Floats, Indices, Mask

_STEP_TOLERANCE = 1e-6  # of a whole number of steps
_PROCESSES_PER_DECADE = 2  # of correlation times, for flicker noise


@dataclass(frozen=True, slots=True)
class Noise:
    """Sum of the random errors of one series."""

    white_m: float = 0.0  #: standard deviation, independent between epochs
    #: Standard deviation of a stationary first-order Gauss-Markov process with the autocovariance
    #: ``coloured_m^2 exp(-|dt| / correlation_s)``.
    coloured_m: float = 0.0
    correlation_s: float = 0.0
    #: Random walk from zero at the start of the session, m per square root of a second.
    walk_m_sqrt_s: float = 0.0
    outlier_fraction: float = 0.0  #: of the epochs
    outlier_m: float = 0.0  #: uniform between half and 1.5 times this size, of either sign
    #: Standard deviation of flicker noise, of spectral density 1/f, in each decade of frequency from one over the
    #: length of the session to one over the step.
    flicker_m: float = 0.0
    #: Standard deviation of the phase at either end of a count interval: contiguous counts share a phase with opposite
    #: signs, and have the correlation -1/2.
    phase_m: float = 0.0

    def __post_init__(self) -> None:
        convert_fields(self)
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"noise: {name}: expected a number of at least 0, got {value!r}")
        if self.outlier_fraction > 1.0:
            raise InputError(f"noise: outlier_fraction: expected 0 to 1, got {self.outlier_fraction}")
        if self.coloured_m > 0.0 and self.correlation_s == 0.0:
            raise InputError("noise: coloured_m needs correlation_s; use white_m for uncorrelated noise")

    def processes(self, n: int, step_s: float, start_s: float) -> list[Process]:
        """Return the correlated parts, except the phase, for n epochs from a start."""
        correlated = [Process(sigma_m**2, tau_s) for _, sigma_m, tau_s in self._gauss_markov(n, step_s)]
        if self.walk_m_sqrt_s:
            correlated.append(Process(walk_m2_s=self.walk_m_sqrt_s**2, start_s=start_s))
        return correlated

    def _gauss_markov(self, n: int, step_s: float) -> list[tuple[str, float, float]]:
        """Return names, sigmas, m, and correlation times, s, of the Gauss-Markov processes."""
        processes = [("coloured", self.coloured_m, self.correlation_s)] if self.coloured_m else []
        if self.flicker_m:
            # Processes with logarithmically spaced correlation times sum to 1/f (van der Ziel 1950).
            times = max(1, math.ceil(_PROCESSES_PER_DECADE * math.log10(max(n, 2)))) + 1
            sigma_m = self.flicker_m / math.sqrt(_PROCESSES_PER_DECADE)
            taus_s = (step_s * 10.0 ** (k / _PROCESSES_PER_DECADE) for k in range(times))
            processes += [(f"flicker {k}", sigma_m, tau_s) for k, tau_s in enumerate(taus_s)]
        return processes

    def series(
        self, n: int, step_s: float, seeds: Sequence[int], label: str, count_s: float = math.nan
    ) -> tuple[Floats, Mask]:
        """Return a realization for each seed at n epochs of equal step, m, and its outliers, both (seeds, n).

        Series with different labels are independent. `count_s` is the count interval.
        """
        error_m = np.zeros((len(seeds), n))
        is_outlier = np.zeros((len(seeds), n), dtype=bool)

        def normal(part: str, count: int = n) -> Floats:
            return np.array([generator(seed, f"{label} {part}").standard_normal(count) for seed in seeds])

        if self.white_m:
            error_m += self.white_m * normal("white")
        if self.phase_m and (steps := steps_in_count(count_s, step_s)):
            phase = normal("phase", n + steps)
            error_m += self.phase_m * (phase[:, steps:] - phase[:, :-steps])
        elif self.phase_m:
            error_m += self.phase_m * (normal("phase") - normal("phase at the start"))
        for name, sigma_m, tau_s in self._gauss_markov(n, step_s):
            error_m += sigma_m * gauss_markov(normal(name), math.exp(-step_s / tau_s))
        if self.walk_m_sqrt_s:
            walk = normal("walk")
            walk[:, :1] = 0.0
            error_m += self.walk_m_sqrt_s * math.sqrt(step_s) * np.cumsum(walk, axis=-1)
        if self.outlier_fraction and self.outlier_m:
            for k, seed in enumerate(seeds):
                random = generator(seed, f"{label} outliers")
                is_outlier[k] = random.random(n) < self.outlier_fraction
                rows = np.flatnonzero(is_outlier[k])
                size, positive = random.random(n), random.integers(0, 2, n)
                error_m[k, rows] += self.outlier_m * (0.5 + size[rows]) * (2.0 * positive[rows] - 1.0)
        return error_m, is_outlier


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Random errors of all observations."""

    #: By kind of measurement: errors of each link, independent between links.
    link: Mapping[str, Noise] = field(default_factory=dict)
    #: Errors of the arrival times at each VLBI station (clock, instrument, atmosphere): a delay has that of its second
    #: station less that of its first, so that they cancel around a triangle.
    vlbi_station: Noise = field(default_factory=Noise)
    #: Errors of the change of the arrival time over a count interval, for delay rates.
    vlbi_station_rate: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        for kind in self.link:
            if kind not in KINDS:
                raise InputError(f"noise of {kind!r}: expected one of {', '.join(KINDS)}")
        is_counted = {kind: bool(is_integrated(np.array(k))) for k, kind in enumerate(KINDS)}
        stations = {"vlbi_station": self.vlbi_station, "vlbi_station_rate": self.vlbi_station_rate}
        for name, noise in {**self.link, **stations}.items():
            if noise.phase_m and not is_counted.get(name, False):
                raise InputError(
                    f"noise of {name}: phase_m applies to counted measurements such as Doppler; use white_m"
                )

    def unstated(self, observations: Observations) -> list[str]:
        """Return the types of observations for which no noise of their own is stated."""
        return [kind for kind in dict.fromkeys(observations.types()) if kind not in self.link]

    def notes(self, observations: Observations) -> list[str]:
        """Return a sentence for each type of observations that is simulated without noise."""
        return [
            f"[simulation.noise.{kind}] is not given: values without noise"
            for kind in self.unstated(observations)
        ]

    def covariance(self, plan: Plan) -> ObservationCovariance:
        """Return the covariance of the errors without outliers; series without noise have the sigma of the schedule."""
        observations = plan.observations
        n, tai = len(observations), utc_to_tai(observations.epoch)
        time_s = tai.seconds_since(tai[:1])
        white_m2, phase_m = np.zeros(n), np.zeros(n)
        link, start, end = np.full(n, ALONE), np.zeros(n, dtype=np.intp), np.ones(n, dtype=np.intp)
        processes: list[Process] = []
        entries: list[tuple[Indices, int, float]] = []
        for number, series in enumerate(NoiseDraws.from_plan(self, plan).series):
            _, rows, slot = series.uses[0]
            begin_s = float(time_s[rows[0]] - series.step_s * slot[0])
            noise = series.noise
            correlated = noise.processes(series.epochs, series.step_s, begin_s)
            if noise.phase_m and (steps := steps_in_count(series.count_s, series.step_s)):
                link[rows], phase_m[rows] = number, noise.phase_m
                start[rows], end[rows] = slot, slot + steps
            else:
                white_m2[rows] += 2.0 * noise.phase_m**2
            if len(series.uses) == 1:
                white_m2[rows] += noise.white_m**2
            elif noise.white_m:
                correlated.append(Process(noise.white_m**2))
            for process in correlated:
                entries += [(rows, len(processes), sign) for sign, rows, _ in series.uses]
                processes.append(process)
        count = np.bincount(
            np.concatenate([rows for rows, _, _ in entries] or [np.zeros(0, int)]), minlength=n
        )
        indices = np.full((n, count.max(initial=0)), NONE)
        signs = np.zeros(indices.shape)
        for rows, number, sign in entries:
            count[rows] -= 1
            indices[rows, count[rows]], signs[rows, count[rows]] = number, sign
        terms: list[NoiseTerm] = []
        if processes:
            terms.append(GaussMarkov(time_s, indices, signs, tuple(processes)))
        if phase_m.any():
            terms.append(DopplerPhase(phase_m, link, start, end))
        total_m2 = sum((term.variance_m2 for term in terms), white_m2)
        white_m = np.sqrt(np.where(total_m2 > 0.0, white_m2, observations.sigma_m**2))
        return ObservationCovariance((White(white_m), *terms))

    def draw(self, plan: Plan, seed: int) -> tuple[Floats, Mask]:
        """Return a realization for the plan, m, and the observations with outliers, both (n,)."""
        noise_m, is_outlier = NoiseDraws.from_plan(self, plan).draw([seed])
        return noise_m[0], is_outlier[0]


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDraws:
    """Noise series of a plan of `count` observations, from which realizations are drawn."""

    count: int
    series: tuple[_Series, ...]  # in the order of their sum

    @classmethod
    def from_plan(cls, model: NoiseModel, plan: Plan) -> NoiseDraws:
        """Assign series of errors to the observations of a plan."""
        observations = plan.observations
        station_noise = {"vlbi_delay": model.vlbi_station, "vlbi_delay_rate": model.vlbi_station_rate}
        all_series: dict[str, _Series] = {}
        group = plan.session * len(observations.links) + observations.link
        for number in np.unique(group).tolist():
            session_index, link_index = divmod(number, len(observations.links))
            rows = np.flatnonzero(group == number)
            session, link = plan.sessions[session_index], observations.links[link_index]
            parts = [(1.0, model.link.get(session.kind, Noise()), link.path)]
            if (noise := station_noise.get(session.kind)) is not None:
                parts += [(1.0, noise, link.receiver), (-1.0, noise, link.transmitter)]
            for sign, noise, name in parts:
                if noise == Noise():
                    continue
                epochs = session.epochs()
                start = f"{float(epochs.jd[0])!r} {float(epochs.fraction[0])!r}"
                label = f"{session.kind} {name} {start} {float(session.step_s)!r}"
                series = _Series(noise, len(epochs), session.step_s, session.count_s, label)
                all_series.setdefault(label, series).uses.append((sign, rows, plan.slot[rows]))
        return cls(len(observations), tuple(all_series.values()))

    def draw(self, seeds: Sequence[int]) -> tuple[Floats, Mask]:
        """Return errors, m, and outliers, (seeds, n) each; those of a seed do not depend on the other seeds."""
        for seed in seeds:
            require_seed(seed)
        noise_m = np.zeros((len(seeds), self.count))
        is_outlier = np.zeros((len(seeds), self.count), dtype=bool)
        for series in self.series:
            error_m, outliers = series.noise.series(
                series.epochs, series.step_s, seeds, series.label, series.count_s
            )
            for sign, rows, slot in series.uses:
                noise_m[:, rows] += sign * error_m[:, slot]
                is_outlier[:, rows] |= outliers[:, slot]
        return noise_m, is_outlier


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """Series of errors, and its observations: sign, rows and epochs of the session."""

    noise: Noise
    epochs: int
    step_s: float
    count_s: float
    label: str
    uses: list[tuple[float, Indices, NDArray[np.int64]]] = field(default_factory=list)


def steps_in_count(count_s: float, step_s: float) -> int:
    """Return the number of steps in a count interval; zero unless it is a whole number."""
    steps = count_s / step_s
    count = round(steps) if math.isfinite(steps) else 0
    return count if abs(steps - count) <= _STEP_TOLERANCE else 0


def generator(seed: int, label: str) -> np.random.Generator:
    """Return a stream of random numbers that depends on a seed and a label only."""
    require_seed(seed)
    seed = int(seed)
    seed_bytes = seed.to_bytes(4 * max(1, -(-seed.bit_length() // 32)), "little")
    # SeedSequence converts numbers to words slowly.
    words = np.frombuffer(seed_bytes + hashlib.sha256(label.encode()).digest(), dtype="<u4")
    # The generator of default_rng may change between versions of numpy.
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


def require_seed(seed: int) -> None:
    """Raise :class:`InputError` unless a seed is a whole number of at least 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed: expected a whole number of at least 0, got {seed!r}")


def gauss_markov(drive: Floats, step_correlation: float) -> Floats:
    """Return a stationary first-order Gauss-Markov process of unit variance from normal numbers, (..., n).

    x_0 = w_0, x_k = f x_(k-1) + sqrt(1 - f^2) w_k, f = exp(-step / correlation time) (Gelb 1974, chapter 3).
    """
    states = math.sqrt(1.0 - step_correlation**2) * drive
    states[..., :1] = drive[..., :1]
    n = drive.shape[-1]
    drawn = recursions(
        np.full((n, 1), step_correlation), np.ones(1), states.reshape(math.prod(drive.shape[:-1]), n).T
    )
    return drawn.T.reshape(drive.shape)
