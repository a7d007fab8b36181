"""Whether the runs of a motion log are of one robot in one state: asked where no one model explains them all."""

from collections.abc import Sequence
from dataclasses import replace

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.states import grouped
from twin.diagnose.torque_fit import System, base_fit, system_of
from twin.diagnose.torque_laws import Suspect
from twin.diagnose.torque_search import Judge
from twin.diagnose.torque_signal import Prepared


def run_states(prepared: Prepared, suspects: Sequence[Suspect], processes: int = 1) -> list[Note]:
    """A note on groups of runs that one model explains each, where it does not explain them together.

    Args:
        prepared: the runs used and kept aside; blocks of one run say nothing of states.
        suspects: as for :func:`twin.diagnose.torque_fit.system_of`.
    """
    most = calibration()["held_out_adequate"]
    runs = sorted([*prepared.used, *prepared.kept], key=lambda run: run.name)
    if len({run.name for run in runs}) < len(runs):
        return []

    def fitted(members: Sequence[int]) -> System | None:
        system = system_of(replace(prepared, used=[runs[k] for k in members]), suspects, processes=processes)
        return system if base_fit(system).misfit <= most else None

    def beside(members: Sequence[int], known: System, number: int) -> System | None:
        foretold = Judge(known, [runs[number]]).misfit(known, base_fit(known)) <= most
        return fitted([*members, number]) if foretold else None

    return grouped([run.name for run in runs], "runs", lambda number: fitted([number]), beside)
