"""Damping in a posture that was not fitted to: Table 7's three postures, each predicted from the two others.

    python tools/study_damping_transfer.py [TABLE]

The intervals of a posture are made without it: τ comes from the two others, each predicted from the other one.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin.identify.damping_transfer import Miss, transfer
from twin.identify.elastic_modal import ModalPosture, fit_modes, modal_postures
from twin.identify.fitting import misses_left_out
from twin.measure.modal_table import read_modal_table
from twin.robot.description import Robot, load_robot

TABLE = Path(__file__).parents[1] / "tests" / "data" / "table7_measured.yaml"


def predicted_from(robot: Robot, used: list[ModalPosture], unseen: ModalPosture, starts: int) -> list[Miss]:
    """The modes of a posture beside what a fit to others says."""
    fit = fit_modes(robot, used, starts=starts)
    return misses_left_out(fit, fit.robot, unseen)


def main(
    table: Annotated[Path, typer.Argument(help="modal table")] = TABLE,
    starts: Annotated[int, typer.Option(help="of every fit")] = 4,
) -> None:
    """Print every mode with its interval, the coverage, and τ of all."""
    robot = load_robot("kr90")
    postures = modal_postures(read_modal_table(table), robot)
    everything: list[Miss] = []
    inside, alone = [], []
    for name, unseen in postures.items():
        others = [p for other, p in postures.items() if other != name]
        misses = predicted_from(robot, others, unseen, starts)
        inner = transfer([m for k, p in enumerate(others) for m in predicted_from(robot, [others[1 - k]], p, starts)])
        for miss in misses:
            wide = np.hypot(np.log(inner.factor90), 1.645 * np.sqrt(miss.variance))
            own = 1.645 * np.sqrt(miss.variance)
            inside.append(abs(miss.ln_ratio) < wide)
            alone.append(abs(miss.ln_ratio) < own)
            low, high = 100 * miss.predicted * np.exp([-wide, wide])
            print(
                f"  {name:8} {miss.frequency_hz:5.1f} Hz  measured {100 * miss.measured:.2f} %  predicted "
                f"{100 * miss.predicted:.2f} %  90 %: {low:.2f} … {high:.2f} %{'' if inside[-1] else '   outside'}"
            )
        everything += misses
    ratio = np.array([m.predicted / m.measured for m in everything])
    found = transfer([replace(m) for m in everything])
    print(f"{len(ratio)} modes; predicted over measured {ratio.min():.2f} to {ratio.max():.2f}; error in the mean "
          f"{np.mean(np.abs(ratio - 1)):.0%}, in the median {np.median(np.abs(ratio - 1)):.0%}")  # fmt: skip
    print(f"inside 90 % intervals: {sum(inside)} of {len(inside)}; of the posterior alone: {sum(alone)}")
    print(f"τ of all {found.scatter:.2f}, {found.freedom} misses: within a factor of {found.factor90:.2g}")


if __name__ == "__main__":
    typer.run(main)
