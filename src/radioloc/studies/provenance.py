"""What a result rests on: versions, files with their hashes, and the choices of the study."""

from __future__ import annotations

import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc._version import __version__
from radioloc.ephemeris import Trajectory
from radioloc.kernels import sha256_of
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.chebyshev_predictor import ChebyshevPredictor
from radioloc.measurements.observations import Observations
from radioloc.measurements.physical_model import PhysicalModel, kernel_record
from radioloc.measurements.predictor import Predictor
from radioloc.parameters.choice import chosen_keys
from radioloc.parameters.registry import PARAMETERS
from radioloc.studies.study import EstimateChoice, ModelChoice, Study, TerrainPrior


def provenance(
    study: Study,
    model: PhysicalModel,
    observations: Observations,
    left_out: dict[str, int],
    estimate: EstimateChoice | None,
) -> dict[str, Any]:
    """Versions, files, choices and kernels of a fit, as ``solution.json`` has them."""
    return {
        "radioloc": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "files": [Path(name).name for name in observations.files],
        "not_selected": left_out,
        "extra_sigma_m": study.observations.extra_sigma_m,
        "vlbi_station_sigma_m": study.observations.vlbi_station_sigma_m,
        "vlbi_station_rate_sigma_m": study.observations.vlbi_station_rate_sigma_m,
        "weights": [weight.record() for weight in study.observations.weights],
        "estimate": None if estimate is None else _estimate_record(estimate),
        **_target_record(study.target),
        "ionosphere": {"ionex": [path.name for path in study.model.ionex], "tec_tecu": study.model.tec_tecu},
        "troposphere": _troposphere_record(study.model),
        "delays": {
            "transponder_s": model.delays.transponder_s,
            "stations": {name: asdict(delay) for name, delay in model.delays.stations.items()},
        },
        **model.provenance(),
    }


def evaluation_record(arc: Predictor, lander_pa_m: NDArray[np.float64]) -> dict[str, Any]:
    """How the observations were computed and, where they were interpolated, how well that agrees with the model."""
    if isinstance(arc, ChebyshevPredictor):
        return {"kind": "interpolated", **asdict(arc.check(lander_pa_m))}
    return {"kind": "exact"}


def _troposphere_record(choice: ModelChoice) -> dict[str, Any]:
    orography = () if choice.vmf3_orography is None else (choice.vmf3_orography,)
    gpt3 = () if choice.gpt3 is None else (choice.gpt3,)
    return {
        key: [{"name": path.name, "sha256": sha256_of(path)} for path in paths]
        for key, paths in (("vmf3", choice.vmf3), ("vmf3_orography", orography), ("gpt3", gpt3))
    }


def _target_record(target: LunarPosition | Trajectory) -> dict[str, Any]:
    if isinstance(target, Trajectory):
        return {
            "a_priori": None,
            "trajectory": {"body": target.body, **kernel_record(target.kernel, target.name)},
        }
    return {"a_priori": {"frame": target.frame, "xyz_m": target.xyz_m.tolist()}, "trajectory": None}


def _estimate_record(estimate: EstimateChoice) -> dict[str, Any]:
    """What was estimated; of a terrain map its files, not its heights."""
    prior: Any = estimate.height_prior
    if isinstance(prior, TerrainPrior):
        map_files = [{"name": file.path.name, "sha256": file.sha256} for file in prior.terrain.metadata.files]
        prior = {"dem": map_files, "interpolation": prior.terrain.interpolation, "sigma_m": prior.sigma_m}
    elif prior is not None:
        prior = asdict(prior)
    return {
        "position": estimate.position,
        "height_prior": prior,
        "ephemeris_sigma_m": estimate.ephemeris_sigma_m,
        "rejection_sigma": estimate.rejection_sigma,
        "weights": estimate.weights,
        "pass_gap_h": estimate.pass_gap_h,
        **dict.fromkeys(PARAMETERS, "none"),
        **chosen_keys(estimate.parameters),
    }
