"""Work spread over processes is the work of one: same results in the same order, errors raised, no process left."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path

import numpy as np  # noqa: F401 – its BLAS is what is asked
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from twin.errors import InputError
from twin.parallel import ahead, cores, side_by_side, spread

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
def test_more_numbers_than_a_pipe_holds_come_in_order() -> None:
    assert list(spread(lambda number: number, 20001, 2)) == list(range(20001))


@forking
def test_a_process_that_is_killed_ends_the_work_in_an_error() -> None:
    def die(number: int) -> int:
        if number == 1:
            os._exit(1)
        return number

    with pytest.raises(EOFError, match="a process ended"):
        list(spread(die, 6, 2))
    assert not active_children()


@forking
def test_the_work_is_done_elsewhere() -> None:
    assert os.getpid() not in list(spread(lambda number: os.getpid(), 4, 2))


@forking
def test_processes_do_not_multiply_by_threads_of_blas() -> None:
    """A diagnosis from Python took three times as long in two processes of two threads as in one process."""

    def threads(number: int) -> int:
        return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")

    with threadpool_limits(2, user_api="blas"):
        assert threads(0) == 2
        assert list(spread(threads, 3, 2)) == [1, 1, 1]
        assert threads(0) == 2


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


@forking
def test_a_process_that_is_ended_before_it_works_ends_nobody_else(tmp_path: Path) -> None:
    """It has the parent's handlers until it has its own, and they write to the parent's pipe."""
    script = tmp_path / "slow_to_start.py"
    script.write_text(
        "import time, multiprocessing, twin.parallel as parallel, twin.stopping as stopping\n"
        "def late():\n"
        "    time.sleep(0.3 * multiprocessing.current_process().name.endswith('2'))\n"
        "    stopping.as_worker()\n"
        "parallel.as_worker = late\n"
        "with stopping.stoppable():\n"
        "    assert list(parallel.spread(abs, 2, 2)) == [0, 1]\n"
        "    time.sleep(1.2 * stopping.GRACE_S)\n"
    )
    found = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")


def test_threads_give_results_in_order_and_hold_no_more_than_they_are() -> None:
    taken = []

    def items() -> Iterator[int]:
        for number in range(9):
            taken.append(number)
            yield number

    def square(number: int) -> int:
        time.sleep(0.002 * (9 - number))
        return number**2

    for k, found in enumerate(side_by_side(square, items())):
        assert found == k**2
        assert len(taken) <= k + max(cores(), 1)


def test_an_error_in_a_thread_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        list(side_by_side(lambda number: 1 // number, [1, 0, 2]))


@forking
def test_a_core_with_nothing_left_to_do_serves_the_other() -> None:
    """Two threads meet in a process whose neighbour is done: one thread alone would wait for ever."""

    def threads(number: int) -> int:
        if number == 0:
            return 1
        time.sleep(0.5)
        both = threading.Barrier(2, timeout=10)

        def meet(_: int) -> int:
            both.wait()
            return threading.get_ident()

        return len(set(side_by_side(meet, range(2))))

    assert list(spread(threads, 2, 2)) == [1, 2]


@forking
def test_what_is_computed_ahead_is_the_same_and_ends_with_its_block() -> None:
    with ahead(os.getpid, 2) as elsewhere, ahead(os.getpid, 1) as here:
        assert elsewhere() == elsewhere() != os.getpid() == here()
    with ahead(lambda: 1 // 0, 2) as broken, pytest.raises(ZeroDivisionError):
        broken()
    with ahead(lambda: time.sleep(60), 2):
        pass
    assert not active_children()
