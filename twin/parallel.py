"""Long work: one function over many items in forked processes that inherit what it needs, and how far it has come."""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from twin.stopping import as_worker

T = TypeVar("T")

Progress = Callable[[str, int], Callable[[int], None]]
"""Called with a description and a total; returns the function that advances."""


def silent(description: str, total: int) -> Callable[[int], None]:
    """Progress that nobody is shown."""
    return lambda count: None


MOST = 4  # processes: every one takes memory of its own


def cores() -> int:
    """How many processes serve: the cores this process may run on, at most ``MOST``; 1 where processes do not fork."""
    return min(len(os.sched_getaffinity(0)), MOST) if sys.platform == "linux" else 1


def spread(function: Callable[[int], T], count: int, processes: int) -> Iterator[T]:
    """``function(0)``, ``function(1)`` … in order, each computed in one of some processes: the same as by one.

    Results are pickled; ``function`` and what it closes over are not. A process that has lost its parent ends.
    """
    processes = min(processes, count)
    if processes < 2:
        yield from map(function, range(count))
        return
    context = get_context("fork")
    readers: list[Connection] = []
    workers = []
    try:
        for first in range(processes):
            reader, writer = context.Pipe(duplex=False)
            readers.append(reader)
            shares = range(first, count, processes)
            workers.append(context.Process(target=_work, args=(function, shares, writer, readers), daemon=True))
            workers[-1].start()
            writer.close()
        for number in range(count):
            result, error = readers[number % processes].recv()
            if error is not None:
                raise error
            yield result
    finally:
        for reader in readers:
            reader.close()
        for worker in workers:
            worker.terminate()
            worker.join()


def isolated(function: Callable[[], T]) -> T:
    """What a function returns, run in a forked process where there are such: some input ends the library that reads it.

    Raises:
        EOFError: the process ended before the function did.
    """
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return function()
    context = get_context("fork")
    reader, writer = context.Pipe(duplex=False)
    child = context.Process(target=_send, args=(function, writer), daemon=True)
    child.start()
    writer.close()
    try:
        result, error = reader.recv()
    finally:
        child.kill()
        child.join()
        reader.close()
    if error is not None:
        raise error
    found: T = result
    return found


def _send(function: Callable[[], Any], writer: Connection) -> None:
    as_worker()
    result, error = None, None
    try:
        result = function()
    except Exception as raised:
        error = raised
    writer.send((result, error))


def _work(function: Callable[[int], Any], shares: range, writer: Connection, readers: list[Connection]) -> None:
    as_worker()
    for reader in readers:  # inherited: nobody but the parent may hold them, or its end would not be seen
        reader.close()
    for number in shares:
        result, error = None, None
        try:
            result = function(number)
        except Exception as raised:
            error = raised
        try:
            writer.send((result, error))
        except BrokenPipeError:
            return
        if error is not None:
            return
