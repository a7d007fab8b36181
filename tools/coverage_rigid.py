"""How often the 90 % intervals of `twin identify` hold the truth, over logs of the independent truth code.

Every log is another robot near the KR90 with another noise and other trajectories: encoder quantisation, white and
coloured torque noise. The truth of a base parameter is its combination of the truth's links.

    python tools/coverage_rigid.py [--logs 100] [--first 0] [--runs 4] [--seconds 60] [--out coverage.json]
"""

import json
import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from tools.truth.__main__ import main as truth
from twin.identify.rigid import Identification, identify
from twin.measure.motion_log import read_motion_log
from twin.model.regressor import Regressor, inertial_vector
from twin.model.torque_rows import relative_error
from twin.robot.description import load_robot


def true_parameters(answer: dict, regressor: Regressor) -> np.ndarray:
    """The truth's values of all columns (p,), from what the truth code writes beside a log."""
    chain = answer["truth"]["chain"]
    values = {}
    for i, link in enumerate(chain["links"]):
        inertia = np.array(link["inertia"], float)
        for name, value in zip(
            ("mass", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"),
            inertial_vector(link["mass"], np.array(link["com"]), inertia),
            strict=True,
        ):
            values[f"link{i + 1}.{name}"] = value
    for i in range(len(chain["links"])):
        values[f"drive{i + 1}.rotor_inertia"] = chain["rotor_inertia"][i]
        values[f"viscous_friction@joint{i + 1}.coefficient"] = chain["viscous"][i]
        values[f"coulomb_friction@joint{i + 1}.torque"] = chain["coulomb"][i]
        for k, B in enumerate(chain["compensator"][i]):
            values[f"gravity_compensator@joint{i + 1}.coefficients[{k + 1}]"] = B
    return np.array([values.get(column.name, 0.0) for column in regressor.columns])


def study(seed: int, runs: int, seconds: float, folder: Path) -> tuple[Identification, np.ndarray]:
    """Identification of one log, and the true base parameters (b,).

    Raises:
        RuntimeError: the truth code finds no trajectory within the limits for this seed.
    """
    path = folder / f"log{seed}.h5"
    code = truth(["log", "--out", str(path), "--seed", str(seed), "--runs", str(runs), "--seconds", str(seconds)])
    if code:
        raise RuntimeError(f"the truth code could not make log {seed}")
    found = identify(read_motion_log(path), load_robot("kr90"))
    answer = json.loads(path.with_suffix(".truth.json").read_text())
    return found, found.estimate.base.combine @ true_parameters(answer, found.regressor)


def main(
    logs: Annotated[int, typer.Option(help="Number of logs.")] = 100,
    first: Annotated[int, typer.Option(help="Seed of the first log.")] = 0,
    runs: Annotated[int, typer.Option(help="Runs per log; every third is held out.")] = 4,
    seconds: Annotated[float, typer.Option(help="Length of a run.")] = 60.0,
    out: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
) -> None:
    """Coverage of the 90 % intervals, parameter by parameter."""
    inside: dict[str, list[bool]] = {}
    held = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + logs):
            try:
                found, true = study(seed, runs, seconds, Path(folder))
            except RuntimeError as error:
                print(f"{error}; left out")
                continue
            low, high = found.estimate.interval90.T
            for name, hit in zip(found.estimate.base.names, (true >= low) & (true <= high), strict=True):
                inside.setdefault(name, []).append(bool(hit))
            held.append(relative_error(found.split.held_out, found.parameters)[1] / found.estimate.noise)
    rates = {name: float(np.mean(hits)) for name, hits in inside.items()}
    for name, rate in rates.items():
        print(f"{name:46s} {rate:6.1%}")
    total = float(np.mean([rate for rate in rates.values()]))
    print(f"all {total:.1%} of {len(held)} logs; binomial deviation per parameter {np.sqrt(0.09 / len(held)):.1%}")
    print("held-out RMS over the noise of the fit, per joint:", np.mean(held, axis=0).round(3))
    if out:
        out.write_text(json.dumps({"logs": len(held), "first": first, "coverage": rates, "all": total}, indent=2))


if __name__ == "__main__":
    typer.run(main)
