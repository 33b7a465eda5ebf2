"""Selection of quick test cases, and fits and reports without slow parts that other tests cover."""

from contextlib import contextmanager

import pytest


@contextmanager
def undrawn():
    """Write figures as empty files; drawing one takes 0.3 s."""

    def save(figure, paths):
        for path in paths:
            path.write_text("not drawn")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("radioloc.report.files.save_figure", save)
        yield


@contextmanager
def unsearched():
    """Fit without consistency tests, half of the time of a fit of laser ranges."""
    from radioloc.estimation.consistency_results import Consistency

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("radioloc.results.build.assess_consistency", lambda *_: Consistency())
        yield


def some(cases, quick):
    """Return cases as parameters, marked as slow unless they are quick."""
    quick = list(quick)
    return [pytest.param(*_values(case), marks=() if case in quick else pytest.mark.slow) for case in cases]


def each_with_one(cases, quick, options):
    """Return all pairs of cases and options; each quick case has one of the options, in turn."""
    options = list(options)
    return some(
        [(case, option) for case in cases for option in options],
        [(case, options[k % len(options)]) for k, case in enumerate(quick)],
    )


def _values(case):
    return case if isinstance(case, tuple) else (case,)
