"""The card of a Monte Carlo study: one list of fields, for a terminal and for a notebook."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from radioloc.estimation.cards import CardField, metres, render_text
from radioloc.studies.trials_summary import ArcSummary, Nees

if TYPE_CHECKING:
    from radioloc.studies.monte_carlo import MonteCarlo

_WIDTH = 96
_MAX_PARAMETERS = 8
_PLACES = ("east", "north", "up", "horizontal")


def card_fields(study: MonteCarlo) -> tuple[CardField, ...]:
    """Collect what the card of a study says, in order."""
    arcs = [arc for arc in study.arcs if arc is not None]
    fields = [
        CardField("monte carlo", (study.name,)),
        CardField("status", tuple(_status(study))),
        CardField("drawn", (", ".join(["noise", *study.drawn]) + f"; seed {study.seed}",)),
    ]
    if not arcs:
        return tuple(fields)
    sides = ("east", "north", "up")
    fields += [
        CardField(
            "error, m",
            heading=("", *(f"mean {s}" for s in sides), *(f"rms {s}" for s in sides), "68 %", "95 %"),
            rows=tuple(
                (
                    _name(arc),
                    *(_signed(v) for v in arc.mean_m),
                    *(metres(v) for v in arc.rms_m),
                    metres(arc.radius_68_m),
                    metres(arc.radius_95_m),
                )
                for arc in arcs
            ),
        ),
        CardField(
            "1 sigma, m",
            heading=("claimed", *sides, "rms / sigma", *sides[1:], "95 % from longest"),
            rows=tuple(
                (
                    _name(arc),
                    *(metres(v) for v in arc.sigma_m),
                    *(f"{r / s:.2f}" for r, s in zip(arc.rms_m, arc.sigma_m, strict=True)),
                    "-" if arc.from_longest_95_m is None else metres(arc.from_longest_95_m),
                )
                for arc in arcs
            ),
        ),
        CardField(
            "inside 95 %",
            heading=("", *_PLACES, "expected"),
            rows=tuple(
                (
                    _name(arc),
                    *(f"{100.0 * arc.inside[place].fraction:.1f} %" for place in _PLACES),
                    f"{100.0 * arc.inside['east'].low:.1f} to {100.0 * arc.inside['east'].high:.1f} %",
                )
                for arc in arcs
            ),
        ),
        CardField(
            "nees",
            heading=("", "in space", "expected", "horizontal", "expected"),
            rows=tuple((_name(arc), *_nees(arc.nees), *_nees(arc.nees_horizontal)) for arc in arcs),
        ),
        CardField(
            "data",
            heading=("", "span, h", "used", "left out", "at most"),
            rows=tuple(
                (
                    _name(arc),
                    f"{arc.span_h:.2f}",
                    f"{arc.used:.1f}",
                    f"{arc.rejected:.1f}",
                    str(arc.rejected_most),
                )
                for arc in arcs
            ),
        ),
    ]
    names = list(dict.fromkeys(p.name for arc in arcs for p in arc.parameters))
    for k, name in enumerate(names[:_MAX_PARAMETERS]):
        rows = [
            (
                _name(arc),
                f"{p.mean:.4g}",
                f"{p.std:.3g}",
                "-" if p.rms_error is None else f"{p.rms_error:.3g}",
                f"{p.sigma:.3g}",
            )
            for arc in arcs
            for p in arc.parameters
            if p.name == name
        ]
        heading = (name, "mean", "scatter", "rms error", "1 sigma claimed")
        fields.append(CardField("estimated" if k == 0 else "", heading=heading, rows=tuple(rows)))
    if len(names) > _MAX_PARAMETERS:
        fields.append(CardField("", (f"{len(names) - _MAX_PARAMETERS} more are not shown",)))
    notes = [note for arc in arcs for note in _notes(arc)]
    fields += [CardField("notes", tuple(notes))] if notes else []
    return tuple(fields)


def card_text(fields: tuple[CardField, ...]) -> str:
    """Fields as text, no line longer than 96 characters."""
    return render_text(fields, _WIDTH)


def _status(study: MonteCarlo) -> list[str]:
    count = len(study.hours)
    arcs = f"{study.trials} trials, {count} arc{'' if count == 1 else 's'}: "
    lost = int((study["converged"] != 1.0).any(axis=1).sum())
    lines = [arcs + ("all converged" if not lost else f"NOT CONVERGED in {lost} of the trials")]
    proof = study.proof
    if study.linear and proof is not None:
        lines.append(
            f"linear model, proved by {len(proof.trials)} full fits: positions and sigmas agree to "
            f"{metres(proof.largest_m)} m and {100.0 * proof.largest_sigmas:.2g} % of sigma"
        )
    elif proof is not None:
        lines.append(
            f"every trial fitted in full: the linear model is off by up to {metres(proof.largest_m)} m, "
            f"{100.0 * proof.largest_sigmas:.2g} % of sigma"
        )
    else:
        lines.append("every trial fitted in full")
    return lines


def _name(arc: ArcSummary) -> str:
    return f"{arc.hours:g} h"


def _signed(value_m: float) -> str:
    text = metres(abs(value_m))
    return f"-{text}" if value_m < 0.0 and float(text) else text


def _nees(nees: Nees) -> tuple[str, str]:
    return f"{nees.mean:.3g}", f"{nees.low:.3f} to {nees.high:.3f}"


def _notes(arc: ArcSummary) -> list[str]:
    inside, nees = arc.inside["horizontal"], arc.nees
    percent = f"{100.0 * inside.fraction:.1f} %"
    if nees.mean > nees.high and inside.fraction < inside.low:
        return [
            f"{_name(arc)}: the claimed ellipse of 95 % holds the truth in {percent}; the sigmas are too small by a "
            f"factor of about {math.sqrt(nees.mean):.2g}: something departs, or lasts, that the fit does not know of"
        ]
    if nees.mean < nees.low and inside.fraction > inside.high:
        return [
            f"{_name(arc)}: the claimed ellipse of 95 % holds the truth in {percent}; the sigmas are too large"
        ]
    return []
