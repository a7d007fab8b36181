"""A table of a result: what a notebook shows, and a report's page draws."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Rows of cells under a header; ``numbers`` are the columns set flush right, ``dim`` the rows set pale."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: Sequence[int] = ()
    dim: Sequence[int] = ()
    title: str = ""
