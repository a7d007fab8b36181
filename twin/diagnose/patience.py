"""How long a diagnosis looks for more: what it has found by then is the answer, and what it left out is said."""

import time
from dataclasses import dataclass, field
from math import inf

from twin.diagnose.note import Note
from twin.effort import of_size_s, told
from twin.measure.recordings import Recording

LEAST_MIN = 3.0  # of a search: nineteen in twenty whole diagnoses of six and seven axes end within two
AMPLE = 2.0  # times what a recording of that size usually takes


def usual_minutes(recording: Recording) -> float:
    """How long a recording is searched where nobody says: ``LEAST_MIN``, or by its size."""
    content, axes = recording.content, 0
    if recording.kind == "frf-campaign":
        values = sum(posture.frf.size for posture in content.postures.values())
        axes = max((len(posture.q_deg) for posture in content.postures.values()), default=0)
    elif recording.kind == "motion-log":
        values = sum(run.position.size for run in content.runs.values())
    else:
        return LEAST_MIN
    return max(LEAST_MIN, AMPLE * of_size_s("diagnose", recording.kind, values, axes) / 60)


@dataclass
class Patience:
    """A time, and what was not done because it had come.

    Attributes:
        minutes: that a search may take.
        left: what was left out, in order.
    """

    minutes: float = inf
    left: list[str] = field(default_factory=list)
    _since: float = field(default_factory=time.monotonic)

    def is_up(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() - self._since >= 60 * self.minutes

    def over(self, what: str) -> bool:
        """Whether the time is up; then ``what`` (a noun, for people) is left out."""
        if not self.is_up():
            return False
        if what not in self.left:
            self.left.append(what)
        return True

    def notes(self) -> list[Note]:
        """What was left out, in one sentence; none where nothing was."""
        if not self.left:
            return []
        text = (
            f"the search ended after {told(60 * self.minutes) or f'{60 * self.minutes:.0f} s'} (--minutes). It left "
            f"out: {'; '.join(self.left)}. More time may change the answer"
        )
        return [Note(text, "search_ended")]
