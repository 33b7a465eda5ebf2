"""Numbers of every example and job, held to a billionth of their sigma while the structure of the estimation changes.

``python tests/regression/test_frozen_numbers.py [NAME ...]`` writes the files in ``numbers`` anew. A change that is
meant to move a number renews its file and says why in ``numbers/README.md``.
"""

import io
import json
import math
import re
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radioloc.cli import main

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
NUMBERS = HERE / "numbers"
EXAMPLES = ROOT / "examples"
TRACKING = ROOT.parent / "shared" / "data" / "odf"

SIGMA_FRACTION = 1e-9
"""Largest change of a number in units of its standard deviation, or relative where it has none."""

ANY_PROCESSOR_FRACTION = 1e-3
"""Ten times the largest change of an estimate by the rounding of another processor, in units of its sigma."""

ROUNDING_STEPS = 8
"""Largest change in steps of double precision: those of coordinates, 2e-10 m, exceed 1e-9 of a small sigma."""

MAX_MATRIX_ROWS = 40
"""Largest covariance matrix that is kept whole."""

UNSTABLE_KEYS = frozenset({"provenance", "notes", "limitations", "message", "reason"})
"""Keys whose content is prose, or depends on the machine."""


JOBS: dict[str, list[str]] = {
    "locate_apollo15": ["locate", "apollo15/apollo15.toml"],
    "locate_apollo15_2024": ["locate", "apollo15/apollo15_2024.toml"],
    "locate_beacon": ["locate", "beacon/beacon.toml"],
    "locate_change5": ["locate", "change5/change5.toml"],
    "locate_change5_free_biases": ["locate", "change5/free_biases.toml"],
    "locate_change5_short_arc": ["locate", "change5/short_arc.toml"],
    "locate_change5_short_arc_dem": ["locate", "change5/short_arc_dem.toml"],
    "locate_descent": ["locate", "descent/descent.toml"],
    "locate_dsn": ["locate", "dsn/lander.toml"],
    "locate_orbiter": ["locate", "orbiter/orbiter.toml"],
    "locate_reflectors_de421": ["locate", "reflectors/de421.toml"],
    "locate_reflectors_de440": ["locate", "reflectors/de440.toml"],
    "locate_orbit": ["locate", str(HERE / "studies" / "grail.toml")],
    "locate_orbit_process_noise": ["locate", str(HERE / "studies" / "grail_process_noise.toml")],
    "residuals_apollo15": ["residuals", "apollo15/apollo15.toml"],
    "residuals_orbiter": ["residuals", "orbiter/orbiter.toml"],
    "arcs_change5": ["arcs", "change5/change5.toml"],
    "leave_one_out_short_arc": ["leave-one-out", "change5/short_arc.toml"],
    "covariance_change5": ["covariance", "change5/simulation.toml"],
    "monte_carlo_change5": ["montecarlo", "change5/simulation.toml", "--trials", "4", "--workers", "1"],
    "images_descent": ["images", "images/descent.toml"],
    "images_orbital": ["images", "images/orbital_image.toml"],
    "images_stereo": ["images", "stereo/stereo.toml"],
    "compare_change3": ["compare", "change3/table4.toml"],
    "visibility_change5": ["visibility", "change5/simulation.toml"],
}


def numbers_of(arguments: list[str]) -> dict[str, Any]:
    """Run a command and return its exit status and its JSON: estimates, covariances, chi2, rejected observations."""
    command, study, *options = arguments
    with redirect_stdout(io.StringIO()) as printed:
        status = main([command, str(EXAMPLES / study), *options, "--json"])
    return {"exit_status": status} | _stable(json.loads(printed.getvalue()))


def _stable(value: Any) -> Any:
    """Drop prose and what depends on the machine, and all but the diagonal of large covariance matrices."""
    if isinstance(value, dict):
        return {key: _stable(item) for key, item in value.items() if key not in UNSTABLE_KEYS}
    if isinstance(value, list):
        if len(value) > MAX_MATRIX_ROWS and _is_matrix(value):
            return [row[k] for k, row in enumerate(value)]
        return [_stable(item) for item in value]
    return value


def differences(frozen: Any, computed: Any, scale: float = 0.0, where: str = "") -> Iterator[str]:
    """Yield what differs by more than the tolerance, with its place in the JSON."""
    if isinstance(frozen, dict) and isinstance(computed, dict):
        for key in sorted(frozen.keys() | computed.keys()):
            if key not in frozen or key not in computed:
                yield f"{where}.{key}: only {'computed' if key in computed else 'frozen'}"
            else:
                yield from differences(frozen[key], computed[key], _scale(frozen, key), f"{where}.{key}")
    elif isinstance(frozen, list) and isinstance(computed, list):
        if len(frozen) != len(computed):
            yield f"{where}: {len(frozen)} items frozen, {len(computed)} computed"
            return
        scales = _matrix_scales(frozen)
        for k, (one, other) in enumerate(zip(frozen, computed, strict=True)):
            yield from differences(one, other, scale if scales is None else scales[k], f"{where}[{k}]")
    elif _is_number(frozen) and _is_number(computed):
        tolerance = max(
            SIGMA_FRACTION * (scale or abs(frozen)), ROUNDING_STEPS * float(np.spacing(abs(frozen)))
        )
        if not abs(frozen - computed) <= tolerance:
            yield f"{where}: {frozen!r} frozen, {computed!r} computed, tolerance {tolerance:.1e}"
    elif frozen != computed:
        yield f"{where}: {frozen!r} frozen, {computed!r} computed"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scale(parent: dict[str, Any], key: str) -> float:
    """Return the standard deviation that belongs to a number of a JSON object, zero if none is stated."""
    if key in ("value", "prior_value") and _is_number(parent.get("sigma")):
        return float(parent["sigma"])
    return float(parent["rms_m"]) if key == "mean_m" and _is_number(parent.get("rms_m")) else 0.0


def _is_matrix(rows: list[Any]) -> bool:
    """Return whether a list holds the rows of a square matrix, whose undetermined elements are None."""
    return all(
        isinstance(row, list)
        and len(row) == len(rows)
        and all(item is None or _is_number(item) for item in row)
        for row in rows
    )


def _matrix_scales(rows: list[Any]) -> list[float] | None:
    """Return scales of the rows of a covariance matrix from its diagonal, or None for any other list."""
    if not rows or not _is_matrix(rows):
        return None
    diagonal = [abs(row[k] or 0.0) for k, row in enumerate(rows)]
    return [math.sqrt(size * max(diagonal)) for size in diagonal]


@pytest.mark.slow
@pytest.mark.parametrize("name", JOBS)
def test_numbers_are_frozen(name):
    if "orbit_" in f"{name}_" and "orbiter" not in name and not TRACKING.exists():
        pytest.skip("needs the tracking of GRAIL-B in ../shared/data/odf")
    frozen = json.loads((NUMBERS / f"{name}.json").read_text(encoding="utf-8"))
    found = list(differences(frozen, numbers_of(JOBS[name])))
    assert not found, "\n".join(found[:20])


@pytest.mark.study
@pytest.mark.parametrize("name", [name for name in JOBS if re.match(r"locate_(?!orb)", name)])
def test_positions_and_sigmas_are_those_of_any_processor(name):
    """Other processors round ranges otherwise, so that frozen numbers differ there and hide changes of the model."""
    frozen = json.loads((NUMBERS / f"{name}.json").read_text(encoding="utf-8"))
    computed = numbers_of(JOBS[name])
    for level in ("formal", "scaled"):
        sigmas_m = [list(item["sigma"][level].values()) for item in (frozen, computed)]
        np.testing.assert_allclose(*sigmas_m, rtol=ANY_PROCESSOR_FRACTION)
    places_m = [[item["position"]["me"][f"{axis}_m"] for axis in "xyz"] for item in (frozen, computed)]
    np.testing.assert_allclose(*places_m, rtol=0.0, atol=ANY_PROCESSOR_FRACTION * min(sigmas_m[0]))


if __name__ == "__main__":
    for chosen in sys.argv[1:] or JOBS:
        text = json.dumps(numbers_of(JOBS[chosen]), ensure_ascii=False, separators=(",", ":"))
        (NUMBERS / f"{chosen}.json").write_text(text + "\n", encoding="utf-8")
        print(chosen, len(text), file=sys.stderr)
