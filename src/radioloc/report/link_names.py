"""What links are called on cards and in figures."""

from __future__ import annotations

from collections.abc import Sequence

from radioloc.estimation.statistics import Residuals
from radioloc.measurements.link import Link


def have_paths(rows: Residuals) -> bool:
    """Whether paths are those of observations, not names of stations in their place."""
    return all(">" in path or "@" in path for path in rows.paths.present())


def ways(links: Sequence[Link]) -> list[str]:
    """What tells links of one place apart: one- or two-way or from where, and of several targets which.

    That all links to several targets are two-way is not said.
    """
    several = len({link.targets for link in links}) > 1
    out = []
    for link in links:
        if link.differenced or link.on_map:
            way = ""
        elif link.transmitter:
            way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        else:
            way = "one-way"
        out.append(f"{way} {'-'.join(link.targets)}".strip() if several else way)
    two_way = several and all(name.startswith("two-way ") for name in out)
    return [name.removeprefix("two-way ") for name in out] if two_way else out


def short_names(links: Sequence[Link]) -> list[str]:
    """Place and way in one; ``two-way`` is understood."""
    return [
        f"{link.place} {way.removeprefix('two-way')}".rstrip()
        for link, way in zip(links, ways(links), strict=True)
    ]
