"""The table of an arc-length study: positions beside reference positions, as in Wang et al. (2021), table 1."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from radioloc.constants import MEAN_LUNAR_RADIUS_M
from radioloc.estimation.cards import CardField, metres, render_text, sigma_text, to_sigma, which_sigmas

if TYPE_CHECKING:
    from radioloc.estimation.solution import Solution
    from radioloc.studies.arcs import ArcStudy, Predictor

_WIDTH = 96
_PARAMETERS_IN_ROW = 3
_MAX_PARAMETERS = 12  # a card is to fit a screen; to_dict() has them all
_BENCHMARK = "benchmark"
_UNLIKELY_SIGMAS = 3.72
"""Two coordinates of a right model stay below this in 99.9 %."""


@dataclass(frozen=True, slots=True)
class PositionRow:
    """A position and how far it is from the benchmark.

    Longitudes are counted to the west, -180 to 180 deg, as maps of the near side's west and Wang et al. (2021) do.
    Differences in metres are arcs on the sphere of 1737.4 km: of longitude R cos(B) dL at the benchmark's latitude, of
    latitude R dB.

    Parameters
    ----------
    method : str
        ``"tracking"`` or ``"reference"``.
    name : str
        Length of the arc or name of the reference.
    longitude_west_deg, latitude_deg : float
        Mean-Earth axes.
    height_m : float
        Above the sphere of 1737.4 km.
    west_deg, north_deg, west_m, north_m, up_m : float or None
        This less the benchmark; None for the benchmark itself.
    sigma_west_m, sigma_north_m, sigma_up_m : float or None
        Total standard deviations; None for references and where not determined.
    from_longest_m : float or None
        Horizontal distance from the longest arc's position; None for that itself.
    from_longest_sigmas : float or None
        The same in the standard deviations that this difference should have (:func:`departure_sigmas`).
    used, left_out : int or None
        Number of observations; None for references.
    wrms_m : float or None
        Weighted rms of the used residuals.
    converged : bool or None
        Whether the fit converged and everything is determined; None for references.
    """

    method: str
    name: str
    longitude_west_deg: float
    latitude_deg: float
    height_m: float
    west_deg: float | None
    north_deg: float | None
    west_m: float | None
    north_m: float | None
    up_m: float | None
    sigma_west_m: float | None = None
    sigma_north_m: float | None = None
    sigma_up_m: float | None = None
    from_longest_m: float | None = None
    from_longest_sigmas: float | None = None
    used: int | None = None
    left_out: int | None = None
    wrms_m: float | None = None
    converged: bool | None = None

    def to_dict(self) -> dict[str, Any]:
        """Its fields by name."""
        return asdict(self)


Place = tuple[float, float, float]
"""East longitude and latitude, deg, and height, m."""

_Five = tuple[float | None, float | None, float | None, float | None, float | None]
_NONE: _Five = (None, None, None, None, None)


def difference(one: Place, benchmark: Place) -> tuple[float, float, float, float, float]:
    """How far west, north (deg), west, north, up (m) a position is of a benchmark.

    Parameters
    ----------
    one, benchmark : tuple of float
        East longitude and latitude in deg, height in m.
    """
    west_deg = -math.remainder(one[0] - benchmark[0], 360.0)
    north_deg = one[1] - benchmark[1]
    metres_per_deg = math.radians(MEAN_LUNAR_RADIUS_M)
    west_m = west_deg * metres_per_deg * math.cos(math.radians(benchmark[1]))
    return west_deg, north_deg, west_m, north_deg * metres_per_deg, one[2] - benchmark[2]


def comparison(study: ArcStudy) -> tuple[PositionRow, ...]:
    """Rows of the table: arcs, the longest first, then references."""
    longest = study.longest.selenographic
    benchmark = study.references[0].position.selenographic if study.references else longest
    rows = []
    for k, arc in enumerate(study.arcs):
        place = arc.solution.selenographic
        itself = k == 0 and not study.references
        _, _, west_m, north_m, _ = difference(place, longest)
        row = _row("tracking", arc.name, place, None if itself else benchmark)
        sigmas_m = [float(s) if math.isfinite(s) else None for s in arc.solution.sigma_enu_m()]
        if not arc.solution.position_estimated:
            sigmas_m = [None] * 3
        total = arc.solution.fit.total
        rows.append(
            replace(
                row,
                sigma_west_m=sigmas_m[0],
                sigma_north_m=sigmas_m[1],
                sigma_up_m=sigmas_m[2],
                from_longest_m=None if k == 0 else math.hypot(west_m, north_m),
                from_longest_sigmas=None if k == 0 else departure_sigmas(arc.solution, study.longest),
                used=total.used,
                left_out=total.rejected,
                wrms_m=total.wrms_m,
                converged=arc.solution.converged,
            )
        )
    for k, reference in enumerate(study.references):
        place = reference.position.selenographic
        rows.append(_row("reference", reference.name, place, None if k == 0 else benchmark))
    return tuple(rows)


def departure_sigmas(part: Solution, whole: Solution) -> float | None:
    """How far a part of the data leads from the whole, horizontally, in standard deviations of that difference.

    Notes
    -----
    An estimate from all data is uncorrelated with what a part of them differs from it, if both are weighted rightly.
    The difference then has the covariance of the part less that of the whole (Hausman 1978, Econometrica 46, 1251).
    The length is Mahalanobis', in two dimensions below 2.45 in 95 % and below 3.72 in 99.9 %. None where the part is
    stated to know as much as the whole, or a position is not determined.
    """
    axes = part.rot_pa_to_enu[:2]
    difference_m = axes @ (part.position_pa_m - whole.position_pa_m)
    covariance_pa = part.position_covariance("pa", "scaled") - whole.position_covariance("pa", "scaled")
    if not np.isfinite(covariance_pa).all():
        return None
    covariance = axes @ covariance_pa @ axes.T
    try:
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    return float(np.linalg.norm(np.linalg.solve(root, difference_m)))


def _row(method: str, name: str, place: Place, benchmark: Place | None) -> PositionRow:
    differences = _NONE if benchmark is None else difference(place, benchmark)
    return PositionRow(method, name, -math.remainder(place[0], 360.0), place[1], place[2], *differences)


def table_dict(study: ArcStudy) -> dict[str, Any]:
    """All numbers of a study but the single residuals, in types that JSON has."""
    return {
        "name": study.name,
        "converged": study.converged,
        "benchmark": _benchmark_name(study),
        "frame": study.longest.me_frame,
        "sphere_radius_m": MEAN_LUNAR_RADIUS_M,
        "positions": [row.to_dict() for row in study.rows],
        "arcs": [
            {"hours": arc.hours, "span_h": arc.span_h, "solution": arc.solution.to_dict()}
            for arc in study.arcs
        ],
    }


def csv_text(study: ArcStudy) -> str:
    """The rows as comma-separated text, with the arcs' other parameters and their sigmas as further columns."""
    names = _other_parameters(study)
    solutions = {arc.name: arc.solution for arc in study.arcs}
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    fixed = list(study.rows[0].to_dict())
    writer.writerow([*fixed, *(column for name in names for column in (name, f"{name}.sigma"))])
    for row in study.rows:
        values = list(row.to_dict().values())
        for name in names:
            value = None if row.method == "reference" else _parameter(solutions[row.name], name)
            values += ["", ""] if value is None else [value[0], value[1]]
        writer.writerow(["" if v is None else repr(v) if isinstance(v, float) else v for v in values])
    return stream.getvalue()


def markdown_text(study: ArcStudy) -> str:
    """The table of positions in Markdown."""
    heading = ["Method", "", "L (°W)", "B (°N)", "δL (°W)", "δB (°N)", "δL (m)", "δB (m)"]
    lines = ["| " + " | ".join(heading) + " |", "| --- | --- |" + " ---: |" * 6]
    for row, cells in zip(study.rows, _position_cells(study), strict=True):
        name = f"{row.name} data" if row.method == "tracking" else row.name
        lines.append("| " + " | ".join([row.method, name.replace("|", r"\|"), *cells[1:]]) + " |")
    return "\n".join(lines) + "\n"


def card_fields(study: ArcStudy) -> tuple[CardField, ...]:
    """Collect what the card of a study says, in order."""
    longest = study.longest
    state = (
        "all arcs converged"
        if study.converged
        else "NOT CONVERGED: " + ", ".join(arc.name for arc in study.arcs if not arc.solution.converged)
    )
    tracked = list(zip(study.arcs, study.rows, strict=False))
    fields = [
        CardField("arc lengths", (study.name,)),
        CardField("status", (state,)),
        CardField(
            "axes",
            (
                f"{longest.me_frame}, fitted in {longest.pa_frame}; L to the west, B to the north; "
                f"d: less {_benchmark_name(study)}, on the sphere of {MEAN_LUNAR_RADIUS_M / 1e3:.1f} km",
            ),
        ),
        CardField(
            "positions",
            heading=("", "L, deg W", "B, deg N", "dL, deg", "dB, deg", "dL, m", "dB, m"),
            rows=tuple(_position_cells(study)),
        ),
        CardField(
            "1 sigma",
            heading=("", "L, m", "B, m", "h, m", "height, m", f"from {study.arcs[0].name}, m", "in sigmas"),
            rows=tuple(_sigma_cells(arc, row) for arc, row in tracked),
        ),
        CardField(
            "data",
            heading=("", "span, h", "used", "left out", "wrms, m", "chi2/dof"),
            rows=tuple(_data_cells(arc, row) for arc, row in tracked),
        ),
    ]
    fields += _parameter_fields(study)
    fields += [CardField("observable", tuple(lines))] if (lines := _observable(study)) else []
    fields += [CardField("notes", tuple(lines))] if (lines := _notes(study)) else []
    return tuple(fields)


def card_text(fields: tuple[CardField, ...]) -> str:
    """Fields as text, no line longer than 96 characters."""
    return render_text(fields, _WIDTH)


def _benchmark_name(study: ArcStudy) -> str:
    return study.references[0].name if study.references else f"the arc of {study.arcs[0].name}"


def _position_cells(study: ArcStudy) -> list[tuple[str, ...]]:
    out = []
    for row in study.rows:
        cells = [row.name, f"{row.longitude_west_deg:.5f}", f"{row.latitude_deg:.5f}"]
        if row.west_deg is None or row.north_deg is None:
            cells += [_BENCHMARK, "-", "-", "-"]
        else:
            cells += [
                f"{row.west_deg:.5f}",
                f"{row.north_deg:.5f}",
                f"{row.west_m:.1f}",
                f"{row.north_m:.1f}",
            ]
        out.append(tuple(cells))
    return out


def _fixed(value: float | None, decimals: int) -> str:
    """Text with so many decimals, and no sign before a zero."""
    return "-" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"


def _sigma_cells(arc: Predictor, row: PositionRow) -> tuple[str, ...]:
    sigmas = (row.sigma_west_m, row.sigma_north_m, row.sigma_up_m)
    held = not arc.solution.position_estimated
    return (
        arc.name,
        *("held" if held else metres(sigma) for sigma in sigmas),
        _fixed(row.height_m, 1),
        _fixed(row.from_longest_m, 1),
        _fixed(row.from_longest_sigmas, 1),
    )


def _data_cells(arc: Predictor, row: PositionRow) -> tuple[str, ...]:
    chi2 = arc.solution.fit.chi2_per_dof
    return (
        arc.name,
        f"{arc.span_h:.2f}",
        str(row.used),
        str(row.left_out),
        "-" if row.wrms_m is None else metres(row.wrms_m),
        "-" if chi2 is None else f"{chi2:.3g}",
    )


def _other_parameters(study: ArcStudy) -> list[str]:
    """Names of all parameters but the position's, each once, in the order of the longest arcs."""
    return list(
        dict.fromkeys(
            item.name
            for arc in study.arcs
            for item in arc.solution.parameters
            if item.kind != "position" and not item.fixed
        )
    )


def _parameter(solution: Solution, name: str) -> tuple[float, float] | None:
    """Value and scaled sigma of a parameter, none where the arc has no such parameter."""
    names = solution.parameters.names
    if name not in names:
        return None
    k = names.index(name)
    return float(solution.values[k]), float(solution.sigmas()[k])


def _parameter_fields(study: ArcStudy) -> list[CardField]:
    names = _other_parameters(study)
    units = {item.name: item.unit for arc in study.arcs for item in arc.solution.parameters}
    fields = []
    for start in range(0, min(len(names), _MAX_PARAMETERS), _PARAMETERS_IN_ROW):
        block = names[start : start + _PARAMETERS_IN_ROW]
        rows = []
        for arc in study.arcs:
            found = [_parameter(arc.solution, name) for name in block]
            rows.append((arc.name, *("-" if v is None else _with_sigma(*v) for v in found)))
        heading = ("1 sigma", *(f"{name}, {units[name]}" for name in block))
        fields.append(CardField("estimated" if start == 0 else "", (), heading, tuple(rows)))
    if len(names) > _MAX_PARAMETERS:
        fields.append(CardField("", (f"{len(names) - _MAX_PARAMETERS} more are not shown",)))
    return fields


def _with_sigma(value: float, sigma: float) -> str:
    return f"{to_sigma(value, sigma)} +- {sigma_text(sigma)}" if math.isfinite(sigma) else "undetermined"


def _observable(study: ArcStudy) -> list[str]:
    """What the data of each arc determine poorly."""
    lines = []
    for arc in study.arcs:
        sentences = arc.solution.observability.describe()
        lines += [f"{arc.name}: {sentences[0]}"] if sentences else []
    return [*lines, *which_sigmas(arc.solution for arc in study.arcs)]


def _notes(study: ArcStudy) -> list[str]:
    lines = [f"{arc.name}: {arc.solution.message}" for arc in study.arcs if arc.solution.message]
    for longer, shorter in zip(study.arcs, study.arcs[1:], strict=False):
        if len(longer.solution.residuals) == len(shorter.solution.residuals):
            lines.append(
                f"the arc of {longer.name} holds no more observations than that of {shorter.name}: the next after "
                f"{shorter.span_h:.2f} h are missing"
            )
    for row in study.rows:
        if row.from_longest_sigmas is not None and row.from_longest_sigmas > _UNLIKELY_SIGMAS:
            lines.append(
                f"{row.name} and {study.arcs[0].name} are {row.from_longest_m:.1f} m apart, "
                f"{row.from_longest_sigmas:.1f} of the sigmas that the difference should have (99.9 % are below "
                f"{_UNLIKELY_SIGMAS}): errors of the data are correlated or the model lacks something, and the sigmas "
                "are too small"
            )
    # What several arcs say alike is said once, of the longest; counts of observations differ from arc to arc.
    lines += [note for note in study.longest.notes if "not asked for" not in note]
    return lines
