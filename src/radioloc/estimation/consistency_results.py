"""Results of consistency tests, with a sentence for each finding."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

from radioloc.constants import C_M_S
from radioloc.estimation.adaptation import AdaptedEstimate
from radioloc.estimation.hypotheses import TERM
from radioloc.estimation.reliability import Reliability
from radioloc.parameters.registry import parameter_label

SIGNIFICANCE_LEVEL = 1e-3  # fewer than one false finding in a thousand solutions
_MAX_PRINTED_ALTERNATIVES = 3


@dataclass(frozen=True, slots=True)
class ConsistencyTest:
    """Consistency test of a group of observations or of an explanation, with its result."""

    # Removed: "station", "link", "type", "pass"; estimated: "a priori", "parameter", "jump", "offset"; rejected: "run";
    # stated: "sigma"; corrected: "mistake"; of an orbit: "forces".
    kind: str
    name: str  # station, link, type or parameter that is tested
    chi2: float  # test statistic
    dof: int
    log10_p_value: float  # corrected for the number of tests
    # Change of the position by the removal or estimation, together with the preceding findings, and its sigma
    shift_enu_m: tuple[float, float, float] | None = None
    shift_sigma_enu_m: tuple[float, float, float] | None = None
    amounts: dict[str, float] = field(default_factory=dict)  # estimated components, in `unit`
    unit: str = ""
    first_utc: str = ""  # epochs of the interval, empty for the whole arc
    last_utc: str = ""
    prior_sigmas: float | None = None  # amounts over a-priori sigmas, or over the scale of the parameter
    data_values: dict[str, float] = field(default_factory=dict)  # a-priori values from the data alone
    alternatives: tuple[ConsistencyTest, ...] = ()  # other explanations that the data cannot exclude
    next_chi2_ratio: float | None = None  # of a mistake: chi-square of the next hypothesis over its own

    @property
    def significant(self) -> bool:
        """True if the p-value is below the significance level."""
        return self.log10_p_value < math.log10(SIGNIFICANCE_LEVEL)

    @property
    def participants(self) -> frozenset[str]:
        """Words of the name, among them the stations concerned."""
        return frozenset(re.split(r"[ .<>|]+", self.name))

    def to_dict(self) -> dict[str, Any]:
        """Return all fields for JSON; a significant test has a sentence as ``text``."""
        axes, undefined = ("east_m", "north_m", "up_m"), (None, None, None)
        return {
            **self._cause_dict(),
            "chi2": self.chi2,
            "dof": self.dof,
            "log10_chance": self.log10_p_value,
            "shift": dict(zip(axes, self.shift_enu_m or undefined, strict=True)),
            "shift_sigma": dict(zip(axes, self.shift_sigma_enu_m or undefined, strict=True)),
            "first_utc": self.first_utc or None,
            "last_utc": self.last_utc or None,
            "data_values": self.data_values,
            "next_chi2_ratio": self.next_chi2_ratio,
            "alternatives": [item._cause_dict() for item in self.alternatives],
            "significant": self.significant,
            "text": str(self) if self.significant else None,
        }

    def _cause_dict(self) -> dict[str, Any]:
        return {key: getattr(self, key) for key in ("kind", "name", "amounts", "unit", "prior_sigmas")}

    def __str__(self) -> str:
        sentence = self.cause
        if self.next_chi2_ratio is not None:
            sentence += f" (chi-square {self.next_chi2_ratio:.3g} times smaller than of the next hypothesis)"
        if self.shift_enu_m is not None:
            condition = "with that" if self.amounts else "without it"
            sentence += f"; {condition} the position moves by {math.hypot(*self.shift_enu_m):.3g} m"
        if self.alternatives:
            causes = [item.cause for item in self.alternatives[:_MAX_PRINTED_ALTERNATIVES]]
            if len(self.alternatives) > len(causes):
                causes.append(f"{len(self.alternatives) - len(causes)} more in solution.json")
            sentence += f"; the data cannot exclude that {', or '.join(causes)}"
        return sentence

    @property
    def cause(self) -> str:
        """Cause in words, with its amounts."""
        period = f" from {self.first_utc} to {self.last_utc}" if self.last_utc else ""
        value = next(iter(self.amounts.values()), 0.0)
        match self.kind:
            case "a priori" | "parameter":
                return self._parameter_error(value)
            case "jump":
                return f"{self.name} jumps by {_length_or_delay(value, self.unit)} at {self.first_utc}"
            case "offset":
                return f"{self.name} is off by {_length_or_delay(value, self.unit)}{period}"
            case "mistake":
                return self.name
            case "forces":
                return "the forces of the orbit (gravity field, manoeuvres, radiation) do not fit the observations"
            case "run":
                return f"{self.dof} observations of {self.name}{period} are off by {value:+.3g} {self.unit}, rejected"
            case "sigma":
                factor, word = (value, "small") if value > 1.0 else (1.0 / value, "large")
                text = f"{factor:.0f}" if factor >= 10.0 else f"{factor:.2g}"
                members = f" of {self.name}" if self.name else ""
                return f"the stated sigmas{members} are about {text} times too {word}"
        return f"{self.name}{period} does not fit the others"

    def _parameter_error(self, value: float) -> str:
        """Return the error of an a-priori value or of a parameter held at zero in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        amounts = " ".join(
            f"{amount:+.3g}{unit}{f' {name}' if name else ''}" for name, amount in self.amounts.items()
        )
        kind, _, owner = self.name.partition(".")
        if self.kind == "parameter" and kind == TERM:
            return (
                f"the observations contain the term {owner}, which is switched off ({value:+.3g} of it fit)"
            )
        if self.kind == "parameter":
            return f"the {parameter_label(self.name)} is {amounts}, not zero"
        explanation = f"{amounts} explains it"
        if kind == "position" and owner and len(self.data_values) == 1:
            [data_value] = self.data_values.values()
            explanation += f": the data alone give {data_value:.1f} {self.unit}"
        label = owner if kind == "position" else parameter_label(self.name)
        return f"the a-priori {label} does not fit the observations ({explanation})"


def _length_or_delay(value: float, unit: str) -> str:
    """Return a length also as a delay, and a delay also as a length."""
    if unit == "m":
        return f"{value:+.3g} m ({1e9 * value / C_M_S:+.3g} ns)"
    return f"{1e9 * value:+.3g} ns ({C_M_S * value:+.3g} m)" if unit == "s" else f"{value:+.3g} {unit}"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Results of the consistency tests of a fit."""

    groups: tuple[ConsistencyTest, ...] = ()  # tests of all groups, significant or not
    # Significant tests, each with the preceding ones as parameters.
    findings: tuple[ConsistencyTest, ...] = ()
    adapted: AdaptedEstimate | None = None  # estimate with the findings as parameters; None without findings
    reliability: tuple[Reliability, ...] = ()  # of all hypotheses on errors that last for the whole arc

    def __repr__(self) -> str:
        return f"<Consistency of {len(self.groups)} groups, {len(self.findings)} finding(s)>"

    def to_list(self) -> list[dict[str, Any]]:
        """Return findings and groups in types of JSON."""
        return [item.to_dict() for item in (*self.findings, *self.groups)]
