"""Post-Newtonian accelerations by Moyer (2003)."""

import numpy as np

from radioloc.constants import C_M_S


def post_newtonian(i, places, speeds, pulls, gm):
    """Return the post-Newtonian acceleration of body i by all sources, eq. 4-26."""
    total = np.zeros(3)
    sources = [j for j in range(len(gm)) if j != i]
    distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
    for j in sources:
        offset = places[i] - places[j]
        bracket = -4.0 * sum(gm[k] / distance[i, k] for k in sources)
        bracket -= sum(gm[k] / distance[j, k] for k in range(len(gm)) if k != j)
        bracket += speeds[i] @ speeds[i] + 2.0 * speeds[j] @ speeds[j] - 4.0 * speeds[i] @ speeds[j]
        bracket -= 1.5 * (offset @ speeds[j] / distance[i, j]) ** 2 + 0.5 * offset @ pulls[j]
        projection = offset @ (4.0 * speeds[i] - 3.0 * speeds[j])
        total -= gm[j] * offset / distance[i, j] ** 3 * bracket
        total += (
            gm[j] / distance[i, j] ** 3 * projection * (speeds[i] - speeds[j])
            + 3.5 * gm[j] * pulls[j] / distance[i, j]
        )
    return total / C_M_S**2
