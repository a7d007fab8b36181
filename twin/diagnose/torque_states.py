"""Whether the runs of a motion log are of one robot in one state: asked where no one model explains them all."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.states import grouped
from twin.diagnose.torque_fit import base_fit
from twin.diagnose.torque_judge import Judge
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, system_of
from twin.model.torque_signal import Prepared

NOISIER = 2.0  # times the scatter of runs about their own models that all about one have; by eye
ASKED = 4  # runs, spread over all, whose own scatter is asked for: a median of so many tells


class RunStates:
    """The runs of a log by themselves.

    Args:
        prepared: the runs used and kept aside; blocks of one run say nothing of states.
        suspects: as for :func:`twin.diagnose.torque_system.system_of`.
    """

    def __init__(self, prepared: Prepared, suspects: Sequence[Suspect], processes: int = 1) -> None:
        self.prepared, self.suspects, self.processes = prepared, suspects, processes
        self.runs = sorted([*prepared.used, *prepared.kept], key=lambda run: run.name)
        self.several = len({run.name for run in self.runs}) == len(self.runs) > 1
        self.known: dict[int, System] = {}

    def alone(self, number: int) -> System:
        """A run's own system, computed once."""
        if number not in self.known:
            self.known[number] = self._system([number])
        return self.known[number]

    def mixed(self, system: System) -> bool:
        """Whether runs scatter far more about the one model of a system than each about its own."""
        if not self.several:
            return False
        some = np.unique(np.linspace(0, len(self.runs) - 1, ASKED).round().astype(int))
        own = np.median([self.alone(int(number)).noise for number in some], axis=0)
        return bool(np.any(system.noise > NOISIER * own))

    def largest(self) -> tuple[list[str], list[Note]]:
        """The runs that one model explains where none explains all, if they are most, and a note on what is apart."""
        most = calibration()["held_out_adequate"]

        def explained(system: System) -> System | None:
            return system if base_fit(system).misfit <= most else None

        def beside(members: Sequence[int], known: System, number: int) -> System | None:
            predicted = Judge(known, [self.runs[number]]).misfit(known, base_fit(known)) <= most
            return explained(self._system([*members, number])) if predicted else None

        if not self.several:
            return [], []
        names = [run.name for run in self.runs]
        groups, notes = grouped(names, "runs", lambda number: explained(self.alone(number)), beside)
        largest = max(groups, key=len, default=[])
        if 2 * len(largest) <= len(names):
            return [], notes
        told = [f"{note}. Only {', '.join(largest)} is diagnosed" for note in notes]
        return largest, [Note(text, "other_robot", "fail", runs=tuple(names)) for text in told]

    def _system(self, members: Sequence[int]) -> System:
        used = [self.runs[k] for k in members]
        return system_of(replace(self.prepared, used=used), self.suspects, processes=self.processes)
