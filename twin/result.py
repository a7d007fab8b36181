"""What every command returns: a result that prints itself, shows as tables in a notebook and draws its own figures."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from twin.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


HELD_OUT = 8  # names of what was held out: of more the first and the last are told
NAMED = 4  # of the files written, how many a summary names
_FIRST = (".html", ".yaml", ".xml", ".h5", ".csv", ".json")  # what is opened first


def written(files: Sequence[str | Path]) -> str:
    """One line for what was written: the folder, the files that are opened first, and how many more there are."""
    order = {suffix: place for place, suffix in enumerate(_FIRST)}
    paths = sorted(map(Path, files), key=lambda path: order.get(path.suffix, len(order)))
    named, rest = [path.name for path in paths[:NAMED]], paths[NAMED:]
    figures = sum(path.suffix == ".png" for path in rest)
    drawn = f"{figures} figure{'s' * (figures != 1)}"
    more = drawn if figures == len(rest) else f"{len(rest)} more" + (f" ({drawn})" if figures else "")
    folder = min((path.parent for path in paths), key=lambda folder: len(folder.parts))
    return f"wrote into {folder}: {', '.join(named)}{f' and {more}' if rest else ''}"


def listed(names: Sequence[str]) -> str:
    """``a, b, c``; of more than ``HELD_OUT`` names the first, the last and how many."""
    return ", ".join(names) if len(names) <= HELD_OUT else f"{names[0]} to {names[-1]} ({len(names)})"


def no_model() -> dict[str, str | None]:
    """Where the new model is, before it is written."""
    return {"robot": None, "mjcf": None}


class Result:
    """Base of all results.

    ``print(result)`` says what was found, ``result.data()`` is the JSON of the command, and a notebook shows
    ``result.tables()``. Matplotlib is imported only when :meth:`figures` is called.
    """

    drawn_by: ClassVar[str]
    """Module of the report: ``draw`` makes the figures by file name; ``title``, ``lead`` and ``sections`` the page."""

    origin: dict[str, Any]
    """Version, hashes of the inputs, options."""

    def data(self) -> dict[str, Any]:
        """Plain data: what the command prints with ``--json``."""
        raise NotImplementedError

    def tables(self) -> list[Table]:
        """What a notebook shows."""
        raise NotImplementedError

    def figures(self) -> "dict[str, Figure]":
        """Name → Matplotlib figure: those that the command writes as PNG with ``--out``."""
        drawn: dict[str, Figure] = import_module(self.drawn_by).draw(self)
        return {name.removesuffix(".png"): figure for name, figure in drawn.items()}

    def _repr_html_(self) -> str:
        from twin.report.html import fragment

        return fragment(str(self).partition("\n")[0], self.tables())
