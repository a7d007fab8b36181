"""How a command ends before its time: ``--timeout``, Ctrl-C or a request to terminate. One line, within a second.

The signal raises :class:`Stopped`, so that files half-written are taken away on the way out. Where long work outside
Python holds that up, a thread takes them away and ends the process.
"""

import hashlib
import os
import shutil
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path
from types import FrameType

GRACE_S = 0.7  # in which the work may unwind
TIMED_OUT = 124  # exit code, as of timeout(1)
ASKED = () if sys.platform == "win32" else (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)  # the signals to stop

unfinished: set[Path] = set()
"""Files and folders that are being written aside: nothing of them may stay."""


_held: dict[str, socket.socket] | None = None  # by name, while a command runs


def hold(name: str) -> bool:
    """Whether this command alone uses a name, from now until it ends; always true outside commands and off Linux.

    An abstract socket is held: nothing of it is on the disk, and it goes with the process, however that ends.
    """
    if _held is None or name in _held or sys.platform != "linux":
        return True
    one = socket.socket(socket.AF_UNIX)
    try:
        one.bind(f"\0twin-{os.getuid()}-{hashlib.sha256(os.fsencode(name)).hexdigest()}")
    except OSError:
        one.close()
        return False
    _held[name] = one
    return True


def holds(name: str) -> bool:
    """Whether this command holds a name, so that no other can."""
    return _held is not None and name in _held


class Stopped(BaseException):
    """The command was asked to end; ``code`` is the exit code that says so."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(_line(code))


def _line(code: int) -> str:
    why = "--timeout: the time is up" if code == TIMED_OUT else "stopped on request"
    return f"{why}: nothing was written"


def _code(number: int) -> int:
    return TIMED_OUT if number == signal.SIGALRM else 128 + number


def _stop(number: int, frame: FrameType | None) -> None:
    for each in ASKED:  # a second one would end the clearing away
        signal.signal(each, signal.SIG_IGN)
    raise Stopped(_code(number))


@contextmanager
def stoppable() -> Iterator[None]:
    """Inside, the signals to stop raise :class:`Stopped`; only the main thread can. Names are held until the end."""
    global _held
    if sys.platform == "win32" or threading.current_thread() is not threading.main_thread():
        yield
        return
    _held = {}
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = {number: signal.signal(number, _stop) for number in ASKED}
    hook, sys.unraisablehook = sys.unraisablehook, _unless_stopped
    woken = signal.set_wakeup_fd(writer)
    done = threading.Event()
    threading.Thread(target=_watch, args=(reader, done), daemon=True).start()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.set_wakeup_fd(woken)
        done.set()
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(writer)
        for one in _held.values():
            one.close()
        _held = None


def _unless_stopped(raised: "sys.UnraisableHookArgs") -> None:
    """Where an object was being deleted Python drops what the signal raised and prints it: the thread ends it then."""
    if not isinstance(raised.exc_value, Stopped):
        sys.__unraisablehook__(raised)


def _watch(reader: int, done: threading.Event) -> None:
    """Wait for a signal (or the end of the work), and end the process where the work does not."""
    first = os.read(reader, 1)
    if not first or done.wait(GRACE_S):
        os.close(reader)  # not before: Python complains of a second signal that nobody can read
        return
    for child in active_children():
        child.kill()
    for path in list(unfinished):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    code = _code(first[0])
    os.write(2, f"twin: {_line(code)}\n".encode())
    os._exit(code)


def end_after(seconds: float | None) -> None:
    """Raise the alarm in so many seconds; None for never."""
    if seconds is not None and sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, seconds)


@contextmanager
def forking() -> Iterator[None]:
    """While processes are forked, signals wait: here until the end, there until :func:`as_worker`.

    A process that is forked has the parent's handlers and writes to the parent's pipe. A signal to it would end both.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKED)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def as_worker() -> None:
    """In a process forked inside :func:`forking`: leave Ctrl-C to the parent, and end at once when that says so."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKED)
