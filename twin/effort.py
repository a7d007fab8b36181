"""How long a command takes on a large recording, by the recording's size: told before the work begins."""

from collections.abc import Iterable
from pathlib import Path

from twin.ranges import MOST_VALUES, SEARCHED

TELL_S = 60.0  # less is not worth a line
SECONDS = {  # per sample and axis, or per line and channel, on one core: `python -m tools.large`
    ("compare", "motion-log"): 2.6e-6,
    ("identify", "motion-log"): 2.8e-6,
    ("compare", "frf-campaign"): 1.3e-5,  # angles and gains of every posture estimated again
    ("compare --as-is", "frf-campaign"): 2.0e-6,
    ("diagnose", "motion-log"): 1e-5,  # two processes
    ("fit", "frf-campaign"): 3.6e-4,  # of 12 postures, one start, a model that lacks something
    ("diagnose", "frf-campaign"): 3.4e-4,  # of 8 postures
}
AXES = 6  # of the robot that these hammer tests were of
POWER = {"fit": 1, "diagnose": 2}
"""The power of the number of axes that the time of FRFs grows with: so many numbers have slopes, and a diagnosis tries
so many effects, too. Of `make demo`'s three axes, a fit takes half and a diagnosis a fifth."""
MANY = {  # of more than SEARCHED values: how many take so long, and seconds per value of the others; of 200 postures
    ("fit", "frf-campaign"): (0, 1.05e-4),  # one start, a model that lacks something
    ("diagnose", "frf-campaign"): (SEARCHED, 7e-5),
}


def expected_s(command: str, recordings: Iterable[str | Path]) -> float:
    """Seconds a command, or it with an option, is expected to take on recordings.

    What cannot be read counts nothing: it is refused later.
    """
    return sum(of_size_s(command, *_size(path)) for path in recordings)


def of_size_s(command: str, kind: str, values: int, axes: int) -> float:
    """The same of one recording: its kind, how many values it holds, and of FRFs the axes of the robot (0: unknown)."""
    plain = command.partition(" ")[0]
    work = (command, kind) if (command, kind) in SECONDS else (plain, kind)
    first, other = MANY.get(work, (values, 0.0)) if values > SEARCHED else (values, 0.0)
    known = SECONDS.get(work, 0.0) * first + other * (values - first)
    return known * (axes / AXES) ** POWER.get(plain, 0) if axes else known


def told(seconds: float) -> str:
    """``about 2 minutes``, or nothing where the wait is short."""
    if seconds < TELL_S:
        return ""
    minutes = seconds / 60
    if minutes < 1.5:
        return "about a minute"
    return f"about {minutes:.0f} minutes" if minutes < 90 else f"about {minutes / 60:.0f} hours"


def _size(path: str | Path) -> tuple[str, int, int]:
    """Kind of a recording, how many values it holds, and of FRFs the axes of the robot (0: not known)."""
    import h5py  # --version and --help need none
    import numpy as np

    from twin.measure.hdf5 import opened

    try:
        with opened(Path(path)) as file:
            kind = str(file.attrs.get("format", ""))
            group, name = ("runs", "position") if kind == "motion-log" else ("postures", "frf")
            sets = [part[name] for part in file.get(group, {}).values() if name in part]
            sizes = [int(item.size) for item in sets if isinstance(item, h5py.Dataset) and item.shape]
            axes = max((np.size(part.attrs.get("q_deg", ())) for part in file.get("postures", {}).values()), default=0)
            return kind, sum(size for size in sizes if size <= MOST_VALUES), int(axes)  # others are refused
    except (OSError, AttributeError, TypeError, KeyError, ValueError, RuntimeError):
        return "", 0, 0
