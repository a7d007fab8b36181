"""How far long work has come, on standard error: bars in a terminal or notebook, else a line now and then."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from twin.parallel import Progress

if TYPE_CHECKING:
    from rich.console import Console

EVERY_S = 60.0  # between lines in a file or a pipe


@contextlib.contextmanager
def progress() -> Iterator[Progress]:
    """Bars for whatever is called in the block: ``with twin.progress() as bars: twin.fit("frf.h5", progress=bars)``.

    They are gone when the work is done. Where standard error is no terminal, a line tells every ``EVERY_S`` what is
    done.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal or console.is_jupyter:
        with _bars(console) as shown:
            yield shown
    else:
        yield _lines()


@contextlib.contextmanager
def _bars(console: "Console") -> Iterator[Progress]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    bars = Progress(*columns, console=console, transient=True)

    def start(description: str, total: int) -> Callable[[int], None]:
        if total < 1:
            return lambda count: None
        bars.start()
        task = bars.add_task(description, total=total)
        return lambda count: bars.advance(task, count)

    try:
        yield start
    finally:
        if bars.tasks:
            bars.stop()


def _lines() -> Progress:
    """A line such as ``twin: screen 12 of 51 after 60 s``, at most every ``EVERY_S``, the first after that long."""
    began = last = time.monotonic()

    def start(description: str, total: int) -> Callable[[int], None]:
        done = 0

        def advance(count: int) -> None:
            nonlocal done, last
            done += count
            now = time.monotonic()
            if now - last >= EVERY_S:
                last = now
                print(f"twin: {description} {done} of {total} after {now - began:.0f} s", file=sys.stderr, flush=True)

        return advance

    return start
