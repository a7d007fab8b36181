"""`python -m tools.study_replicate`: whether names given to real recordings hold on a part nothing had seen.

Two thirds of a recording are diagnosed, hold-out of its own included. Then every name is taken out of the model in turn
and all the rest refitted to the same two thirds. Both models predict the torque of the last third, which neither the
search nor its hold-out had seen. Printed is RMS of the error over RMS of the torque, where the name acts: a name that
replicates lowers it. Where one does not, the unseen part is diagnosed by itself: if it gets that name, too, its numbers
on both parts are printed, with their 90 % intervals.

The arm is the TX40 (nine seconds at 5 kHz, its URDF alone). Of EMPS (one axis, viscous friction alone described) and of
the KR300 (10 Hz) one record is diagnosed and another predicted. ``TWIN_RECORDINGS`` is the folder of real
recordings.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported

import numpy as np

from tools import public_logs
from tools.public_logs import DESCRIBED, need
from tools.study_payload import tx40
from twin.diagnose.torque import base_system, diagnose_log, predicted_torque, searched
from twin.diagnose.torque_search import Search
from twin.diagnose.torque_step import Step, left_out, own_rows
from twin.errors import InputError
from twin.identify.uncertainty import NINETY
from twin.measure.motion_log import MotionLog, MotionRun
from twin.model.torque_base import base_of
from twin.model.torque_rows import Bands, joint_run
from twin.model.torque_signal import Prepared, Run, prepare, run_of
from twin.robot.description import Robot, load_robot

WIDE = Bands((16.0, 20.0), (24.0, 30.0))  # two thirds of nine seconds are too short for less


def thirds(run: MotionRun, last: bool) -> tuple[MotionLog, MotionLog]:
    """Two thirds of a run and the other third, which is the last or the first."""
    cut = len(run.time) * 2 // 3 if last else len(run.time) // 3
    parts = (slice(None, cut), slice(cut, None)) if last else (slice(cut, None), slice(None, cut))
    assert run.torque is not None
    used, unseen = (replace(run, time=run.time[at], position=run.position[at], torque=run.torque[at]) for at in parts)
    return MotionLog({run.name: used}), MotionLog({run.name: unseen})


def replicated(robot: Robot, used: MotionLog, unseen: MotionLog, title: str, bands: Bands | None = None) -> None:
    """Print what each name given to one log takes off the error on the other."""
    prepared, search = _searched(robot, used, bands)
    other = [run_of(prepared.regressor, joint_run(robot, run), prepared.bands) for run in unseen.runs.values()]
    whole = _missed(prepared, other, search, ())
    named: dict[str, str] | None = None
    print(f"{title}: below {prepared.bands.fit[1]:g} Hz, unseen part {_told(whole)}")
    for step in search.found:
        without = _missed(prepared, other, search, (step.key,))
        joints = list(step.joints) or list(range(len(whole)))
        before, after = (float(np.sqrt(np.mean(e[joints] ** 2))) for e in (without, whole))
        where = ", ".join(f"joint{j + 1}" for j in joints)
        told = ""
        if after >= before:
            named = named if named is not None else _named(robot, unseen, bands)
            there = named.get(step.key)
            told = f": named there, too, {there} for {_size(search, step)} here" if there else ": DOES NOT REPLICATE"
        p = step.decision.probability[0]
        print(f"  {step.key:32} p {p:.2f}: {before:.2%} without, {after:.2%} with it at {where}{told}")


def _named(robot: Robot, log: MotionLog, bands: Bands | None) -> dict[str, str]:
    """What a log gets named by itself, with its numbers; nothing where it is too short for that."""
    try:
        search = _searched(robot, log, bands)[1]
    except InputError:
        return {}
    return {step.key: _size(search, step) for step in search.found}


def _size(search: Search, step: Step) -> str:
    """The numbers of a name and their 90 % intervals, beside all else in the model; of a shape no interval."""
    if step.trial is None:
        return "another number of the description"
    values, doubt = own_rows(search.system, step.trial.suspect)
    names = [p.name.rpartition(".")[2] for p in step.trial.suspect.hypothesis.own]
    parts = zip(names, values, NINETY * doubt, strict=True)
    return ", ".join(f"{name} {v:.3g}" + (f" ± {d:.2g}" if d else "") for name, v, d in parts)


def _searched(robot: Robot, log: MotionLog, bands: Bands | None) -> tuple[Prepared, Search]:
    """What is missing in a log, in the given bands or those that a diagnosis would take."""
    prepared = prepare(log, robot, "log", None, bands or diagnose_log(log, robot, "log").bands)
    return prepared, searched(base_system(prepared), prepared, None, 1)[0]


def _missed(prepared: Prepared, runs: Sequence[Run], search: Search, left: Sequence[str]) -> np.ndarray:
    """RMS of the error over RMS of the torque (n,) on other runs, some names taken out and all else refitted."""
    system = left_out(search.system, *(step for step in search.found if step.key in left))
    base = base_of(prepared.regressor, runs, search.plain.base.sliding)
    z = system.plain(system.z)
    lasting = np.zeros(len(base.parameters))
    lasting[: base.lasting] = z[: base.lasting]
    rest, torque = [], []
    for k, run in enumerate(runs):
        predicted = predicted_torque(base, k, lasting, system.entries(system.z), run.valid)
        missed = (run.torque - predicted)[run.valid]
        rest.append(missed - missed.mean(axis=0))  # its own offsets, as a diagnosis judges runs kept aside
        torque.append(run.torque[run.valid])
    size = np.sqrt(np.mean(np.concatenate(torque) ** 2, axis=0))
    return np.asarray(np.sqrt(np.mean(np.concatenate(rest) ** 2, axis=0)) / size)


def _told(errors: np.ndarray) -> str:
    return ", ".join(f"joint{j + 1} {e:.1%}" for j, e in enumerate(errors))


def emps() -> tuple[MotionLog, MotionLog]:
    """The training record and the one of pulses."""
    runs = public_logs.emps().runs
    return MotionLog({"training": runs["training"]}), MotionLog({"pulses": runs["pulses"]})


def kr300() -> tuple[MotionLog, MotionLog]:
    """Of the records that its makers train and test with, the first seven minutes and all six."""
    runs = public_logs.kr300().runs
    train = runs["train"]
    assert train.torque is not None
    some = replace(train, time=train.time[:4000], position=train.position[:4000], torque=train.torque[:4000])
    return MotionLog({"train": some}), MotionLog({"test": runs["test"]})


def main() -> None:
    need("emps", "kr300", "tx40")
    axis = load_robot(DESCRIBED / "emps.yaml").without(["asymmetric_friction", "coulomb_friction"])
    for used, unseen in (emps(), emps()[::-1]):
        replicated(axis, used, unseen, f"EMPS, {next(iter(unseen.runs))} unseen")
    replicated(load_robot(DESCRIBED / "kr300.yaml"), *kr300(), "KR300, its test record unseen")
    with TemporaryDirectory() as room:
        robot, log = tx40(Path(room), np.random.default_rng(0))
    (run,) = log.runs.values()
    for last in (True, False):
        replicated(robot, *thirds(run, last), f"TX40, the {'last' if last else 'first'} third unseen", WIDE)


if __name__ == "__main__":
    main()
