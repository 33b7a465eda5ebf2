"""First-order Gauss-Markov processes, and the Kalman filter that whitens them.

A stationary process has the autocovariance v exp(-|dt| / tau); with a correlation time of zero it is new at each epoch.
A random walk grows from the instant when it began. A Kalman filter whose states are the processes (Kalman 1960; Tapley,
Schutz and Born 2004, section 4.9) turns columns of the design matrix into innovations, which over their standard
deviations are those of independent observations: A^T V^-1 A is then exact, at a cost linear in the observations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radioloc.vectors import Floats, Indices, Mask

NONE = -1
"""Index in place of a process, for observations without one."""


@dataclass(frozen=True, slots=True)
class Process:
    """Variance and correlation time of a stationary process, or growth of the variance of a random walk."""

    variance_m2: float = 0.0
    tau_s: float = 0.0
    walk_m2_s: float = 0.0
    start_s: float = 0.0  #: when the walk began


def transitions(
    step_s: Floats, variance: ArrayLike, tau_s: ArrayLike, new: Mask | None = None
) -> tuple[Floats, Floats]:
    """Factors by which processes decay over steps (n,), and the variances that they gain, both (n, s).

    Processes begin anew at the rows `new`, at the first one by default.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        decay = np.exp(-np.maximum(step_s, 0.0)[:, None] / np.asarray(tau_s))
    decay[step_s <= 0.0] = 1.0
    decay[slice(1) if new is None else new] = 0.0
    return decay, np.asarray(variance) * (1.0 - decay**2)


def recursions(decay: Floats, weight: Floats, drive: Floats) -> Floats:
    """Sum of the columns x_i = decay_i x_(i-1) + drive_i (n, m) of processes (n, p) times their weights (p,)."""
    from radioloc.noise._kernels import recursions as compiled

    out = np.zeros(drive.shape)
    compiled(decay, weight, np.ascontiguousarray(drive), np.zeros((len(weight), drive.shape[1])), out)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class KalmanFilter:
    """Gains of a Kalman filter of n rows and s processes; they are the same for all columns."""

    process: Indices  # (n, k), index of each process that a row has, or NONE
    sign: Floats  # (n, k), with which it has it
    decay: Floats  # (n, s), of the processes since the row before
    gain: Floats  # (n, s)
    scale: Floats  # (n,), one over the standard deviation of the innovation; zero for rows that earlier ones determine

    @classmethod
    def from_processes(
        cls,
        process: Indices,
        sign: Floats,
        white: Floats,
        transition: tuple[Floats, Floats],
        min_variance: Floats | None = None,
    ) -> KalmanFilter:
        """Filter of white noise and processes; innovations of variances up to `least` (n,) count as none."""
        from radioloc.noise._kernels import filter_gains

        min_variance = np.zeros(len(white)) if min_variance is None else min_variance
        decay, added = transition
        (n, s), scale = decay.shape, np.zeros(len(white))
        covariance, gain = np.zeros((s, s)), np.zeros((n, s))
        filter_gains(process, sign, white, min_variance, decay, added, covariance, gain, scale)
        return cls(process, sign, decay, gain, scale)

    def innovations(self, columns: Floats, rows: slice = slice(None), state: Floats | None = None) -> Floats:
        """Innovations of the columns (m, c) of some rows over their sigmas; the state (s, c) goes on between calls."""
        from radioloc.noise._kernels import filter_innovations

        state = np.zeros((self.gain.shape[1], columns.shape[1])) if state is None else state
        matrices = (matrix[rows] for matrix in (self.process, self.sign, self.decay, self.gain, self.scale))
        out = np.empty(columns.shape)
        filter_innovations(*matrices, state, np.ascontiguousarray(columns), out)
        return out

    def adjoint(self, columns: Floats, rows: slice = slice(None)) -> Floats:
        """Transpose of :meth:`innovations`: both one after the other multiply by the inverse covariance.

        The columns of some rows, of which the processes of later ones are independent, are overwritten.
        """
        from radioloc.noise._kernels import filter_adjoint

        matrices = (matrix[rows] for matrix in (self.process, self.sign, self.decay, self.gain, self.scale))
        columns = np.ascontiguousarray(columns)
        filter_adjoint(*matrices, np.zeros((self.gain.shape[1], columns.shape[1])), columns)
        return columns
