"""Keys of a study file that are easily taken for each other: what each takes, and where something else belongs."""

from __future__ import annotations

from dataclasses import fields

from radioloc.parameters.registry import PARAMETERS
from radioloc.studies.study import EstimateChoice, ModelChoice, ObservationChoice

_LISTED_FOR = {
    "range_bias_m": "range_bias",
    "clock_s": "clock",
    "clock_rate": "clock_rate",
    "zenith_delay_m": "zenith_delay",
}
"""What the simulated world has, and the key of ``[estimate]`` that lists for which stations a fit solves for it."""

_KEYS = {
    "observations": {field.name for field in fields(ObservationChoice)} - {"tdm"},
    "estimate": {field.name for field in fields(EstimateChoice)},
    "model": {field.name for field in fields(ModelChoice)} - {"terms", "delays"} | {"off", "station_delay_s"},
}


def table_of(key: str, besides: str) -> str:
    """The table of what is read, modelled or estimated that has a key unknown to one of them or above all tables.

    Parameters
    ----------
    key : str
    besides : str
        Name of the table in which it was found, empty for none.

    Returns
    -------
    str
        Empty where there is none, or several.
    """
    if besides and besides not in _KEYS:
        return ""
    found = [table for table, keys in _KEYS.items() if key in keys]
    return found[0] if len(found) == 1 else ""


def where_it_belongs(table: str, key: str) -> str:
    """What to say where a key was given something of another kind; empty for keys that are like no other.

    Parameters
    ----------
    table, key : str
        Name of the table, such as ``"simulation.truth"``, and the key in it.
    """
    match table, key:
        case "observations", "sigma_m":
            return (
                "it is a table by type, such as { range = 1.0 }, for files that state no sigma; a sigma in place of "
                "stated ones belongs to [[observations.weights]]"
            )
        case "observations", "extra_sigma_m":
            return (
                "it is of all observations; one by type, station or file belongs to [[observations.weights]]"
            )
        case "observations", "weights":
            return 'they are of chosen observations; how series are weighed ("correlated") is in [estimate] weights'
        case "observations.weights", "sigma_m" | "factor" | "extra_sigma_m":
            return (
                "it is of the observations that type, stations and files choose; sigmas by type, of files that state "
                "none, belong to [observations] sigma_m"
            )
        case "estimate", "weights":
            return "sigmas by type, station and file belong to [[observations.weights]]"
        case "estimate", _ if key in PARAMETERS:
            value_key, sigma_key = PARAMETERS[key].value_key, PARAMETERS[key].sigma_key
            simulated = next((name for name, listed in _LISTED_FOR.items() if listed == key), None)
            text = f"it says whose is estimated; an a-priori value belongs to {value_key}, its sigma to {sigma_key}"
            return text + (
                f", what a simulated world has to [simulation.truth] {simulated}" if simulated else ""
            )
        case "estimate", _:
            listed = [name for name, kind in PARAMETERS.items() if key in (kind.value_key, kind.sigma_key)]
            return (
                f"it is one number or a table by name; {listed[0]} says whose is estimated" if listed else ""
            )
        case "simulation.truth" | "simulation.truth_sigma", _ if key in _LISTED_FOR:
            return (
                "it is what the simulated world has, one number or a table by station; for which stations a fit "
                f"solves for it is said in [estimate] {_LISTED_FOR[key]}"
            )
    return ""
