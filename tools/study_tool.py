"""`python -m tools.study_tool --draws 2`: is a heavy tool that no description has found by a hammer test, how exactly?

A tool of 3 to 20 % of the links' mass, with an inertia of its own, is added at the flange of robots of the truth code,
whose other numbers are within the tolerances of their description. It is struck in five postures, and ``twin diagnose``
is asked.

Printed: the verdict, what was named, the mass and its 90 % interval beside the truth, and seconds. Of all: how often
the payload is the only name, how often another thing is named, and how many intervals hold the mass.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import twin
from tools.truth.effects import Effect
from tools.truth.recording import HammerTest, check, draw_truth, streams, write_campaign
from tools.truth.robots import Machine, machines, write_description

SHARES = (0.03, 0.2)  # of the links' mass
GYRATION = (0.1, 0.25)  # radius of gyration of the tool, m, of a robot as large as the KR90
ASIDE, POSTURES = 0.1, 5  # m, of its centre from the flange, of such a robot


def tool(machine: Machine, rng: np.random.Generator) -> Effect:
    """A body on the flange; smaller robots carry smaller ones."""
    mass = sum(link.mass for link in machine.chain.links) * np.exp(rng.uniform(*np.log(SHARES)))
    aside = machine.size * ASIDE * rng.uniform(-1, 1, 3)
    gyration = machine.size * rng.uniform(*GYRATION)
    inertia = mass * gyration**2 * np.array([1.0, 1.0, rng.uniform(0.4, 1.0)])
    com = np.asarray(machine.chain.flange) + aside
    return Effect("payload", "flange", {"mass": float(mass), "com": com.tolist(), "inertia": inertia.tolist()})


def strike(name: str, number: int, seed: int, room: Path) -> tuple[Path, float]:
    """A hammer test of one drawn robot with its tool, and the tool's mass, kg."""
    machine, path = machines()[name], room / f"{name}.yaml"
    if not path.exists():
        write_description(machine, path)
    rng = np.random.default_rng([seed, number])
    load, case = tool(machine, rng), int(rng.integers(1 << 31))
    postures = machine.postures(POSTURES, streams(case)[1])
    test = HammerTest(machine.start_hz, machine.spacing_hz, machine.lines, peak_n=machine.peak_n)
    truth = draw_truth(
        case, (load,), postures, machine.tolerances, chain=machine.chain, sensors=machine.sensors, hammer=machine.hammer
    )
    check(truth, test)
    out = room / f"{name}{number}.h5"
    write_campaign(
        out, truth, postures, test, streams(case)[3], robot=path.name, answer=room / f"{name}{number}.truth.json"
    )
    return out, load["mass"]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="tools.study_tool", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=2, help="per robot (default 2)")
    parser.add_argument("--from", type=int, default=0, dest="first", help="goes on after so many draws")
    parser.add_argument("--of", nargs="+", default=["arm", "column", "kr90", "six", "seven", "light"])
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    alone, others, held, count = 0, 0, 0, 0
    with TemporaryDirectory() as folder:
        for number in range(options.first, options.draws):
            for name in options.of:
                recording, mass = strike(name, number, options.seed, Path(folder))
                start = time.perf_counter()
                found = twin.diagnose(recording)
                names = [missing.first.key for missing in found.missing]
                loads = [missing.first for missing in found.missing if missing.first.key == "payload@flange"]
                inside, told = False, ""
                if loads:
                    known = loads[0].parameters["mass"]
                    low, high = known["interval90"]
                    inside, told = bool(low <= mass <= high), f"{known['value']:.4g} kg ({low:.4g} to {high:.4g})"
                alone, others = alone + (names == ["payload@flange"]), others + bool(set(names) - {"payload@flange"})
                held, count = held + inside, count + 1
                seconds = time.perf_counter() - start
                print(f"{name:7} {mass:6.4g} kg: {found.word}, {', '.join(names)}; {told}; {seconds:.0f} s", flush=True)
    print(f"{count} tools: the only name {alone}, another name beside it or instead {others}, intervals {held}")


if __name__ == "__main__":
    main()
