"""What the paper's measured modes (Table 7) say: fits to the milling posture under several priors, to all three, and
leave-one-out.

    python tools/study_paper_fit.py [TABLE]

Errors are mean relative frequency differences with modes paired in order, as in the paper (whose model has 5.5 % on the
two postures it was not fitted to; its printed digits give 5.4 %). Which milling mode is about which axis is taken from
the paper's description of the measured shapes in that posture. Every prior that was tried is listed, whatever it gave.

The priors on springs about z and on tilt, medians in MN·m/rad for joints 1, 2, 3:

* table 6: the paper's own fit to the milling posture.
* gears, smaller class: cycloidal gears with a torsional rigidity of 3.7, 3.7, 2.2 (rated 3 to 4 kN·m, the static torque
  of joint 2), tilt from their main bearing, five times that (20, 20, 12).
* the same, castings: the bearing in series with a casting as stiff, (10, 10, 7).
* gears, larger class: 6.7, 6.7, 3.4 (rated 5.4 kN·m, as fits the 270 kg siblings on the same base), tilt from the main
  bearing (29, 29, 17).
* larger class, foundation and castings: that bearing in series with an anchored base plate of 10 at joint 1 and with
  castings as stiff as itself at joints 2 and 3 (7.5, 14, 9).

The gears' numbers are typical of catalogues, not of this robot, whose gears the maker does not publish.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from twin.identify.elastic import Fit
from twin.identify.elastic_modal import ModalPosture, fit_modes, modal_postures, predict_modes
from twin.measure.modal_table import read_modal_table
from twin.model.parameters import Parameters, free_parameters
from twin.robot.description import Robot, Tolerances, load_robot

TABLE = Path(__file__).parents[1] / "tests" / "data" / "table7_measured.yaml"
CLOSE_RIVAL = 3.0  # cost above the best of a second minimum that is shown
MILLING = (("joint1.z",), ("joint2.z",), ("joint1.x", "joint1.z"), ("joint3.z",))  # paper, Section 3
FREQUENCY, DAMPING = 0.001, 0.1  # relative spread that the milling fits allow
DAMPING_RATIO, DAMPING_HZ, DAMPING_FACTOR = 0.01, 15.0, 3.0  # prior of every damper beside the priors argued here


@dataclass(frozen=True)
class SpringPrior:
    """Medians in N·m/rad about z and of tilt, per joint; factors of one deviation; tilt about x over tilt about y."""

    name: str
    z: tuple[float, float, float]
    tilt: tuple[float, float, float]
    z_factor: float
    tilt_factor: float
    asymmetry: float

    def parameters(self, robot: Robot) -> Parameters:
        """Springs and dampers of the robot under this prior."""
        base = free_parameters(robot, tolerances=False)
        items = []
        for p in base:
            joint, axis = int(p.site[5]) - 1, p.site[-1]
            stiffness = 1e6 * (self.z if axis == "z" else self.tilt)[joint]
            if p.quantity == "stiffness":
                factor = self.z_factor if axis == "z" else self.tilt_factor
                items.append(replace(p, mean=stiffness, deviation=float(np.log(factor))))
            else:
                mean = DAMPING_RATIO * stiffness / (np.pi * DAMPING_HZ)
                items.append(replace(p, mean=mean, deviation=float(np.log(DAMPING_FACTOR))))
        covariance = np.diag([p.deviation**2 for p in items])
        names = [p.name for p in items]
        for joint in range(1, 4):
            x, y = (names.index(f"joint{joint}.{axis}.stiffness") for axis in "xy")
            covariance[x, y] = covariance[y, x] = max(covariance[x, x] - np.log(self.asymmetry) ** 2 / 2, 0.0)
        return Parameters(tuple(items), covariance)


SMALL, LARGE = (3.7, 3.7, 2.2), (6.7, 6.7, 3.4)
PRIORS = (
    SpringPrior("gears, smaller class", SMALL, (20, 20, 12), 1.5, 1.5, 1.2),
    SpringPrior("the same, wider", SMALL, (20, 20, 12), 2.0, 2.0, 1.1),
    SpringPrior("the same, castings", SMALL, (10, 10, 7), 1.5, 1.5, 1.2),
    SpringPrior("the same, castings, foundation", SMALL, (6.5, 10, 7), 1.5, 1.5, 1.2),
    SpringPrior("one value, tilt twice as stiff", (5, 5, 5), (10, 10, 10), 1.5, 1.5, 1.2),
    SpringPrior("tilt as stiff as gears", (5, 5, 3), (5, 5, 3), 1.5, 1.5, 1.2),
    SpringPrior("literature, wide", (3, 3, 3), (9, 9, 9), 2.0, 2.0, 3.0),
    SpringPrior("gears, larger class", LARGE, (29, 29, 17), 1.5, 1.5, 1.2),
    SpringPrior("larger, foundation, castings, x = y to 1.2", LARGE, (7.5, 14, 9), 1.5, 1.5, 1.2),
    SpringPrior("larger, foundation, castings, x = y to 1.5", LARGE, (7.5, 14, 9), 1.5, 1.5, 1.5),
    SpringPrior("larger, foundation, castings, narrow", LARGE, (7.5, 14, 9), 1.3, 1.3, 1.3),
    SpringPrior("the same, narrow z, wide tilt", LARGE, (7.5, 14, 9), 1.3, 1.5, 1.5),
)


def errors(robot: Robot, postures: dict[str, ModalPosture]) -> dict[str, float]:
    """Mean relative frequency difference by posture, modes in order."""
    found = predict_modes(robot, postures, by_order=True)
    return {
        name: float(np.mean([abs((m.frequency_hz or 0) / m.measured_hz - 1) for m in found if m.posture == name]))
        for name in postures
    }


def line(name: str, fit: Fit, postures: dict[str, ModalPosture], unused: tuple[str, ...]) -> str:
    """One row: name, error on unused postures, by posture, agreement of starts, stiffnesses; a second for a rival."""
    by = errors(fit.robot, postures)
    held = f"{np.mean([by[k] for k in unused]):6.2%}" if unused else "      "
    parts = "  ".join(f"{k} {v:6.2%}" for k, v in by.items())
    stiffness = [v for p, v in zip(fit.parameters, fit.values, strict=True) if p.quantity == "stiffness"]
    springs = " ".join(f"{k / 1e6:5.1f}" for k in stiffness)
    rows = [f"  {name:44} {held}  {parts}  {fit.agreeing}/{len(fit.starts)}  {springs}"]
    if fit.rival is not None and fit.rival < CLOSE_RIVAL and unused:
        z = next(start.z for start in fit.starts if start.cost >= fit.starts[0].cost + fit.rival)
        by = errors(fit.parameters.apply(fit.robot, fit.parameters.values(z)), postures)
        rows.append(
            f"  {f'  a second minimum, {fit.rival:.1f} more in ½χ²':44} {np.mean([by[k] for k in unused]):6.2%}"
        )
    return "\n".join(rows)


def main(
    table: Annotated[Path, typer.Argument(help="modal table")] = TABLE,
    starts: Annotated[int, typer.Option(help="of every fit")] = 8,
) -> None:
    """Run all fits and print them."""
    measured = read_modal_table(table)
    kr90, identified = load_robot("kr90"), load_robot("kr90_identified")
    postures = modal_postures(measured, kr90)
    milling = replace(
        postures["milling"],
        frequency_spread=np.full(4, FREQUENCY),
        damping_spread=np.full(4, DAMPING),
        dominant=MILLING,
    )
    unused = ("upright", "rigid")

    one_hinge = identified.without(["transverse_compliance"])
    fit = fit_modes(
        one_hinge, [postures["milling"]], free_parameters(one_hinge, tolerances=False), objective="paper", starts=starts
    )
    print("One hinge per axis on kr90_identified, Eq. 23, three of the four milling modes (Table 3):")
    for p, value in zip(fit.parameters, fit.values, strict=True):
        print(f"  {p.name:20} {value:10.4g} {p.unit:12} Table 3 {p.mean:8.4g}  {value / p.mean - 1:+.1%}")

    print("\nThree hinges per axis, fitted to the milling posture alone; error on upright and rigid, then by posture;")
    print("starts that agree; stiffness in MN·m/rad of z1 z2 z3 x1 y1 x2 y2 x3 y3")
    by = errors(kr90, postures)
    print(f"  {'the paper (Table 6, links of Table 5)':44} {np.mean([by[k] for k in unused]):6.2%}")
    # the links of kr90_identified come from the paper's torque measurements, not from any modal test
    near_a1 = kr90.model_copy(update={"links": identified.links})
    for title, robot in (("Table 5", kr90), ("the rigid-body identification (Table A1)", near_a1)):
        print(f" Links of {title}:")
        fit = fit_modes(robot, [milling], free_parameters(robot, tolerances=False), starts=starts)
        print(line("table 6, ×/÷ 1.3", fit, postures, unused))
        for prior in PRIORS:
            fit = fit_modes(robot, [milling], prior.parameters(robot), starts=starts)
            print(line(prior.name, fit, postures, unused))

    print(
        "\nAll three postures; then each left out in turn (first column: error on it). Springs ×/÷ 1.3 about Table 6."
    )
    loose = kr90.model_copy(update={"tolerances": Tolerances(mass=0.05, inertia=0.15, com=0.03)})
    for title, robot, kinds in (
        ("springs", kr90, ("spring",)),
        ("springs and links within 3 %, 3 %, 1 cm", kr90, ("spring", "link")),
        ("springs and links within 5 %, 15 %, 3 cm", loose, ("spring", "link")),
    ):
        free = free_parameters(robot).only(*kinds)
        fit = fit_modes(robot, list(postures.values()), free, starts=starts)
        print(line(title, fit, postures, ()))
        for name in postures:
            rest = [posture for key, posture in postures.items() if key != name]
            print(line(f"  without {name}", fit_modes(robot, rest, free, starts=starts), postures, (name,)))


if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    app()
