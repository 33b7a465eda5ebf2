"""Random errors of simulated observations: white, coloured, flicker noise, drifting and wild.

Every series of random numbers has its own stream, seeded by the seed and by a label that says what it is for: kind,
link or station, first epoch and step of the session. A link's errors are therefore the same whatever else is simulated,
in whatever order, and whatever part of the session is seen. Series run over all epochs of a session.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
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
from radioloc.vectors import Floats

_ROUNDING = 1e-6
_PROCESSES_PER_DECADE = 2  # of correlation times, by which flicker noise is drawn


@dataclass(frozen=True, slots=True)
class Noise:
    """What one series of errors is made of; the parts add up."""

    white_m: float = 0.0  # standard deviation of the part that is independent from epoch to epoch
    # Standard deviation of a stationary first-order Gauss-Markov process, whose autocovariance is coloured_m^2
    # exp(-|dt| / correlation_s).
    coloured_m: float = 0.0
    correlation_s: float = 0.0
    # Standard deviation of a random walk that starts at zero with the session, m per square root of a second.
    walk_m_sqrt_s: float = 0.0
    outlier_fraction: float = 0.0  # fraction of the epochs that get an outlier
    outlier_m: float = 0.0  # its size: even between half and one and a half of it, of either sign
    # Standard deviation of flicker noise in each factor of ten of frequency, from one over the step down to one over
    # the session's length: a power spectral density that falls as 1/f.
    flicker_m: float = 0.0
    # Standard deviation of the phase at either end of a count interval, whose change is the count: contiguous counts
    # share the phase between them with opposite signs, and are correlated by -1/2.
    phase_m: float = 0.0

    def __post_init__(self) -> None:
        convert_fields(self)
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"noise: {name} is {value!r}; give a number that is not negative")
        if self.outlier_fraction > 1.0:
            raise InputError(f"noise: outlier_fraction is {self.outlier_fraction}; it is a part of one")
        if self.coloured_m > 0.0 and self.correlation_s == 0.0:
            raise InputError("noise: coloured_m needs a correlation_s; use white_m for none")

    def processes(self, n: int, step_s: float, start_s: float) -> list[Process]:
        """Its parts that last, but the phase's, of n epochs that begin at a time; outliers are left to the editing."""
        lasting = [Process(sigma_m**2, tau_s) for _, sigma_m, tau_s in self._gauss_markov(n, step_s)]
        if self.walk_m_sqrt_s:
            lasting.append(Process(walk_m2_s=self.walk_m_sqrt_s**2, start_s=start_s))
        return lasting

    def _gauss_markov(self, n: int, step_s: float) -> list[tuple[str, float, float]]:
        """Names, sigmas, m, and correlation times, s, of its Gauss-Markov processes."""
        found = [("coloured", self.coloured_m, self.correlation_s)] if self.coloured_m else []
        if self.flicker_m:
            # Processes of correlation times that are evenly spaced by logarithm add up to 1/f (van der Ziel 1950).
            times = max(1, math.ceil(_PROCESSES_PER_DECADE * math.log10(max(n, 2)))) + 1
            each_m = self.flicker_m / math.sqrt(_PROCESSES_PER_DECADE)
            taus_s = (step_s * 10.0 ** (k / _PROCESSES_PER_DECADE) for k in range(times))
            found += [(f"flicker {k}", each_m, tau_s) for k, tau_s in enumerate(taus_s)]
        return found

    def series(
        self, n: int, step_s: float, seeds: Sequence[int], label: str, count_s: float = math.nan
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """One realization for each seed at n epochs of equal step, and which are outliers, both (seeds, n).

        Another label, which says what the series is for, gives an independent series. `count_s` is the count interval.
        """
        error_m = np.zeros((len(seeds), n))
        is_outlier = np.zeros((len(seeds), n), dtype=bool)

        def normal(part: str, count: int = n) -> Floats:
            return np.array([generator(seed, f"{label} {part}").standard_normal(count) for seed in seeds])

        if self.white_m:
            error_m += self.white_m * normal("white")
        if self.phase_m and (apart := steps_in_count(count_s, step_s)):
            phase = normal("phase", n + apart)
            error_m += self.phase_m * (phase[:, apart:] - phase[:, :-apart])
        elif self.phase_m:
            error_m += self.phase_m * (normal("phase") - normal("phase at the start"))
        for name, sigma_m, tau_s in self._gauss_markov(n, step_s):
            error_m += sigma_m * gauss_markov(normal(name), math.exp(-step_s / tau_s))
        if self.walk_m_sqrt_s:
            steps = normal("walk")
            steps[:, :1] = 0.0
            error_m += self.walk_m_sqrt_s * math.sqrt(step_s) * np.cumsum(steps, axis=-1)
        if self.outlier_fraction and self.outlier_m:
            for k, seed in enumerate(seeds):
                random = generator(seed, f"{label} outliers")
                is_outlier[k] = random.random(n) < self.outlier_fraction
                wild = np.flatnonzero(is_outlier[k])
                size, positive = random.random(n), random.integers(0, 2, n)
                error_m[k, wild] += self.outlier_m * (0.5 + size[wild]) * (2.0 * positive[wild] - 1.0)
        return error_m, is_outlier


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Random errors of all observations."""

    # By kind of measurement, the errors of each link, independent between links: of a baseline, the thermal noise of
    # its correlation.
    link: Mapping[str, Noise] = field(default_factory=dict)
    # Errors of each VLBI station's arrival times (clock, instrument, air): a delay has its second station's less its
    # first one's, so that delays around a triangle add to nothing. Six baselines of four stations hold only three
    # independent delays of these.
    vlbi_station: Noise = field(default_factory=Noise)
    # Likewise errors of by how much each station's arrival time grows over a count interval, for delay rates.
    vlbi_station_rate: Noise = field(default_factory=Noise)

    def __post_init__(self) -> None:
        for kind in self.link:
            if kind not in KINDS:
                raise InputError(f"noise of kind {kind!r} is not known; use {', '.join(KINDS)}")
        of_counts = {kind: bool(is_integrated(np.array(k))) for k, kind in enumerate(KINDS)}
        stations = {"vlbi_station": self.vlbi_station, "vlbi_station_rate": self.vlbi_station_rate}
        for name, noise in {**self.link, **stations}.items():
            if noise.phase_m and not of_counts.get(name, False):
                raise InputError(
                    f"noise of {name}: phase_m is of what is counted, as Doppler is; use white_m"
                )

    def covariance(self, plan: Plan) -> ObservationCovariance:
        """Covariance of the errors without outliers; where nothing is given, white noise as the schedule states it."""
        observations = plan.observations
        n, tai = len(observations), utc_to_tai(observations.epoch)
        time_s = tai.seconds_since(tai[:1])
        white_m2, phase_m = np.zeros(n), np.zeros(n)
        link, start, end = np.full(n, ALONE), np.zeros(n, dtype=np.intp), np.ones(n, dtype=np.intp)
        processes: list[Process] = []
        entries: list[tuple[NDArray[np.intp], int, float]] = []
        for number, one in enumerate(NoiseDraws.of(self, plan).series):
            _, rows, slot = one.uses[0]
            begin_s = float(time_s[rows[0]] - one.step_s * slot[0])
            lasting = one.noise.processes(one.epochs, one.step_s, begin_s)
            if one.noise.phase_m and (apart := steps_in_count(one.count_s, one.step_s)):
                link[rows], phase_m[rows] = number, one.noise.phase_m
                start[rows], end[rows] = slot, slot + apart
            else:
                white_m2[rows] += 2.0 * one.noise.phase_m**2
            if len(one.uses) == 1:
                white_m2[rows] += one.noise.white_m**2
            elif one.noise.white_m:
                lasting.append(Process(one.noise.white_m**2))
            for process in lasting:
                entries += [(rows, len(processes), sign) for sign, rows, _ in one.uses]
                processes.append(process)
        count = np.bincount(
            np.concatenate([rows for rows, _, _ in entries] or [np.zeros(0, int)]), minlength=n
        )
        which = np.full((n, count.max(initial=0)), NONE)
        signs = np.zeros(which.shape)
        for rows, number, sign in entries:
            count[rows] -= 1
            which[rows, count[rows]], signs[rows, count[rows]] = number, sign
        lasting_terms: list[NoiseTerm] = (
            [GaussMarkov(time_s, which, signs, tuple(processes))] if processes else []
        )
        phases: list[NoiseTerm] = [DopplerPhase(phase_m, link, start, end)] if phase_m.any() else []
        given_m2 = sum((term.variance_m2 for term in (*lasting_terms, *phases)), white_m2)
        white_m = np.sqrt(np.where(given_m2 > 0.0, white_m2, observations.sigma_m**2))
        return ObservationCovariance((White(white_m), *lasting_terms, *phases))

    def draw(self, plan: Plan, seed: int) -> tuple[Floats, NDArray[np.bool_]]:
        """One realization for everything planned, m, and in what an outlier of a link or station is, both (n,)."""
        noise_m, is_outlier = NoiseDraws.of(self, plan).draw([seed])
        return noise_m[0], is_outlier[0]


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDraws:
    """The noise of a plan of `count` observations, ready to be drawn again and again."""

    count: int
    series: tuple[_Series, ...]  # in the order in which they add up

    @classmethod
    def of(cls, model: NoiseModel, plan: Plan) -> NoiseDraws:
        """Find out which series of errors each observation has part in."""
        observations = plan.observations
        of_stations = {"vlbi_delay": model.vlbi_station, "vlbi_delay_rate": model.vlbi_station_rate}
        found: dict[str, _Series] = {}
        group = plan.session * len(observations.links) + observations.link
        for number in np.unique(group).tolist():
            session_index, link_index = divmod(number, len(observations.links))
            rows = np.flatnonzero(group == number)
            session, link = plan.sessions[session_index], observations.links[link_index]
            parts = [(1.0, model.link.get(session.kind, Noise()), link.path)]
            of_station = of_stations.get(session.kind)
            if of_station is not None:
                parts += [(1.0, of_station, link.receiver), (-1.0, of_station, link.transmitter)]
            for sign, noise, name in parts:
                if noise == Noise():
                    continue
                epochs = session.epochs()
                start = f"{float(epochs.jd[0])!r} {float(epochs.fraction[0])!r}"
                label = f"{session.kind} {name} {start} {float(session.step_s)!r}"
                made = _Series(noise, len(epochs), session.step_s, session.count_s, label)
                one = found.setdefault(label, made)
                one.uses.append((sign, rows, plan.slot[rows]))
        return cls(len(observations), tuple(found.values()))

    def draw(self, seeds: Sequence[int]) -> tuple[Floats, NDArray[np.bool_]]:
        """Errors, m, and which are wild, (seeds, n) each; those of a seed do not depend on the others."""
        for seed in seeds:
            require_seed(seed)
        noise_m = np.zeros((len(seeds), self.count))
        is_outlier = np.zeros((len(seeds), self.count), dtype=bool)
        for one in self.series:
            error_m, wild = one.noise.series(one.epochs, one.step_s, seeds, one.label, one.count_s)
            for sign, rows, slot in one.uses:
                noise_m[:, rows] += sign * error_m[:, slot]
                is_outlier[:, rows] |= wild[:, slot]
        return noise_m, is_outlier


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """One series of errors, and the observations that it is in: sign, rows and epochs of the session."""

    noise: Noise
    epochs: int
    step_s: float
    count_s: float
    label: str
    uses: list[tuple[float, NDArray[np.intp], NDArray[np.int64]]] = field(default_factory=list)


def steps_in_count(count_s: float, step_s: float) -> int:
    """Steps from one epoch to the next that a count interval is long; zero where it is no whole number of them."""
    steps = count_s / step_s
    near = round(steps) if math.isfinite(steps) else 0
    return near if abs(steps - near) <= _ROUNDING else 0


def generator(seed: int, label: str) -> np.random.Generator:
    """Stream of random numbers that depends on a seed and a label alone."""
    require_seed(seed)
    seed = int(seed)
    of_seed = seed.to_bytes(4 * max(1, -(-seed.bit_length() // 32)), "little")
    # As words, which is what SeedSequence makes of numbers, slowly; those of the seed first.
    words = np.frombuffer(of_seed + hashlib.sha256(label.encode()).digest(), dtype="<u4")
    # Named, as what default_rng stands for may change from one numpy to the next.
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


def require_seed(seed: int) -> None:
    """Raise :class:`InputError` if a seed is not a whole number from zero up."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed is {seed!r}; give a whole number from zero up")


def gauss_markov(drive: Floats, step_correlation: float) -> Floats:
    """Stationary first-order Gauss-Markov process of unit variance from independent normal numbers, (..., n).

    x_0 = w_0, x_k = f x_(k-1) + sqrt(1 - f^2) w_k, f = exp(-step / correlation time) (Gelb 1974, chapter 3).
    """
    states = math.sqrt(1.0 - step_correlation**2) * drive
    states[..., :1] = drive[..., :1]
    n = drive.shape[-1]
    drawn = recursions(
        np.full((n, 1), step_correlation), np.ones(1), states.reshape(math.prod(drive.shape[:-1]), n).T
    )
    return drawn.T.reshape(drive.shape)
