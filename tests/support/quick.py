"""What makes tests quick: which of many cases are run each time, and what is left out that others prove."""

from contextlib import contextmanager

import pytest


@contextmanager
def undrawn():
    """Files of figures without a picture, for tests of what else is written: a picture takes 0.3 s."""

    def save(figure, paths):
        for path in paths:
            path.write_text("not drawn")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("radioloc.report.files.save_figure", save)
        yield


@contextmanager
def unsearched():
    """Fits without the search for what does not fit, half of the time of one of laser ranges."""
    from radioloc.estimation.consistency import Consistency

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("radioloc.results.build.assess_consistency", lambda *_: Consistency())
        yield


def some(cases, quick):
    """Cases as parameters, those that are not among the quick ones marked as slow."""
    quick = list(quick)
    return [pytest.param(*_values(case), marks=() if case in quick else pytest.mark.slow) for case in cases]


def each_with_one(cases, quick, others):
    """Pairs of all cases with all others; of the quick ones each with one of the others, in turn."""
    others = list(others)
    return some(
        [(case, other) for case in cases for other in others],
        [(case, others[k % len(others)]) for k, case in enumerate(quick)],
    )


def _values(case):
    return case if isinstance(case, tuple) else (case,)
