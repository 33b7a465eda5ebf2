"""States from the segments of an SPK, by type of segment, in the file's units: km and km/s, TDB seconds since J2000.

Source: NAIF's *SPK Required Reading*, which gives the layout of the words and the interpolation of each type. A segment
is checked when it is opened: its numbers are finite, its counts fill it exactly, its epochs rise and cover its span.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from radioloc.errors import KernelError
from radioloc.kernels.daf import DafSegment, tdb_date
from radioloc.vectors import Floats, chebyshev_sums

MAX_MAGNITUDE = 1e30  # of any word: its square still fits a float, and no epoch or length in km comes near it
_MAX_DEGREE = 27  # of interpolating polynomials, as in SPICE
_MAX_DIFFERENCES = 25  # of a difference line, as in SPICE
_DIRECTORY_STEP = 100  # epochs from one entry of a directory of epochs to the next
_EPOCH_TOLERANCE = 1e-6  # rounding of an epoch, in lengths of a record or steps
_CHUNK = 2048  # epochs interpolated at once, which bounds the memory


class StateSeries(Protocol):
    """States of a body over the span of a segment."""

    def states(self, et_s: Floats) -> Floats:
        """Return states at epochs, shape (n, 6)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ChebyshevRecords:
    """Chebyshev series over intervals of one length: of three components, or of six with their rates."""

    first_s: float
    length_s: float
    middles_s: Floats
    radii_s: Floats
    coefficients: Floats  # (records, components, rising degree)

    def states(self, et_s: Floats) -> Floats:
        """Return states at epochs, shape (n, 6)."""
        # The very end of the last record belongs to it.
        record = np.minimum((et_s - self.first_s) // self.length_s, len(self.middles_s) - 1).astype(np.intp)
        s = (et_s - self.middles_s[record]) / self.radii_s[record]
        present, indices = np.unique(record, return_inverse=True)
        coefficients = np.take(self.coefficients[present].transpose(2, 1, 0), indices.reshape(-1), axis=2)
        values, rates = chebyshev_sums(coefficients, s)
        return values.T if len(values) == 6 else np.vstack([values, rates / self.radii_s[record]]).T


@dataclass(frozen=True, slots=True, eq=False)
class StateNodes:
    """States at epochs with interpolating polynomials through a window of the nearest ones."""

    origin_s: float
    times_s: Floats  # of the nodes from the origin; equal steps are exact from their first epoch
    nodes: Floats  # (times, 6)
    window: int
    hermite: bool  # the velocity is the rate of the position; else components are interpolated one by one

    def states(self, et_s: Floats) -> Floats:
        """Return states at epochs, shape (n, 6)."""
        t = et_s - self.origin_s
        parts = [self._states(t[k : k + _CHUNK]) for k in range(0, len(t), _CHUNK)]
        return np.concatenate([np.empty((0, 6)), *parts])

    def _states(self, t: Floats) -> Floats:
        count = len(self.times_s)
        first = np.searchsorted(self.times_s, t, side="right") - self.window // 2
        if self.window % 2:  # centred on the nearest node
            lower = np.clip(first + self.window // 2 - 1, 0, count - 1)
            upper = np.minimum(lower + 1, count - 1)
            first -= t - self.times_s[lower] < self.times_s[upper] - t
        rows = np.clip(first, 0, count - self.window)[:, None] + np.arange(self.window)
        x, nodes = self.times_s[rows] - t[:, None], self.nodes[rows]
        if not self.hermite:
            return _lagrange(x, nodes)
        return np.hstack(_hermite(x, nodes[..., :3], nodes[..., 3:]))


@dataclass(frozen=True, slots=True, eq=False)
class DifferenceLines:
    """Modified difference arrays of Krogh's variable-order integrator, one line of numbers up to each final epoch."""

    finals_s: Floats
    lines: Floats  # (lines, 4 * terms + 11)

    def states(self, et_s: Floats) -> Floats:
        """Return states at epochs, shape (n, 6)."""
        indices = np.minimum(np.searchsorted(self.finals_s, et_s), len(self.finals_s) - 1)
        out = np.empty((len(et_s), 6))
        terms = (self.lines.shape[1] - 11) // 4
        for order in np.unique(self.lines[indices, -4]):
            rows = np.flatnonzero(self.lines[indices, -4] == order)
            out[rows] = _difference_states(self.lines[indices[rows]], et_s[rows], terms, int(order))
        return out


def _lagrange(x: Floats, values: Floats) -> Floats:
    """Value at 0 of the polynomial through (x, values), shapes (n, window) and (n, window, 6), by Neville's scheme."""
    x = x[..., None]
    for k in range(1, x.shape[1]):
        low, high = x[:, :-k], x[:, k:]
        values = (high * values[:, :-1] - low * values[:, 1:]) / (high - low)
    return values[:, 0]


def _hermite(x: Floats, values: Floats, rates: Floats) -> tuple[Floats, Floats]:
    """Value and rate at 0 of the polynomial through (x, values) with rates, by Neville's scheme of double nodes."""
    x = np.repeat(x, 2, axis=1)[..., None]
    value = np.repeat(values, 2, axis=1)
    gap = x[:, 2::2] - x[:, 1:-1:2]
    slope = np.empty_like(value[:, 1:])
    slope[:, ::2] = rates
    slope[:, 1::2] = (values[:, 1:] - values[:, :-1]) / gap
    value = value[:, :-1] - x[:, :-1] * slope
    for k in range(2, x.shape[1]):
        low, high = x[:, :-k], x[:, k:]
        rise = value[:, 1:] - value[:, :-1]
        slope = (high * slope[:, :-1] - low * slope[:, 1:] + rise) / (high - low)
        value = (high * value[:, :-1] - low * value[:, 1:]) / (high - low)
    return value[:, 0], slope[:, 0]


def _difference_states(lines: Floats, et_s: Floats, terms: int, order: int) -> Floats:
    """States of difference lines whose highest order of integration is `order` - 1, shape (n, 6)."""
    delta, steps = et_s - lines[:, 0], lines[:, 1 : 1 + terms].T
    reference = lines[:, 1 + terms : 7 + terms].reshape(-1, 3, 2)
    differences = lines[:, 7 + terms : 7 + 4 * terms].reshape(-1, 3, terms)[:, :, : order - 1]
    differences = np.where(np.arange(order - 1) < lines[:, -3:, None], differences, 0.0)
    since = [delta, *(delta + step for step in steps)]
    # Integrals of the polynomials that belong to the differences: twofold in w[1:] before the last sweep, then onefold
    # in w[:-1].
    w = np.repeat(1.0 / np.arange(1.0, order + 1)[:, None], len(et_s), axis=1)
    for k in range(order - 1, 0, -1):
        if k == 1:
            twofold = np.einsum("nij,jn->ni", differences, w[1:])
        for j in range(min(order - k, order - 2)):
            w[j + k] = (since[j] * w[j + k - 1] - delta * w[j + k]) / steps[j]
    onefold = np.einsum("nij,jn->ni", differences, w[:-1])
    position, velocity, elapsed = reference[..., 0], reference[..., 1], delta[:, None]
    return np.hstack([position + elapsed * (velocity + elapsed * twofold), velocity + elapsed * onefold])


def read_states(segment: DafSegment, spk_type: int) -> StateSeries:
    """Return the states of a segment of an SPK; one that is damaged or of another type is a :class:`KernelError`."""
    if spk_type not in _READERS:
        raise KernelError(
            f"{segment.path}: segment {segment.integers[0]} ({segment.name}) is of SPK type {spk_type}; expected "
            f"{', '.join(map(str, _READERS))}. Convert it with SPICE: spkw13 writes states that spkgeo gives at short "
            "steps"
        )
    # Only words of the other byte order are copied; the rest is mapped from the file.
    words = np.asarray(segment.words, dtype=np.float64)
    segment.require(  # without a copy of gigabytes
        bool(words.max() < MAX_MAGNITUDE and words.min() > -MAX_MAGNITUDE),
        "holds a word that is not a number or far too large in its records or directory",
    )
    return _READERS[spk_type](segment._replace(words=words))


def _tail(segment: DafSegment, n: int) -> list[float]:
    segment.require(len(segment.words) > n, "is shorter than its own directory")
    return [float(word) for word in segment.words[-n:]]


def _count(segment: DafSegment, word: float, low: int, high: float, quantity: str) -> int:
    """Return a whole number within bounds."""
    sound = low <= word <= high and word == round(word)
    segment.require(sound, f"has {word:g} in its directory as {quantity}")
    return int(word)


def _require_length(segment: DafSegment, expected: int) -> None:
    n = len(segment.words)
    segment.require(n == expected, f"has {n} words where its directory asks for {expected}")


def _require_covered(segment: DafSegment, first_s: float, last_s: float, slack_s: float = 0.0) -> None:
    segment.require(
        first_s - slack_s <= segment.start_s and segment.end_s <= last_s + slack_s,
        f"claims {tdb_date(segment.start_s)} to {tdb_date(segment.end_s)}, but its data span {tdb_date(first_s)} to "
        f"{tdb_date(last_s)}",
    )


def _chebyshev(segment: DafSegment, components: int) -> ChebyshevRecords:
    """Types 2 and 3: records of middle, half length and series; at the end first epoch, length, words, records."""
    first_s, length_s, size, count = _tail(segment, 4)
    n_words = _count(segment, size, 2 + components, len(segment.words), "the length of a record")
    segment.require((n_words - 2) % components == 0, f"has a directory with records of {n_words} words")
    n = _count(segment, count, 1, len(segment.words), "the number of records")
    _require_length(segment, n * n_words + 4)
    segment.require(length_s > 0.0, f"has a directory with records of {length_s:g} s")
    _require_covered(segment, first_s, first_s + n * length_s)
    records = segment.words[:-4].reshape(n, n_words)
    middles_s, radii_s = records[:, 0], records[:, 1]
    off_s = np.abs(middles_s - (first_s + (np.arange(n) + 0.5) * length_s)), np.abs(radii_s - length_s / 2)
    sound = bool((np.maximum(*off_s) <= _EPOCH_TOLERANCE * length_s).all())
    segment.require(sound, "has a record whose epoch is not where it belongs")
    return ChebyshevRecords(first_s, length_s, middles_s, radii_s, records[:, 2:].reshape(n, components, -1))


def _nodes(segment: DafSegment, hermite: bool, equal_steps: bool) -> StateNodes:
    """Types 8, 9, 12 and 13: states, then epochs with a directory or a first epoch and a step, window less 1, count."""
    *steps, window_less_1, count = _tail(segment, 4 if equal_steps else 2)
    n = _count(segment, count, 1, len(segment.words), "the number of states")
    max_window = min(n, (_MAX_DEGREE + 1) // (2 if hermite else 1))
    window = _count(segment, window_less_1 + 1, 1, max_window, "the number of states to interpolate between")
    _require_length(segment, 6 * n + 4 if equal_steps else 7 * n + (n - 1) // _DIRECTORY_STEP + 2)
    if equal_steps:
        origin_s, step_s = steps
        times_s, slack_s = np.arange(n, dtype=np.float64) * step_s, _EPOCH_TOLERANCE * step_s
    else:
        origin_s, times_s, slack_s = 0.0, segment.words[6 * n : 7 * n], 0.0
    segment.require(bool((np.diff(times_s) > 0.0).all()), "has epochs that are not in order")
    _require_covered(segment, origin_s + float(times_s[0]), origin_s + float(times_s[-1]), slack_s)
    return StateNodes(origin_s, times_s, segment.words[: 6 * n].reshape(n, 6), window, hermite)


def _difference_arrays(segment: DafSegment, extended: bool) -> DifferenceLines:
    """Types 1 and 21: lines, final epochs and their directory; at the end the terms (only 21) and number of lines."""
    *size, count = _tail(segment, 2 if extended else 1)
    terms = 15
    if extended:
        terms = _count(segment, size[0], 1, _MAX_DIFFERENCES, "the number of differences")
    n, length = _count(segment, count, 1, len(segment.words), "the number of records"), 4 * terms + 11
    _require_length(segment, n * (length + 1) + n // _DIRECTORY_STEP + len(size) + 1)
    lines = segment.words[: n * length].reshape(n, length)
    finals_s = segment.words[n * length : n * length + n]
    segment.require(bool((np.diff(finals_s) >= 0.0).all()), "has epochs that are not in order")
    segment.require(bool(segment.end_s <= finals_s[-1]), "claims to reach beyond its last record")
    highest = lines[:, -4]
    sound = (highest == np.round(highest)) & (highest >= 2) & (highest <= terms + 1)
    segment.require(bool(sound.all()), "has an order of integration that does not fit its differences")
    return DifferenceLines(finals_s, lines)


_READERS: dict[int, Callable[[DafSegment], StateSeries]] = {
    1: partial(_difference_arrays, extended=False),
    2: partial(_chebyshev, components=3),
    3: partial(_chebyshev, components=6),
    8: partial(_nodes, hermite=False, equal_steps=True),
    9: partial(_nodes, hermite=False, equal_steps=False),
    12: partial(_nodes, hermite=True, equal_steps=True),
    13: partial(_nodes, hermite=True, equal_steps=False),
    21: partial(_difference_arrays, extended=True),
}
