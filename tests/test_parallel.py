"""Work spread over processes is the work of one: same results in the same order, errors raised, no process left."""

import os
import sys
import time
from multiprocessing import active_children

import pytest

from twin.errors import InputError
from twin.parallel import cores, spread

forking = pytest.mark.skipif(sys.platform != "linux", reason="processes fork on Linux only")


@forking
@pytest.mark.parametrize("processes", [1, 2, 3, 9])
def test_results_come_in_order(processes: int) -> None:
    def square(number: int) -> int:
        time.sleep(0.002 * (7 - number))
        return number**2

    assert list(spread(square, 7, processes)) == [n**2 for n in range(7)]
    assert not active_children()


@forking
def test_the_work_is_done_elsewhere() -> None:
    assert os.getpid() not in list(spread(lambda number: os.getpid(), 4, 2))


@forking
def test_an_error_is_raised_here_and_ends_the_others() -> None:
    def fail(number: int) -> int:
        if number == 1:
            raise InputError("robot.yaml", "axes", "a number")
        time.sleep(30 * (number > 1))
        return number

    start = time.monotonic()
    with pytest.raises(InputError, match="a number"):
        list(spread(fail, 4, 2))
    assert time.monotonic() - start < 10
    assert not active_children()


def test_cores_are_those_this_process_may_use() -> None:
    if sys.platform == "linux":
        allowed = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(allowed)})
        try:
            assert cores() == 1
        finally:
            os.sched_setaffinity(0, allowed)
    assert cores() >= 1
