"""Memory that arrays have left stays with the process.

To give it back and be given it again costs a page fault per page. That is a tenth of the time of a fit whose
derivatives are some megabytes large.
"""

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TRIM, MMAP = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of malloc.h
KEPT = 1 << 29  # bytes
LARGE = 1 << 28  # bytes: larger ones still go back


def keep_memory() -> None:
    """Ask the C library to keep memory; one that cannot is left as it is."""
    if sys.platform != "linux":
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # not glibc
        return
    mallopt(TRIM, KEPT)
    mallopt(MMAP, LARGE)


@contextmanager
def uncollected() -> Iterator[None]:
    """Cycles among objects are not looked for while this is open.

    Modules and figures are all cycles and live to the end. The search takes a tenth of the time of importing and
    drawing them.
    """
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
