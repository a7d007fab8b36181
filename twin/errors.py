"""What a command can end with, or tell: input that breaks a contract, numbers that no calculation survives."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONG = re.compile(r"\S{300,}")  # a word that no line should show whole: of a user's file, or bytes


def _middle_out(word: re.Match[str]) -> str:
    return f"{word[0][:40]}…{word[0][-20:]}"


class _Placed(Exception):
    """One line: where the fault is, and what to do about it."""

    def __init__(self, source: str | Path, field: str, expected: str) -> None:
        self.source, self.field, self.expected = str(source), field, expected
        parts = (self.source, *(LONG.sub(_middle_out, part) for part in (field, expected)))
        super().__init__(": ".join(" ".join(part.split()) for part in parts if part))

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        """Made again from its parts: errors cross processes."""
        return type(self), (self.source, self.field, self.expected)


class InputError(_Placed, ValueError):
    """A user's input breaks a contract.

    Args:
        source: file (or command option) that holds the fault.
        field: where in it, e.g. ``links[2].mass`` or ``postures/milling/frf``; ``""`` for the file as a whole.
        expected: what was expected and, where it helps, what was found instead.
    """


class NumericalError(_Placed, ArithmeticError):
    """A calculation broke down on input that keeps every contract: singular, not converged, not finite.

    Args:
        source: recording, description or option whose numbers it worked on.
        field: posture, run or parameter; ``""`` where none is to blame.
        expected: what broke down, and what to look at.
    """


class Told(UserWarning):
    """Input is taken, but part of it is not used, or is hardly meant. The command line says it on standard error."""


def tell(source: str | Path, field: str, text: str) -> None:
    """Warn of a part of an input, in one line that names it as an :class:`InputError` would."""
    warnings.warn(Told(str(_Placed(source, field, text))), stacklevel=3)


@contextmanager
def numbers_of(source: str | Path, field: str = "") -> Iterator[None]:
    """What breaks down inside becomes a :class:`NumericalError` that names the source; an inner name is kept."""
    from numpy.linalg import LinAlgError

    try:
        yield
    except NumericalError:
        raise
    except (LinAlgError, ArithmeticError) as error:
        remedy = "look for numbers of an impossible size, or in another unit"
        raise NumericalError(source, field, f"the calculation broke down ({error}); {remedy}") from error
