"""Positions without each station and each link: what the position rests on, as a card."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radioloc.estimation.solution import Solution
from radioloc.measurements.link import Link
from radioloc.report.cards import Card, Field, Shown, metres, signed_metres, ways
from radioloc.report.covariance import radius_95_m
from radioloc.report.solution_card import which_sigmas
from radioloc.tables import TableForm, as_table

_UNLIKELY_SIGMAS = 4.03
"""Three coordinates of a right model stay below this in 99.9 %."""


@dataclass(frozen=True, slots=True)
class Without:
    """The position without a station or a link.

    Parameters
    ----------
    kind : {"station", "link"}
    name : str
        The station, or the path of the link.
    left_out : int
        Observations that go with it.
    used : int
        Observations that are used without it.
    converged : bool
        Whether the fit converges without it.
    radius_95_m : float or None
        95 % radius of the horizontal position, m; None where it is not determined without it.
    shift_enu_m : tuple of float or None
        The position without it less that with all, east, north, up, m; None where it is not determined.
    sigma_enu_m : tuple of float or None
        Standard deviation of that shift, m; None where it is not known.
    sigmas : float or None
        Length of the shift in standard deviations of it, over all components.
    """

    kind: str
    name: str
    left_out: int
    used: int
    converged: bool
    radius_95_m: float | None = None
    shift_enu_m: tuple[float, float, float] | None = None
    sigma_enu_m: tuple[float | None, ...] | None = None
    sigmas: float | None = None

    @property
    def shown(self) -> str:
        """Name on the card, such as ``KASHI two-way`` of a link."""
        if self.kind == "station":
            return self.name
        link = Link.from_path(self.name)
        return f"{link.place} {ways([link])[0]}".rstrip()


@dataclass(frozen=True, slots=True, eq=False)
class LeaveOneOut(Shown):
    """A solution, and the positions without each of its stations and links; ``str()`` is a card.

    Parameters
    ----------
    solution : Solution
        From all observations.
    without : tuple of Without
        Stations, then links.
    """

    solution: Solution
    without: tuple[Without, ...]

    @property
    def name(self) -> str:
        """The study's."""
        return self.solution.name

    @property
    def converged(self) -> bool:
        """Whether the fit to all observations did."""
        return self.solution.converged

    def columns(self) -> dict[str, NDArray[Any]]:
        """What is found without each, by name; NaN where it is not known."""
        rows = [asdict(one) for one in self.without]
        found = {key: np.array([row[key] for row in rows]) for key in ("kind", "name", "left_out", "used")}
        found["converged"] = np.array([int(one.converged) for one in self.without])
        numbers: dict[str, Any] = {"radius_95_m": [one.radius_95_m for one in self.without]}
        for key in ("shift", "sigma"):
            enu = np.array([row[f"{key}_enu_m"] or (None,) * 3 for row in rows]).reshape(-1, 3)
            numbers |= {f"{key}_{axis}_m": enu[:, k] for k, axis in enumerate(("east", "north", "up"))}
        numbers["sigmas"] = [one.sigmas for one in self.without]
        return found | {key: np.array(column, dtype=np.float64) for key, column in numbers.items()}

    def to_table(self, form: TableForm = "astropy") -> Any:
        """One row for each as a ``QTable`` of astropy, with units, or a ``DataFrame`` of pandas."""
        return as_table(self.columns(), form)

    def to_dict(self) -> dict[str, Any]:
        """All but single residuals, in types that JSON has."""
        return {"solution": self.solution.to_dict(), "without": [asdict(one) for one in self.without]}

    def card(self) -> Card:
        """By how much the position moves without each."""
        heading = ("without", "used", "east, m", "north, m", "up, m", "sigmas", "95 %, m")
        radius_m = radius_95_m(self.solution.position_covariance()[:2, :2])
        return Card(
            [
                Field("left out", [f"each station and link of {self.solution.name} in turn"]),
                Field(
                    "all",
                    [f"{self.solution.fit.total.used} observations used; 95 % within {metres(radius_m)} m"],
                ),
                Field("shift", (), heading, map(_cells, self.without)),
                Field("notes", self._notes()),
            ]
        )

    def _notes(self) -> Iterator[str]:
        for one in self.without:
            if one.shift_enu_m is None:
                yield f"without {one.shown} the position is not determined"
            elif not one.converged:
                yield f"without {one.shown} the fit does not converge"
            elif one.sigmas is not None and one.sigmas > _UNLIKELY_SIGMAS:
                yield (
                    f"without {one.shown} the position moves by {math.hypot(*one.shift_enu_m):.3g} m, {one.sigmas:.1f} "
                    f"sigmas of that shift (99.9 % are below {_UNLIKELY_SIGMAS}): it does not fit the others, or the "
                    "sigmas are too small"
                )
        yield from which_sigmas([self.solution])


def _cells(one: Without) -> tuple[str, ...]:
    if one.shift_enu_m is None:
        return (one.shown, str(one.used), *("-" * 5))
    sigmas = "-" if one.sigmas is None else f"{one.sigmas:.1f}"
    return (one.shown, str(one.used), *map(signed_metres, one.shift_enu_m), sigmas, metres(one.radius_95_m))
