"""`python -m tools.study_ten_hertz`: a controller that records ten times a second, and a robot without its friction.

The truth code moves an arm of six and one of seven axes. Every joint has viscous and dry friction, and slips before it
moves (Maxwell elements). The description knows none of this. ``twin diagnose`` is asked with one run.

Printed: the wall time, the joints whose friction it named, and the error before, after, and of noise alone.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import twin
from tools.truth.effects import Effect
from tools.truth.motion import Log, Run, draw_fourier, record
from tools.truth.recording import draw_truth
from tools.truth.robots import machines, write_description
from twin.measure.motion_log import MotionLog, MotionRun

RATE_HZ, CONTROLLER_HZ = 250.0, 10.0
SLIP, PRESLIDING = 0.6, 2e-3  # of dry friction; rad until it slips
FRICTION = ("viscous_friction", "coulomb_friction")


def slipping(name: str, seconds: float, seed: int) -> MotionLog:
    """One run of an arm whose joints slip, every 25th sample of what the truth code records."""
    machine, rng = machines()[name], np.random.default_rng(seed)
    truth = draw_truth(int(rng.integers(1 << 31)), (), (), machine.tolerances, chain=machine.chain, log=True)
    torques = SLIP * machine.chain.coulomb
    truth = replace(truth, effects=tuple(
        Effect("hysteresis", f"joint{k}.z", {"stiffness": [torque / PRESLIDING], "yield_torque": [torque]})
        for k, torque in enumerate(torques, 1)
    ))  # fmt: skip
    clock = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    how = Log(rate_hz=RATE_HZ, white=10 * machine.torque, coloured=5 * machine.torque)
    found = record(truth, Run("run", draw_fourier(machine.chain, rng, seconds), clock, 0.0), how, rng)
    at = slice(None, None, round(RATE_HZ / CONTROLLER_HZ))
    return MotionLog({"run": MotionRun("run", clock[at], found.position[at], CONTROLLER_HZ, torque=found.torque[at])})


def main() -> None:
    parser = argparse.ArgumentParser(prog="tools.study_ten_hertz", description=__doc__)
    parser.add_argument("--seconds", type=float, nargs="+", default=[60.0, 300.0])
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    with TemporaryDirectory() as scratch:
        for name in ("six", "seven"):
            path = Path(scratch) / f"{name}.yaml"
            write_description(machines()[name], path)
            for seconds in asked.seconds:
                log = slipping(name, seconds, asked.seed)
                begin = time.perf_counter()
                verdict = twin.diagnose(log, robot=path, without=list(FRICTION))
                wall_s = time.perf_counter() - begin
                said = [m.first for m in verdict.missing]
                named = {kind: sorted(one.site[5:] for one in said if one.effect == kind) for kind in FRICTION}
                others = [one.key for one in said if one.effect not in FRICTION]
                error = verdict.error
                print(
                    f"{name}, {seconds:g} s: {wall_s:.0f} s; "
                    + "; ".join(f"{kind} at joints {' '.join(joints)}" for kind, joints in named.items())
                    + f"; also {', '.join(others) or 'nothing'}; held out {error['before']['held_out']:.1%} → "
                    f"{error['after']['held_out']:.1%}, noise {error['noise_floor']:.1%}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
