"""Accuracy of planned tracking over a grid of landing sites: the covariance analysis repeated at each site.

Stations, media and ephemeris are prepared once. Each site has the observations of the schedule at which it is visible,
and partials at its position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.planned_fit import PlannedFit
from radioloc.jobs.preparation import build_model, planned_arc
from radioloc.jobs.problem import ArcPart, EstimationProblem, arc_parts
from radioloc.jobs.selection import arc_lengths, since_start_s
from radioloc.jobs.study_targets import surface_points
from radioloc.jobs.trial_folder import (
    TrialFolder,
    locked_folder,
    refuse_other_study,
    run_trials,
    study_record,
)
from radioloc.jobs.workers import open_workers
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.parameter import ParameterSet
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.results.accuracy_map import AccuracyMap
from radioloc.simulation.schedule import Plan, Planner
from radioloc.simulation.simulate import Scenario
from radioloc.study.study import HeightPrior, Study
from radioloc.study.study_file import as_study
from radioloc.targets.design import ObservationModel
from radioloc.targets.doubts import MIN_EARTH_ELEVATION_DEG
from radioloc.vectors import Floats

_MASK_MARGIN_DEG = 0.7  # largest difference of elevations of two points on the Moon, 0.55 deg at perigee
# Of straight motions: 12 ms of light time between the middle and the limb of the disc; then 7 um.
_MAX_EXTRAPOLATION_S = 0.02
_MAX_CHUNK_SITES = 10  # which take a tenth of a second
_COLUMNS = ("count", "refused", "sigma_east_m", "sigma_north_m", "sigma_up_m", "radius_95_m", "span_h")
_NOT_VISIBLE = (0, 0, *(math.inf,) * 4, 0.0)
_MAX_SITES = 1_000_000
NEAR_SIDE_DEG = (-90.0, -90.0, 90.0, 90.0)
"""West, south, east and north of the near side."""


@accepts_quantities
def accuracy_map(
    study: Study | str | Path,
    step_deg: FloatLike,
    *,
    region_deg: Sequence[float] = NEAR_SIDE_DEG,
    hours: FloatLike | None = None,
    workers: Any = 1,
    out: str | Path | None = None,
    resume: bool = False,
    progress: bool = False,
) -> AccuracyMap:
    """Predict the accuracy of a tracking plan at each landing site of a grid.

    Parameters
    ----------
    study : Study or path-like
        Study with one lander, and with a simulation that states schedule and noise. All sites have the height of the
        lander above the sphere of 1737.4 km, and the sigma of its a-priori height.
    step_deg : float
        Size of the cells in longitude and latitude, deg; a site is in the middle of each.
    region_deg : sequence of float
        West, south, east and north edge, deg, mean-Earth axes; the near side by default.
    hours : float, optional
        Length of the tracking from the start, h; all by default.
    workers : int or executor
        Processes, as in :func:`radioloc.monte_carlo`.
    out : path-like, optional
        Folder in which each site is saved once it is computed. Without `resume`, sites of an earlier map are removed.
    resume : bool
        Whether to keep the sites that are already in `out`.
    progress : bool
        Whether to show a progress bar, on a terminal or in a notebook.

    Raises
    ------
    InputError
        The study has no simulation or another target than one lander, the grid is empty or too large, or `out` holds
        the sites of another map.

    Examples
    --------
    >>> import radioloc
    >>> accuracy = radioloc.accuracy_map("examples/change5/short_arc.toml", 45.0)
    >>> accuracy.radius_95_m.shape, bool(accuracy.determined)
    ((4, 4), True)
    """
    study = as_study(study)
    if study.simulation is None or len(study.points) != 1 or len(study.all_targets) != 1:
        raise InputError("an accuracy map needs a study with one lander and a [simulation] of its tracking")
    if study.estimate.position == "none" or study.estimate.position_priors:
        raise InputError("an accuracy map needs [estimate] position, and no [[observations.map_positions]]")
    longitude_deg, latitude_deg = _cells(step_deg, region_deg)
    sites = _Sites(study, longitude_deg, latitude_deg, hours)
    count = len(longitude_deg) * len(latitude_deg)
    record = study_record(study, [] if hours is None else [hours], 0)
    record |= {"grid_deg": [step_deg, *region_deg]}
    resumed = resume and out is not None and refuse_other_study(out, record)
    with locked_folder(out), open_workers(workers) as pool:
        folder = None if out is None else TrialFolder(out, record, _COLUMNS, (0.0,))
        if folder is not None and not resumed:
            folder.start()
        values = run_trials(
            pool,
            sites,
            0,
            range(count),
            way="sites",
            max_chunk=_MAX_CHUNK_SITES,
            folder=folder,
            bar={"shown": progress, "unit": "site"},
        )[:, 0]
    grid = values.reshape(len(latitude_deg), len(longitude_deg), -1)
    return AccuracyMap(
        study.name,
        sites.model.ephemeris.constants.me_frame,
        sites.height_m,
        float(values[:, 6].max()),
        longitude_deg,
        latitude_deg,
        grid[..., 0].astype(np.int64),
        grid[..., 1].astype(np.int64),
        grid[..., 2:5],
        grid[..., 5],
    )


def _cells(step_deg: float, region_deg: Sequence[float]) -> tuple[Floats, Floats]:
    """Return the longitudes and latitudes of the middles of the cells, deg, the latitudes from north to south."""
    west, south, east, north = region_deg if len(region_deg) == 4 else (math.nan,) * 4
    if not (-360.0 <= west < east <= west + 360.0 and east <= 720.0 and -90.0 <= south < north <= 90.0):
        raise InputError(
            f"region_deg: expected west < east, south < north in degrees, got {tuple(region_deg)}"
        )
    if not 0.0 < step_deg <= min(east - west, north - south):
        raise InputError(f"step_deg: expected a number above 0 within the region, got {step_deg!r}")
    columns, rows = (math.floor(size / step_deg + 1e-9) for size in (east - west, north - south))
    if columns * rows > _MAX_SITES:
        raise InputError(
            f"expected a grid of at most {_MAX_SITES} sites, got {columns * rows}; use a larger step"
        )
    middles = [step_deg * (np.arange(count) + 0.5) for count in (columns, rows)]
    return np.asarray(west + middles[0]), np.asarray(north - middles[1])


@dataclass(frozen=True)
class _Sites:
    """A grid of sites; all that they have in common is computed when the first is asked for."""

    study: Study
    longitude_deg: Floats
    latitude_deg: Floats
    hours: float | None

    @on_one_blas_thread()
    def run(self, seed: int, trials: Sequence[int]) -> Floats:
        """Return the accuracy at some sites, (sites, 1, columns)."""
        problem = self.part.problem
        # The check points of an interpolated arc follow the sites, so that each run begins with a copy.
        model = replace(problem.model, predictor=copy(problem.model.predictor))
        rows = [self._accuracy(model, *divmod(site, len(self.longitude_deg))) for site in trials]
        return np.array(rows)[:, None]

    @cached_property
    def model(self) -> PhysicalModel:
        """Physical model of the study, with straight motions near events that serve all sites."""
        return replace(build_model(self.study), max_extrapolation_s=_MAX_EXTRAPOLATION_S)

    @cached_property
    def height_m(self) -> float:
        """Height of all sites above the sphere of 1737.4 km, m."""
        [target] = self.study.points.values()
        return target.to_axes("ME", self.model.ephemeris.constants).selenographic[2]

    @property
    def part(self) -> ArcPart:
        """Problem of all observations within the length that any site may have."""
        return self._planned[1]

    @property
    def _scenario(self) -> Scenario:
        assert self.study.simulation is not None  # required of the study
        return self.study.simulation

    @cached_property
    def _planner(self) -> Planner:
        schedule = self._scenario.schedule
        target_deg = max(schedule.masks.target_deg, MIN_EARTH_ELEVATION_DEG)
        return replace(schedule, masks=replace(schedule.masks, target_deg=target_deg)).planner(self.model)

    @cached_property
    def _planned(self) -> tuple[Plan, ArcPart]:
        """All observations within the length that any site may have, as planned and as a problem."""
        study, scenario, model = self.study, self._scenario, self.model
        masks = scenario.schedule.masks
        lower = {name: max(deg - _MASK_MARGIN_DEG, -90.0) for name, deg in masks.by_station_deg.items()}
        station_deg = max(masks.station_deg - _MASK_MARGIN_DEG, -90.0)
        wider = replace(masks, station_deg=station_deg, target_deg=-90.0, by_station_deg=lower)
        # Which station transmits depends on the site.
        sessions = [replace(session, one_uplink=False) for session in scenario.schedule.sessions]
        schedule = replace(scenario.schedule, sessions=sessions, masks=wider)
        plan = schedule.plan(model, {next(iter(scenario.targets)): self._place(0.0, 0.0)})
        predictor, _, rows = planned_arc(study, plan.observations, model, {})
        noise = scenario.noise.covariance(plan).select(rows)
        lengths = arc_lengths([1e9 if self.hours is None else self.hours], study.observations)
        [part] = arc_parts(EstimationProblem.from_study(study, predictor, study.estimate, noise), lengths)
        return plan.select(rows[part.rows]), part

    @cached_property
    def _since_start_h(self) -> Floats:
        """Time of the observations of the part since the start, h, (n,)."""
        return since_start_s(self.part.problem.predictor.observations, self.study.observations) / 3600.0

    def _place(self, longitude_deg: float, latitude_deg: float) -> LunarPosition:
        """Return a site in principal axes."""
        constants = self.model.ephemeris.constants
        frame = constants.me_frame
        site = LunarPosition.from_selenographic(longitude_deg, latitude_deg, self.height_m, frame=frame)
        return site.to_axes("PA", constants)

    def _accuracy(self, model: ObservationModel, row: int, column: int) -> tuple[float, ...]:
        """Return the columns of a site; sigmas are infinite where the observations do not determine it."""
        place = self._place(float(self.longitude_deg[column]), float(self.latitude_deg[row]))
        visible = self._planner.measured(self._planned[0], {next(iter(self._scenario.targets)): place})
        if not visible.any():
            return _NOT_VISIBLE
        problem, choice = self.part.problem, self.study.estimate
        if choice.height_prior is not None:
            prior = HeightPrior(self.height_m, choice.height_prior.sigma_m)
            choice = replace(choice, height_prior=prior)
        [target] = surface_points({"": place}, self.model, choice)
        parameters = ParameterSet([*target.parameters, *list(model.parameters)[model.first :]])
        at_site = replace(model, targets=(target,), parameters=parameters)
        design = at_site.linearize(parameters.prior_values)
        rows = np.flatnonzero(visible)
        rows = rows[design.prediction.rows(rows).usable]
        refused = int(visible.sum()) - len(rows)
        if not len(rows):
            return (0, refused, *_NOT_VISIBLE[2:])
        used = np.zeros(len(visible), dtype=bool)
        used[rows] = True
        part = replace(self.part, problem=replace(problem, model=at_site))
        planned = PlannedFit(part, used, {}, parameters, design=design).planned()
        span_h = float(self._since_start_h[rows].max())
        return (planned.count, refused, *planned.sigma_m.tolist(), planned.radius_95_m, span_h)
