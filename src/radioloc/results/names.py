"""Names for readers: parameters, error sources and links in words, as cards and figures have them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from radioloc.estimation.consider import A_PRIORI, UNMODELLED_ERROR, ErrorSource
from radioloc.measurements.link import Link
from radioloc.parameters.parameter import Parameter
from radioloc.parameters.registry import PARAMETERS, parameter_label

_SOURCES = {
    A_PRIORI: "a-priori values",
    "station_position": "station coordinates",
    "pole": "pole coordinates",
    UNMODELLED_ERROR: "error found, not modelled",
}
"""Names of the sources of error that have not the label of the kind of parameter."""
_DIRECTIONS = {"along": "along-track", "normal": "cross-track"}


def source_name(source: str) -> str:
    """Return the name of a source of error, such as ``position of the Moon``."""
    label = PARAMETERS[source].label if source in PARAMETERS else ""
    return _SOURCES.get(source) or label or source.replace("_", " ")


def error_name(item: ErrorSource) -> str:
    """Return the name of a source of error with its owner, such as ``zenith delay of KASHI``."""
    if not item.name:
        return source_name(item.source)
    return (
        f"a-priori {parameter_name(item.name)}"
        if item.source == A_PRIORI
        else f"{source_name(item.source)} of {item.name}"
    )


def parameter_name(identifier: str) -> str:
    """Return the name of a parameter, such as ``radial position of the Moon`` for ``moon_position.radial``."""
    if identifier.partition(".")[0] not in PARAMETERS:  # of a target, such as position.height_m
        return identifier.removesuffix("_m").removesuffix("_deg").replace("_", " ").replace(".", " ")
    name, _, number = parameter_label(identifier).rpartition(" ")
    if number.isdigit() and not name.endswith(", session"):
        return f"{name}, pass {number}"
    first, _, owner = f"{name} {number}".partition(" ")
    return f"{_DIRECTIONS.get(first, first)} {owner}".rstrip()


def with_parameter_names(text: str, parameters: Iterable[Parameter]) -> str:
    """Return a text with the names of parameters in place of their identifiers."""
    for identifier in sorted((item.name for item in parameters), key=len, reverse=True):
        text = text.replace(identifier, parameter_name(identifier))
    return text


def link_ways(links: Sequence[Link]) -> list[str]:
    """Return the words that tell links of one place apart; ``two-way`` is understood if all links are."""
    several = len({link.targets for link in links}) > 1
    ways = []
    for link in links:
        if link.differenced:
            way = ""
        elif link.transmitter:
            way = "two-way" if link.transmitter == link.receiver else f"from {link.transmitter}"
        else:
            way = "one-way"
        ways.append(f"{way} {'-'.join(link.targets)}".strip() if several else way)
    two_way = several and all(name.startswith("two-way ") for name in ways)
    return [name.removeprefix("two-way ") for name in ways] if two_way else ways


def link_names(links: Sequence[Link]) -> list[str]:
    """Return place and way of each link as one name; ``two-way`` is understood."""
    return [
        f"{link.place} {way.removeprefix('two-way')}".rstrip()
        for link, way in zip(links, link_ways(links), strict=True)
    ]
