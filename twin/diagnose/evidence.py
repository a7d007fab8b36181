"""What the engine asks of a recording of any kind: one small protocol, which each kind implements in its own file."""

from collections.abc import Sequence
from typing import Any, Protocol

from twin.diagnose.patience import Patience
from twin.diagnose.verdict import Finding
from twin.measure.recordings import Recording
from twin.parallel import Progress
from twin.robot.description import Robot


class Evidence(Protocol):
    """A recording as evidence about a robot.

    Attributes:
        recording: what was read.
    """

    recording: Recording

    @property
    def names(self) -> Sequence[str]:
        """Parts that can be held out: postures or runs."""
        ...

    def explain(
        self,
        given: Robot,
        told_by: Finding | None,
        *,
        hold_out: list[str] | None,
        seed: int,
        progress: Progress,
        processes: int,
        patience: Patience,
    ) -> Finding:
        """What the recording says is missing from a description.

        Args:
            given: the description as it came, removals applied.
            told_by: what the recording before said of the same robot, whose model this one starts from.
            hold_out: parts not to fit to; chosen when ``None``.
            seed: of the starts.
            progress: makes progress bars.
            processes: the work is spread over so many; what it finds does not depend on it.
            patience: how long a search looks for more.

        Raises:
            InputError: the recording does not fit the robot.
        """
        ...

    def again(self, finding: Finding, robot: Robot, last: Finding, hold_out: list[str] | None) -> None:
        """Judge a finding again on the description that all recordings end with; the ``last`` one has settled it."""
        ...

    def checks(self, written: Robot, finding: Finding, alone: bool) -> list[dict[str, Any]]:
        """The written model, read again, in MuJoCo beside the recording; ``alone``: no other kind was diagnosed."""
        ...
