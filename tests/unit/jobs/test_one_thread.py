import pytest
import scipy.linalg  # noqa: F401  # whose library is then there from the beginning
from threadpoolctl import threadpool_info

from radioloc.jobs.one_thread import on_one_blas_thread


def threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@on_one_blas_thread()
def threads_within(fail):
    if fail:
        raise ValueError("the reason")
    return threads()


def test_one_thread_within_and_as_many_as_before_after_it():
    earlier = threads()
    assert earlier, "numpy has no BLAS that is known here"
    assert threads_within(False) == [1] * len(earlier)
    assert threads() == earlier
    with pytest.raises(ValueError, match="the reason"):
        threads_within(True)
    assert threads() == earlier
