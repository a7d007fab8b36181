"""Work on several recordings side by side: numpy lets other threads run while it is inside a large array."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def cores() -> int:
    """How many this process may use; fewer where ``OMP_NUM_THREADS`` says so, as for other numerical libraries."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(available, int(asked)) if asked.isdecimal() and int(asked) else available


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """``work`` done on every item, in their order; threads take them where there are cores for it."""
    items = list(items)
    if len(items) < 2 or cores() < 2:
        return [work(item) for item in items]
    return list(_pool(os.getpid(), cores()).map(work, items))


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """One pool a process: a forked one has none of its parent's threads."""
    return ThreadPoolExecutor(threads, thread_name_prefix=f"twin-{process}")
