"""What links are called on cards and in figures."""

from __future__ import annotations

from collections.abc import Sequence

from radioloc.measurements.link import Link


def ways(links: Sequence[Link]) -> list[str]:
    """What tells links of one place apart: one- or two-way or from where, and of several targets which."""
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
    return out


def short_names(links: Sequence[Link]) -> list[str]:
    """Place and way in one; ``two-way`` is understood."""
    return [
        f"{link.place} {way.removeprefix('two-way')}".rstrip()
        for link, way in zip(links, ways(links), strict=True)
    ]
