"""Long work: one function over many items in forked processes that inherit what it needs, and how far it has come."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from multiprocessing import current_process, get_context
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, TypeVar

from twin.stopping import as_worker, forking

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

S = TypeVar("S")
T = TypeVar("T")

Progress = Callable[[str, int], Callable[[int], None]]
"""Called with a description and a total; returns the function that advances."""


def silent(description: str, total: int) -> Callable[[int], None]:
    """Progress that nobody is shown."""
    return lambda count: None


PROCESSES = 4  # every one takes memory of its own
TOKENS = 8192  # of four bytes: half of what a pipe holds


def cores() -> int:
    """How many processes serve: the cores this process may run on, at most ``PROCESSES``; 1 where none forks."""
    return min(len(os.sched_getaffinity(0)), PROCESSES) if sys.platform == "linux" else 1


def spread(function: Callable[[int], T], count: int, processes: int) -> Iterator[T]:
    """``function(0)``, ``function(1)`` … in order, each computed by whichever process is free: the same as by one.

    Results are pickled; ``function`` and what it closes over are not. A process that has lost its parent ends. Such a
    process does what it spreads itself.
    """
    processes = min(processes, count)
    if processes < 2 or current_process().daemon:
        yield from map(function, range(count))
        return
    with _one_thread_each():
        yield from _spread(function, count, processes)


def side_by_side(function: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """``function`` of every item in order, by as many threads as there are cores: for long products of arrays.

    No more results than threads are held. A process of :func:`spread` has one core, and one thread.
    """
    threads = 1 if current_process().daemon else cores()
    if threads < 2:
        yield from map(function, items)
        return
    with _one_thread_each(), ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[T]] = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) >= threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _spread(function: Callable[[int], T], count: int, processes: int) -> Iterator[T]:
    context = get_context("fork")
    each = 1 + count // TOKENS
    tokens, source = os.pipe()  # of every one the first of so many numbers; whoever is free reads the next
    os.write(source, b"".join(number.to_bytes(4, "little") for number in range(0, count, each)))
    readers: list[Connection] = []
    workers = []
    done: dict[int, tuple[T | None, Exception | None]] = {}
    try:
        for _ in range(processes):
            reader, writer = context.Pipe(duplex=False)
            readers.append(reader)
            ends = tokens, source, writer, readers
            workers.append(context.Process(target=_work, args=(function, each, count, *ends), daemon=True))
            with forking():
                workers[-1].start()
            writer.close()
        os.close(source)
        source = -1
        working = list(readers)
        for number in range(count):
            while number not in done:
                if not working:
                    raise EOFError("a process ended before its work did")
                ready = wait(working)
                for reader in [one for one in working if one in ready]:
                    try:
                        which, result, error = reader.recv()
                        done[which] = result, error
                    except EOFError:
                        working.remove(reader)
            result, error = done.pop(number)
            if error is not None:
                raise error
            yield result  # type: ignore[misc]
    finally:
        for end in (tokens, source):
            if end >= 0:
                os.close(end)
        for reader in readers:
            reader.close()
        for worker in workers:
            worker.terminate()
            worker.join()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """BLAS of one thread here and in what is forked: on a busy machine its threads wait for each other."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries() -> "ThreadpoolController":
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


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
    with forking():
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


def _work(
    function: Callable[[int], Any], each: int, count: int, tokens: int, source: int, writer: Connection,
    readers: list[Connection],
) -> None:  # fmt: skip
    as_worker()
    os.close(source)
    for reader in readers:  # inherited: nobody but the parent may hold them, or its end would not be seen
        reader.close()
    while token := os.read(tokens, 4):
        first = int.from_bytes(token, "little")
        for number in range(first, min(first + each, count)):
            result, error = None, None
            try:
                result = function(number)
            except Exception as raised:
                error = raised
            try:
                writer.send((number, result, error))
            except BrokenPipeError:
                return
            if error is not None:
                return
