"""Long work: one function over many items in forked processes that inherit what it needs, and how far it has come."""

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
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
    process does what it spreads itself. Cores that have nothing left to do serve those that have, in
    :func:`side_by_side`.
    """
    if min(processes, count) < 2 or current_process().daemon:
        yield from map(function, range(count))
        return
    with one_thread_each():
        yield from _spread(function, count, processes)


def side_by_side(function: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """``function`` of every item in order, by as many threads as there are cores: for long products of arrays.

    No more results than threads are held. A process of :func:`spread` has one core, and those that others left.
    """
    with _threads() as threads:
        if threads < 2:
            yield from map(function, items)
            return
        with one_thread_each(), ThreadPoolExecutor(threads) as pool:
            waiting: deque[Future[T]] = deque()
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) >= threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()


_left: tuple[int, int] | None = None
"""In a process of :func:`spread` both ends of a pipe: one byte for every core that has nothing left to do."""


@contextmanager
def _threads() -> Iterator[int]:
    """How many threads serve here: the own core, and those that nobody uses, until the end."""
    if not current_process().daemon:
        yield cores()
        return
    if _left is None:
        yield 1
        return
    taken = b""
    with suppress(BlockingIOError):
        taken = os.read(_left[0], PROCESSES)
    try:
        yield 1 + len(taken)
    finally:
        os.write(_left[1], taken)


def _spread(function: Callable[[int], T], count: int, most: int) -> Iterator[T]:
    context = get_context("fork")
    each, processes = 1 + count // TOKENS, min(most, count)
    tokens, source = os.pipe()  # of every one the first of so many numbers; whoever is free reads the next
    os.write(source, b"".join(number.to_bytes(4, "little") for number in range(0, count, each)))
    left = os.pipe()
    os.set_blocking(left[0], False)
    os.write(left[1], bytes(most - processes))
    readers: list[Connection] = []
    workers = []
    done: dict[int, tuple[T | None, Exception | None]] = {}
    try:
        for _ in range(processes):
            reader, writer = context.Pipe(duplex=False)
            readers.append(reader)
            ends = tokens, source, left, writer, readers
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
        for end in (tokens, source, *left):
            if end >= 0:
                os.close(end)
        for reader in readers:
            reader.close()
        for worker in workers:
            worker.terminate()
            worker.join()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """BLAS of one thread here and in what is forked: on a busy machine its threads wait for each other."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries() -> "ThreadpoolController":
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def ahead(function: Callable[[], T], processes: int) -> Iterator[Callable[[], T]]:
    """Inside, what returns the function's result: a process of its own computes it meanwhile, where several serve.

    Raises:
        EOFError: the process ended before the function did.
    """
    if processes < 2 or current_process().daemon:
        yield cache(function)
        return
    context = get_context("fork")
    reader, writer = context.Pipe(duplex=False)
    child = context.Process(target=_send, args=(function, writer), daemon=True)
    with one_thread_each(), forking():
        child.start()
    writer.close()

    @cache
    def result() -> T:
        found, error = reader.recv()
        if error is not None:
            raise error
        return found

    try:
        yield result
    finally:
        child.kill()
        child.join()
        reader.close()


def isolated(function: Callable[[], T]) -> T:
    """What a function returns, run in a forked process where there are such: some input ends the library that reads it.

    Raises:
        EOFError: the process ended before the function did.
    """
    alone = sys.platform != "linux" or threading.current_thread() is not threading.main_thread()
    with ahead(function, 1 if alone else 2) as result:
        return result()


def _send(function: Callable[[], Any], writer: Connection) -> None:
    as_worker()
    result, error = None, None
    try:
        result = function()
    except Exception as raised:
        error = raised
    writer.send((result, error))


def _work(
    function: Callable[[int], Any], each: int, count: int, tokens: int, source: int, left: tuple[int, int],
    writer: Connection, readers: list[Connection],
) -> None:  # fmt: skip
    global _left
    as_worker()
    _left = left
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
    os.write(left[1], b"\0")
