"""Accuracy of planned tracking over a grid of landing sites: the covariance analysis repeated at each site.

Stations, media and ephemeris are prepared once. Each site has the observations of the schedule at which it is visible,
and partials at its position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.errors import InputError
from radioloc.jobs.one_thread import on_one_blas_thread
from radioloc.jobs.planned_fit import PlannedFit
from radioloc.jobs.preparation import model_of, planned_arc
from radioloc.jobs.problem import ArcPart, EstimationProblem, arc_parts
from radioloc.jobs.selection import arc_lengths
from radioloc.jobs.study_targets import surface_points
from radioloc.jobs.workers import workers_of
from radioloc.lunar.position import LunarPosition
from radioloc.measurements.physical_model import PhysicalModel
from radioloc.parameters.parameter import ParameterSet
from radioloc.progress import progress_bar
from radioloc.quantities import FloatLike, accepts_quantities
from radioloc.results.accuracy_map import AccuracyMap
from radioloc.simulation.schedule import Plan, Planner
from radioloc.study.study import HeightPrior, Study
from radioloc.study.study_file import as_study
from radioloc.vectors import Floats

_MASK_MARGIN_DEG = (
    0.7  # largest difference of a station's elevations of two points on the Moon, 0.55 deg at perigee
)
_SITES_IN_CHUNK = 100
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
    progress: bool = False,
) -> AccuracyMap:
    """Predict the accuracy of a tracking plan at each landing site of a grid.

    Parameters
    ----------
    study : Study or path-like
        With one lander and a simulation, whose schedule and noise are taken. All sites have the height of its target,
        above the sphere of 1737.4 km, and the sigma of its a-priori height.
    step_deg : float
        Distance of the sites in longitude and latitude, deg; they are in the middle of such cells.
    region_deg : sequence of float
        West, south, east and north edge, deg, mean-Earth axes; the near side by default.
    hours : float, optional
        Length of the tracking from the start, h; all by default.
    workers : int or distributed.Client
        Number of processes, or the client of a Dask cluster.
    progress : bool
        Show a bar, on a terminal or in a notebook.

    Raises
    ------
    InputError
        The study has no simulation or another target than one lander, or the grid is empty or too large.

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
    chunks = [range(k, min(k + _SITES_IN_CHUNK, count)) for k in range(0, count, _SITES_IN_CHUNK)]
    values = np.empty((count, 5))
    with workers_of(workers) as run, progress_bar(shown=progress, total=count, unit="site") as bar:
        for chunk, rows in run(sites, 0, chunks):
            values[list(chunk)] = rows[:, 0]
            bar.update(len(chunk))
    grid = values.reshape(len(latitude_deg), len(longitude_deg), 5)
    return AccuracyMap(
        study.name,
        sites.model.ephemeris.constants.me_frame,
        sites.height_m,
        sites.part.span_h,
        longitude_deg,
        latitude_deg,
        grid[..., 0].astype(np.int64),
        grid[..., 1:4],
        grid[..., 4],
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
        """Return observations, sigma east, north and up, and 95 % radius of some sites, (sites, 1, 5)."""
        return np.array([self._accuracy(*divmod(site, len(self.longitude_deg))) for site in trials])[:, None]

    @cached_property
    def model(self) -> PhysicalModel:
        """Physical model of the study."""
        return model_of(self.study)

    @cached_property
    def height_m(self) -> float:
        """Height of all sites above the sphere of 1737.4 km, m."""
        [target] = self.study.points.values()
        return target.to_axes("ME", self.model.ephemeris.constants).selenographic[2]

    @cached_property
    def _planner(self) -> Planner:
        assert self.study.simulation is not None  # required of the study
        return self.study.simulation.schedule.planner(self.model)

    @cached_property
    def _everything(self) -> tuple[Plan, NDArray[np.intp], EstimationProblem]:
        """All observations that any site may have, the rows of the plan in the arc, and their problem."""
        study, scenario = self.study, self.study.simulation
        assert scenario is not None
        masks = scenario.schedule.masks
        lower = {name: max(deg - _MASK_MARGIN_DEG, -90.0) for name, deg in masks.by_station_deg.items()}
        station_deg = max(masks.station_deg - _MASK_MARGIN_DEG, -90.0)
        wider = replace(masks, station_deg=station_deg, target_deg=-90.0, by_station_deg=lower)
        # Which station transmits depends on the site.
        sessions = [replace(session, one_uplink=False) for session in scenario.schedule.sessions]
        schedule = replace(scenario.schedule, sessions=sessions, masks=wider)
        model, name = self.model, next(iter(scenario.targets))
        plan = schedule.plan(model, {name: self._place(0.0, 0.0).xyz_m})
        arc, _, rows = planned_arc(study, plan.observations, model, {})
        noise = scenario.noise.covariance(plan).select(rows)
        return plan, rows, EstimationProblem.of(study, arc, study.estimate, noise)

    @cached_property
    def part(self) -> ArcPart:
        """Problem of the observations within the length."""
        lengths = arc_lengths([1e9 if self.hours is None else self.hours], self.study.observations)
        [part] = arc_parts(self._everything[2], lengths)
        return part

    def _place(self, longitude_deg: float, latitude_deg: float) -> LunarPosition:
        """Return a site in principal axes."""
        constants = self.model.ephemeris.constants
        frame = constants.me_frame
        site = LunarPosition.from_selenographic(longitude_deg, latitude_deg, self.height_m, frame=frame)
        return site.to_axes("PA", constants)

    def _accuracy(self, row: int, column: int) -> tuple[float, ...]:
        """Return observations, sigmas and 95 % radius at a site; infinite where they do not determine it."""
        place = self._place(float(self.longitude_deg[column]), float(self.latitude_deg[row]))
        used = self._visible(place.xyz_m)
        if not used.any():
            return (0, *(math.inf,) * 4)
        problem, choice = self.part.problem, self.study.estimate
        if choice.height_prior is not None:
            prior = HeightPrior(self.height_m, choice.height_prior.sigma_m)
            choice = replace(choice, height_prior=prior)
        [target] = surface_points({"": place}, self.model, choice)
        model = problem.model
        parameters = ParameterSet([*target.parameters, *list(model.parameters)[model.first :]])
        at_site = replace(model, targets=(target,), parameters=parameters, partials_cache=[])
        part = replace(self.part, problem=replace(problem, model=at_site))
        planned = PlannedFit(part, used, {}, parameters).planned()
        return (planned.count, *planned.sigma_m.tolist(), planned.radius_95_m)

    def _visible(self, site_pa_m: Floats) -> NDArray[np.bool_]:
        """Mask of the observations of the part at which a site is visible."""
        everything, rows, _ = self._everything
        try:
            plan = self._planner.plan({next(iter(self.study.simulation.targets)): site_pa_m})  # type: ignore[union-attr]
        except InputError:  # nothing is visible
            return np.zeros(len(self.part.rows), dtype=bool)
        chosen = rows[self.part.rows]
        return np.isin(_keys(everything)[chosen], _keys(plan))


def _keys(plan: Plan) -> NDArray[np.int64]:
    """Return a number for the session, epoch and pair of each observation."""
    return (plan.session << 48) + (plan.slot << 16) + plan.pair
