"""`python -m tools.public_logs FOLDER`: public logs of real arms as files of the twin, for `tools.trials real`.

``TWIN_RECORDINGS`` is the folder of what their makers published; nothing of it is kept here:

emps    one linear axis at 1 kHz, a training record and one of force pulses (Janot, Gautier and Brunot 2019)
tx40    six axes at 5 kHz, nine seconds, with the URDF of the arm
kr300   six axes at 10 Hz (Weigand and others 2022)

FOLDER then holds logs, descriptions and ``recordings.yaml``. The descriptions of EMPS and KR300 lack all dry friction.
Of the TX40 the URDF is all that is known.
"""

import argparse
import os
from pathlib import Path

import numpy as np
import scipy.io

import twin
from twin.measure.motion_log import MotionLog, MotionRun
from twin.robot.description import load_robot

RECORDINGS = Path(os.environ.get("TWIN_RECORDINGS", Path(__file__).parents[2] / "shared" / "data"))
DESCRIBED = Path(__file__).parents[1] / "tests" / "data"
DRY = ("asymmetric_friction", "coulomb_friction", "hysteresis", "stribeck_friction")
LISTED = """\
- name: EMPS, a linear axis; described with viscous friction alone
  recordings: [emps.h5]
  options: [--robot, emps.yaml]
  known: Coulomb friction, then a dependence on direction; one record holds force pulses that its command does not show
- name: TX40, described by its URDF alone
  recordings: [tx40.h5]
  options: [--robot, tx40.yaml]
  known: motor 6 turns with joint 5 too
- name: KR300, ten samples a second; described with viscous friction alone
  recordings: [kr300.h5]
  options: [--robot, kr300.yaml]
  known: Coulomb friction with memory; masses and gear ratios of the description are guesses
- name: KR90, the paper's measured modal table
  recordings: [table7.yaml]
  options: [--robot, kr90]
  known: three hinges per axis leave several per cent of frequency error; nobody has said why
"""


def need(*names: str) -> None:
    """End in one line where real recordings are not there.

    Raises:
        SystemExit: what is missing, and how to say where it is.
    """
    for name in names:
        if not (RECORDINGS / name).is_dir():
            raise SystemExit(f"{RECORDINGS / name}: no such folder; TWIN_RECORDINGS says where real recordings are")


def emps() -> MotionLog:
    """The runs `training` and `pulses`; force from the command, by the makers' gain."""
    runs = {}
    for name, file in (("training", "DATA_EMPS.mat"), ("pulses", "DATA_EMPS_PULSES.mat")):
        data = scipy.io.loadmat(RECORDINGS / "emps" / file)
        runs[name] = MotionRun(name, data["t"].ravel(), data["qm"], 1000.0, data["gtau"].item() * data["vir"])
    return MotionLog(runs)


def tx40_motors() -> tuple[np.ndarray, np.ndarray]:
    """Angles of the TX40's motors, rad, and their torques, N·m: (nt, 6) each, at 5 kHz."""
    position, torque = (
        np.loadtxt(RECORDINGS / "tx40" / name, delimiter=",", skiprows=1)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    return position, torque


def tx40() -> MotionLog:
    """One run `run`. Motor to joint as the makers state it: motor 6 also turns with joint 5, and loads it."""
    motor, current = tx40_motors()
    gears = np.diag([32, 32, 45, -48, 45, 32.0])
    turns, torque = gears.copy(), gears.copy()
    turns[5, 4] = torque[4, 5] = 32
    q = motor @ np.linalg.inv(turns).T + np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    return MotionLog({"run": MotionRun("run", np.arange(len(q)) / 5e3, q, 5e3, torque=current @ torque.T)})


def kr300() -> MotionLog:
    """The runs `train`, `val` and `test`; its axes turn the other way."""
    data = scipy.io.loadmat(RECORDINGS / "kr300" / "forward_identification_shifted.mat")
    runs = {}
    for name in ("train", "val", "test"):
        q, torque = (data[f"{letter}_{name}"].T.astype(float) for letter in "yu")
        runs[name] = MotionRun(name, np.arange(len(q)) / 10, -np.deg2rad(q), 10.0, torque=-250 * torque)
    return MotionLog(runs)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tools.public_logs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    need("emps", "tx40", "kr300")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.exit(2, f"{folder}: expected a folder that can be made ({error.strerror})\n")
    for log in (emps, tx40, kr300):
        twin.write_log(folder / f"{log.__name__}.h5", log())
    for name in ("emps", "kr300"):
        twin.save_robot(folder / f"{name}.yaml", load_robot(DESCRIBED / f"{name}.yaml").without(_dry(name)))
    twin.save_robot(folder / "tx40.yaml", twin.describe(RECORDINGS / "tx40" / "tx40.urdf").robot)
    (folder / "table7.yaml").write_text((DESCRIBED / "table7_measured.yaml").read_text())
    (folder / "recordings.yaml").write_text(LISTED)
    print(f"wrote {folder / 'recordings.yaml'}; next: python -m tools.trials real {folder / 'recordings.yaml'}")


def _dry(name: str) -> list[str]:
    """Entries of dry friction of a description of the tests."""
    return sorted({e.effect for e in load_robot(DESCRIBED / f"{name}.yaml").physics} & set(DRY))


if __name__ == "__main__":
    main()
