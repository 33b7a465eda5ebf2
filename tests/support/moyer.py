"""Post-Newtonian accelerations as Moyer (2003) writes them."""

import numpy as np

from radioloc.constants import C_M_S


def post_newtonian(i, places, speeds, pulls, gm):
    """Moyer (2003), eq. 4-26, beyond Newton's term, of body i by all others."""
    total = np.zeros(3)
    others = [j for j in range(len(gm)) if j != i]
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    for j in others:
        away = places[i] - places[j]
        bracket = -4.0 * sum(gm[k] / apart[i, k] for k in others)
        bracket -= sum(gm[k] / apart[j, k] for k in range(len(gm)) if k != j)
        bracket += speeds[i] @ speeds[i] + 2.0 * speeds[j] @ speeds[j] - 4.0 * speeds[i] @ speeds[j]
        bracket -= 1.5 * (away @ speeds[j] / apart[i, j]) ** 2 + 0.5 * away @ pulls[j]
        along = away @ (4.0 * speeds[i] - 3.0 * speeds[j])
        total -= gm[j] * away / apart[i, j] ** 3 * bracket
        total += (
            gm[j] / apart[i, j] ** 3 * along * (speeds[i] - speeds[j]) + 3.5 * gm[j] * pulls[j] / apart[i, j]
        )
    return total / C_M_S**2
