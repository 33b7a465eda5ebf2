"""Card of a solution, lines on reliability: minimal detectable biases, and effects of undetected errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from radioloc.estimation.hypotheses import ALL, TERM
from radioloc.estimation.reliability import POWER, Reliability
from radioloc.measurements.registry import KINDS
from radioloc.parameters.registry import PARAMETERS
from radioloc.results.cards import first_lines, metres
from radioloc.results.names import parameter_name, source_name

_CARD_KINDS = (
    "station_position",
    "clock",
    "range_bias",
    "time_bias",
    "transponder_delay",
    "frequency_offset",
)
"""Kinds of error that the card names, the usual faults of stations first."""
_MAX_KINDS, _MAX_HIDDEN = 4, 3  # a card fits a screen; to_dict() has all of them
_MIN_EFFECT_M = 0.01  # smallest effect on the position with which an undetectable error is listed
_TIME_UNITS = ((1e-6, 1e9, "ns"), (1e-3, 1e6, "us"), (1.0, 1e3, "ms"))  # upper bound, s, factor and unit


def reliability_lines(items: Sequence[Reliability]) -> Iterator[str]:
    """Yield the minimal detectable biases, the largest effect of an undetected one, and unrevealed errors."""
    faults = [item for item in items if _is_fault(item)]
    revealed = [item for item in faults if item.revealed]
    sizes = []
    for kind in _CARD_KINDS:
        item = min(
            (item for item in revealed if _kind(item) == kind), key=lambda item: item.minimal, default=None
        )
        if item is not None:
            _, _, owner = item.name.partition(".")
            suffix = f" ({'common' if owner == ALL else owner})" if owner else ""
            sizes.append(f"{source_name(kind)} {_format_amount(item.minimal, item.unit)}{suffix}")
    if sizes:
        yield f"smallest detectable errors (power {100 * POWER:.0f} %): {', '.join(sizes[:_MAX_KINDS])}"

    effects: dict[str, str] = {}
    for item in sorted(revealed, key=lambda item: -(item.shift_m or 0.0)):
        if item.shift_m:
            text = f"{metres(item.shift_m)} m ({_name(item)}, {_format_amount(item.minimal, item.unit)})"
            effects.setdefault(item.kind if item.kind == "offset" else _kind(item), text)
    if effects:
        yield f"largest effects of undetected errors: {', '.join(list(effects.values())[:_MAX_KINDS])}"

    hidden = [text for item in faults if not item.revealed for text in _hidden_lines(item)]
    if hidden:
        yield f"not revealed: {', '.join(first_lines(hidden, _MAX_HIDDEN))}"


def _is_fault(item: Reliability) -> bool:
    """Return whether an error is that of a station, link, target or stated value, not of Earth, Moon or a type."""
    kind, _, owner = item.name.partition(".")
    return (
        owner not in KINDS and kind != TERM and (kind not in PARAMETERS or PARAMETERS[kind].scopes[0].named)
    )


def _hidden_lines(item: Reliability) -> Iterator[str]:
    """Yield an error of a usual kind that the data do not reveal, with its effect on the position."""
    kind, effect_m = _kind(item), item.shift_per_unit_m
    if kind not in _CARD_KINDS or len(item.components) > 1:
        return
    if effect_m is None:
        yield _name(item)
    elif effect_m * PARAMETERS[kind].scale > _MIN_EFFECT_M:
        factor, unit = 1.0, item.unit
        if unit == "s":
            factor, unit = (1e-9, "ns") if PARAMETERS[kind].scale < _TIME_UNITS[0][0] else (1e-3, "ms")
        considered = f", sigma {item.prior_sigma / factor:.3g} {unit}" if item.prior_sigma else ""
        yield f"{_name(item)} ({metres(factor * effect_m)} m of position per {unit}{considered})"


def _kind(item: Reliability) -> str:
    return item.name.partition(".")[0]


def _name(item: Reliability) -> str:
    """Return the name of an error in words, such as "clock of KASHI"."""
    if item.kind == "offset":
        return f"offset of {item.name}"
    kind, _, owner = item.name.partition(".")
    if owner == ALL:
        return f"common {source_name(kind)}"
    components = item.components if len(item.components) == 1 else ()
    return parameter_name(".".join(filter(None, (item.name, *components))))


def _format_amount(value: float, unit: str) -> str:
    """Format an amount with three digits, of times in a suitable unit."""
    if unit == "s":
        for bound_s, factor, name in _TIME_UNITS:
            if value < bound_s:
                return f"{factor * value:.3g} {name}"
    return f"{value:.3g} {unit}" if unit != "1" else f"{value:.3g}"
