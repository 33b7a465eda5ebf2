"""Lines of a solution's card on its reliability: the smallest errors that are found, and the effect of the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from radioloc.estimation.hypotheses import ALL
from radioloc.estimation.reliability import POWER, Reliability
from radioloc.measurements.registry import KINDS
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import first_lines, metres
from radioloc.results.names import parameter_name, source_name

_KINDS = ("station_position", "clock", "range_bias", "time_bias", "transponder_delay", "frequency_offset")
"""Kinds of error that the card names, the usual faults of stations first."""
_MAX_KINDS, _MAX_HIDDEN = 4, 3  # a card fits a screen; to_dict() has all of them
# Least effect on the position, m, of a hidden error that changes an observation by a metre.
_MIN_EFFECT_M = 0.01
_TIME_UNITS = ((1e-6, 1e9, "ns"), (1e-3, 1e6, "us"), (1.0, 1e3, "ms"))  # upper bound, s, factor and unit


def reliability_lines(items: Sequence[Reliability]) -> Iterator[str]:
    """Yield the minimal detectable biases, the largest effect of an undetected one, and unrevealed errors."""
    faults = [item for item in items if _is_fault(item)]
    sizes = []
    for kind in _KINDS:
        revealed = [item for item in faults if item.revealed and _kind(item) == kind]
        if revealed:
            item = min(revealed, key=lambda fault: fault.minimal)
            sizes.append(f"{source_name(kind)} {_amount(item.minimal, item.unit)}{_owner(item)}")
    if sizes:
        yield f"smallest detectable errors (power {100 * POWER:.0f} %): {', '.join(sizes[:_MAX_KINDS])}"
    if shifting := [(item.shift_m, item) for item in faults if item.shift_m is not None and item.revealed]:
        shift_m, item = max(shifting, key=lambda pair: pair[0])
        size = _amount(item.minimal, item.unit)
        yield f"largest effect of an undetected error: {metres(shift_m)} m ({_name(item)}, {size})"
    if hidden := [text for item in faults if not item.revealed for text in _hidden(item)]:
        yield f"not revealed: {', '.join(first_lines(hidden, _MAX_HIDDEN))}"


def _is_fault(item: Reliability) -> bool:
    """Return whether an error is that of a station, link, target or stated value, not of Earth, Moon or a type."""
    kind, _, owner = item.name.partition(".")
    return owner not in KINDS and (kind not in PARAMETERS or PARAMETERS[kind].scopes[0].named)


def _hidden(item: Reliability) -> Iterator[str]:
    """Yield an error of a usual kind that the data do not reveal, with its effect on the position."""
    kind, effect_m = _kind(item), item.shift_per_unit_m
    if kind not in _KINDS or len(item.components) > 1:
        return
    if effect_m is None:
        yield _name(item)
    elif effect_m * PARAMETERS[kind].scale > _MIN_EFFECT_M:
        factor, unit = 1.0, item.unit
        if unit == "s":
            factor, unit = (1e-9, "ns") if PARAMETERS[kind].scale < _TIME_UNITS[0][0] else (1e-3, "ms")
        yield f"{_name(item)} ({metres(factor * effect_m)} m of position per {unit})"


def _kind(item: Reliability) -> str:
    return item.name.partition(".")[0]


def _name(item: Reliability) -> str:
    if item.kind == "offset":
        return f"offset of {item.name}"
    kind, _, owner = item.name.partition(".")
    if owner == ALL:
        return f"common {source_name(kind)}"
    components = item.components if len(item.components) == 1 else ()
    return parameter_name(".".join(filter(None, (item.name, *components))))


def _owner(item: Reliability) -> str:
    owner = item.name.partition(".")[2]
    return f" ({'common' if owner == ALL else owner})" if owner else ""


def _amount(value: float, unit: str) -> str:
    """Return a size with three digits, of times in a suitable unit."""
    if unit == "s":
        for bound_s, factor, name in _TIME_UNITS:
            if value < bound_s:
                return f"{factor * value:.3g} {name}"
    return f"{value:.3g} {unit}" if unit != "1" else f"{value:.3g}"
