"""Dense observation covariance, term by term, for comparison with whiteners."""

import numpy as np

from radioloc.noise import ALONE, DopplerPhase, GaussMarkov, SharedAtEpoch, White


def dense(covariance):
    """Return R of all observations, (n, n)."""
    return sum(_term(term) for term in covariance.terms)


def information(whitener, columns):
    """Return A^T R^-1 A from whitened columns."""
    whitened = np.concatenate([part.copy() for part in whitener.whitened(lambda rows: columns[rows])])
    return whitened.T @ whitened


def _term(term):
    match term:
        case White():
            return np.diag(term.sigma_m**2)
        case SharedAtEpoch():
            in_group = (term.group[:, None] == term.group) & (term.group != ALONE)
            sources = int(term.source.max()) + 1
            effect_m = sum(
                np.eye(sources)[source] * effect[:, None]
                for source, effect in zip(term.source.T, term.effect_m.T, strict=True)
            )
            return in_group * (effect_m @ effect_m.T)
        case DopplerPhase():
            names = sorted({(link, number) for link, *ends in _ends(term) for number in ends})
            effect_m = np.zeros((len(term.link), len(names)))
            for row, (link, start, end) in enumerate(_ends(term)):
                if link != ALONE:
                    effect_m[row, names.index((link, end))] += term.sigma_m[row]
                    effect_m[row, names.index((link, start))] -= term.sigma_m[row]
            return effect_m @ effect_m.T
        case GaussMarkov():
            covariance = np.zeros((len(term.time_s),) * 2)
            between_s = np.abs(term.time_s[:, None] - term.time_s)
            for k, process in enumerate(term.processes):
                effect = (term.sign * (term.process == k)).sum(axis=1)
                correlation = np.exp(-between_s / process.tau_s) if process.tau_s else between_s == 0.0
                walk_s = np.minimum(term.time_s[:, None], term.time_s) - process.start_s
                variance_m2 = process.variance_m2 * correlation + process.walk_m2_s * walk_s
                covariance += np.outer(effect, effect) * variance_m2
            return covariance


def _ends(term):
    return list(zip(term.link.tolist(), term.start.tolist(), term.end.tolist(), strict=True))
