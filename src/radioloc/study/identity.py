"""Comparison of the spacecraft identifiers in study, tracking data and calibrations."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from radioloc.errors import InputError
from radioloc.measurements.link import REFLECTORS, canonical_target
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.study.study import Study

_ROLES = ("beacon", "lander", "orbiter", "spacecraft", "target")
"""Names of targets in tracking data that do not identify a spacecraft."""
_UNSTATED_BODY = -999  # NAIF code of an orbiter without one


def spacecraft_doubts(study: Study, observations: Observations, model: PhysicalModel) -> list[str]:
    """Return notes on identifiers that differ; :class:`InputError` for those that contradict each other."""
    links = (observations.links[k] for k in np.unique(observations.link))
    tracked = sorted({canonical_target(name) for link in links for name in link.targets} - {*model.sources})
    return [*_target_doubts(study, tracked), *_calibration_doubts(study, tracked, model)]


def _target_doubts(study: Study, tracked: list[str]) -> Iterator[str]:
    """Compare name and NAIF code of ``[target]`` with the target of the tracking data."""
    confirmed = study.targets or study.observations.targets or study.observations.target_names
    name, body = study.target_name, getattr(study.target, "body", None)
    if confirmed or len(tracked) != 1 or tracked[0] in _ROLES:
        return
    [target] = tracked
    advice = f'name it in the study, [observations] targets = ["{target}"], if they are the same'
    number = _number(target)
    if number is not None and body is not None and number == -body:
        return  # most numbers of the Deep Space Network are NAIF codes with the opposite sign
    if name is not None:
        names = [re.sub(r"[\W_]", "", text.casefold()) for text in (canonical_target(name), target)]
        if names[0] in names[1] or names[1] in names[0]:
            return
        comparable = {canonical_target(name), target} <= {*REFLECTORS} or (
            number is not None and _number(canonical_target(name)) is not None
        )
        problem = f"the observations are of {target}, but [target] name is {name!r}"
        if comparable:
            raise InputError(f"{problem}; give the files of that target, or correct the name: {advice}")
        yield f"{problem}; {advice}"
    elif number is not None and body not in (None, _UNSTATED_BODY):
        yield f"the observations are of {target}, but [target] body is {body}; {advice}"


def _calibration_doubts(study: Study, tracked: list[str], model: PhysicalModel) -> Iterator[str]:
    """Compare the spacecraft numbers of calibration cards with those of the tracking data (Deep Space Network)."""
    cards = model.media_calibrations
    body = getattr(study.target, "body", None)
    tracked_numbers = {number for number in map(_number, tracked) if number is not None}
    numbers = tracked_numbers or ({-body} if body not in (None, _UNSTATED_BODY) else set())
    if cards is None or not numbers:
        return
    for number in sorted({card.scid for card in cards.cards if card.scid is not None} - numbers):
        problem = (
            f"the calibrations are of the spacecraft {number}, but the tracking is of {', '.join(tracked)}"
        )
        if not tracked_numbers:
            yield f"the calibrations are of the spacecraft {number}, but [target] body is {body}; check both"
        elif study.model.csp_scid is None:
            raise InputError(
                f"[model] csp: {problem}; give the files of that spacecraft, or csp_scid = {number} if they hold for it"
            )
        else:
            yield f"{problem}; they are used, as csp_scid says"


def _number(target: str) -> int | None:
    """Return the spacecraft number of the Deep Space Network in a name such as sc181."""
    match = re.fullmatch(r"(?i)sc[ _-]?(\d{1,6})", target)
    return int(match[1]) if match else None
