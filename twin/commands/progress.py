"""Progress bars on standard error (in a notebook: below the cell), gone when the work is done."""

import contextlib
from collections.abc import Callable, Iterator

from twin.parallel import Progress


@contextlib.contextmanager
def progress() -> Iterator[Progress]:
    """Bars for whatever is called in the block: ``with twin.progress() as bars: twin.fit("frf.h5", progress=bars)``."""
    from rich.console import Console
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
    console = Console(stderr=True)
    seen = console.is_terminal or console.is_jupyter  # a file gets no bars, and no empty line at their end
    bars = Progress(*columns, console=console, transient=True, disable=not seen)

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
