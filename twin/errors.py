"""The one error a user's input can cause: a line that names file, field and remedy."""

from pathlib import Path


class InputError(ValueError):
    """A user's input breaks a contract.

    Args:
        source: file (or command option) that holds the fault.
        field: where in it, e.g. ``links[2].mass`` or ``postures/milling/frf``; ``""`` for the file as a whole.
        expected: what was expected and, where it helps, what was found instead.
    """

    def __init__(self, source: str | Path, field: str, expected: str) -> None:
        self.source, self.field, self.expected = str(source), field, expected
        super().__init__(": ".join(part for part in (self.source, field, expected) if part).replace("\n", " "))

    def __reduce__(self) -> tuple[type, tuple[str, str, str]]:
        """Made again from its parts: errors cross processes."""
        return type(self), (self.source, self.field, self.expected)
