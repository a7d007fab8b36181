"""A sentence of the triage: what is wrong with a recording or was assumed of it, and of which kind that is."""

from typing import Any, Literal

Severity = Literal["note", "warning", "fail"]


class Note(str):
    """A sentence that knows its kind.

    Attributes:
        kind: as in diagnosis.json (``other_robot``, ``reciprocity``, …); ``note`` where there is no word for it.
        severity: ``fail`` where the recording is not to be believed, ``warning`` where it or the description may be
            wrong, ``note`` where something was assumed.
        channels, runs: that it is about.
        sites: numbers of the description, or ``EFFECT@SITE``, that it says are off, farthest first.
    """

    kind: str
    severity: Severity
    channels: tuple[str, ...]
    runs: tuple[str, ...]
    sites: tuple[str, ...]

    def __new__(
        cls,
        text: str,
        kind: str = "note",
        severity: Severity = "warning",
        channels: tuple[str, ...] = (),
        runs: tuple[str, ...] = (),
        sites: tuple[str, ...] = (),
    ) -> "Note":
        note = super().__new__(cls, text)
        note.kind, note.severity, note.channels, note.runs, note.sites = kind, severity, channels, runs, sites
        return note

    def __getnewargs__(self) -> tuple[Any, ...]:
        return str(self), self.kind, self.severity, self.channels, self.runs, self.sites

    def data(self) -> dict[str, Any]:
        """As in diagnosis.json, version 2."""
        return {
            "kind": self.kind, "severity": self.severity, "text": str(self), "probability": None,
            "channels": list(self.channels), "runs": list(self.runs), "sites": list(self.sites),
        }  # fmt: skip
