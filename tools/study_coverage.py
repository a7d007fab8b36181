"""Do the fit's 90 % intervals cover the truth nine times in ten? Campaigns of the independent truth code, fitted.

    python tools/study_coverage.py [--campaigns 60] [--postures 4] [--estimated] [--nodes] [--deviations]
                                   [--processes 2] [--out coverage.json]

Every campaign has a robot of its own (stiffness ×/÷ 1.3, damping ×/÷ 2, below 150 N·m·s/rad ×/÷ 10, masses ±3 %,
centres of mass ±1 cm, inertias ±3 %, posture ±0.2°, gains ±1 %), noise with coherence, and postures of its own; the
last is held out. With `--nodes` every sensor and blow is elsewhere, and turned, by the tolerances of the description.
All is drawn uniformly within these limits, whose standard deviation is 1/√3 of what a description states. With
`--deviations` the limits are √3 times as far, so that the spread is as stated.
Reported: coverage pooled and by parameter for parameters called identifiable, the held-out error over the floor (noise,
and what the tolerances leave open), agreement of starts, time.
"""

import json
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from tools.truth.__main__ import main as truth
from tools.truth.chain import Tolerances
from tools.truth.recording import HammerTest, draw_postures, draw_truth, streams, write_campaign
from twin.identify.elastic import fit_frf, with_nodes
from twin.identify.elastic_compare import expected_error, judge, noise_floor
from twin.identify.uncertainty import estimates
from twin.measure.campaign import read_campaign
from twin.model.recorded import believed, placed
from twin.robot.description import Robot, load_robot

ORDER = "zxy"


def stated_spread() -> Tolerances:
    """Limits of uniform draws whose standard deviations are the usual limits."""
    t, wider = Tolerances(), np.sqrt(3)
    ratios = {name: getattr(t, name) ** wider for name in ("stiffness", "damping", "damping_poor", "friction")}
    shares = {name: getattr(t, name) * wider for name in ("mass", "com", "inertia", "posture_deg", "gain")}
    return replace(t, **ratios, **shares)


def spread_as_stated(path: Path, seed: int, postures: int, coherence: Literal["expected", "estimated"]) -> None:
    """A campaign of a robot whose numbers scatter by the standard deviations that its description states."""
    where = draw_postures(postures, streams(seed)[1])
    robot_truth = draw_truth(seed, (), where, stated_spread())
    test = replace(HammerTest(), coherence=coherence)
    write_campaign(path, robot_truth, where, test, streams(seed)[3], answer=path.with_suffix(".truth.json"))


def off(path: Path, seed: int, postures: int, robot: Robot) -> None:
    """A campaign whose sensors and blows are elsewhere, and turned, by the robot's tolerances."""
    rng, where = np.random.default_rng([seed, 1]), draw_postures(postures, streams(seed)[1])
    robot_truth = draw_truth(seed, (), where)
    sites = [*{f"sensor:{c.node}" for c in robot_truth.sensors}, *(f"hammer:{c.label}" for c in robot_truth.hammer)]
    moved = {site: robot.tolerances.position * rng.normal(size=3) for site in sorted(sites)}
    turned = {site: np.deg2rad(robot.tolerances.direction_deg) * rng.normal(size=3) for site in sorted(sites)}
    spoilt = replace(robot_truth, moved=moved, turned=turned)
    write_campaign(path, spoilt, where, HammerTest(), streams(seed)[3], answer=path.with_suffix(".truth.json"))


def one(
    seed: int, postures: int, options: list[str], nodes: bool = False, deviations: bool = False, starts: int = 4
) -> dict[str, Any]:
    """Generate, fit and judge one campaign."""
    robot = load_robot("kr90")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.h5"
        if nodes:
            off(path, seed, postures, robot)
        elif deviations:
            spread_as_stated(path, seed, postures, "estimated" if "estimated" in options else "expected")
        else:
            truth(["campaign", "--out", str(path), "--seed", str(seed), "--postures", str(postures), *options])
        campaign = read_campaign(path)
        answer = json.loads(path.with_suffix(".truth.json").read_text(encoding="utf-8"))["truth"]["chain"]
    recordings = list(believed(campaign, robot, "campaign")[0].values())
    train, held_out = recordings[:-1], recordings[-1]
    began = time.perf_counter()
    fit = fit_frf(robot, train, starts=starts, seed=seed)
    if nodes:
        fit = with_nodes(robot, train, fit)
        (held_out,) = placed([held_out], fit.parameters, fit.values)
    seconds = time.perf_counter() - began
    parameters = []
    for estimate in estimates(fit):
        parameter = estimate.parameter
        if parameter.kind != "spring":
            continue
        joint, axis = int(parameter.site[5]) - 1, ORDER.index(parameter.site[-1])
        true = answer[parameter.quantity][joint][axis]
        low, high = estimate.interval90
        parameters.append(
            {
                "name": parameter.name,
                "true": true,
                "value": estimate.value,
                "covered": bool(low <= true <= high),
                "identifiable": estimate.identifiable,
                "deviation": estimate.deviation,
            }
        )
    return {
        "seed": seed, "seconds": seconds, "agreeing": fit.agreeing, "misfit": fit.misfit, "converged": fit.converged,
        "parameters": parameters, "held_out": judge(fit.robot, [held_out]).error,
        "noise_floor": noise_floor([held_out]), "floor": expected_error(fit.robot, fit, [held_out]),
    }  # fmt: skip


def main(
    campaigns: Annotated[int, typer.Option(help="how many")] = 60,
    postures: Annotated[int, typer.Option(help="per campaign; the last is held out")] = 4,
    processes: Annotated[int, typer.Option(help="at a time")] = 2,
    first: Annotated[int, typer.Option(help="seed of the first")] = 1000,
    sag: Annotated[bool, typer.Option(help="the true springs sag under the weight, as the model's do not")] = True,
    estimated: Annotated[
        bool,
        typer.Option("--estimated", help="coherence as an analyser estimates it from five blows, not its expectation"),
    ] = False,
    nodes: Annotated[bool, typer.Option("--nodes", help="sensors and blows are off by their tolerances")] = False,
    deviations: Annotated[
        bool, typer.Option("--deviations", help="the robots scatter by the standard deviations that are stated")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="every campaign's numbers, as JSON")] = None,
) -> None:
    """Run the study and print its summary."""
    options = ([] if sag else ["--no-sag"]) + (["--coherence", "estimated"] if estimated else [])
    with ProcessPoolExecutor(processes) as pool:
        seeds = range(first, first + campaigns)
        found = list(pool.map(one, seeds, *([x] * campaigns for x in (postures, options, nodes, deviations))))
    if out:
        out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    held = [p for run in found for p in run["parameters"] if p["identifiable"]]
    tried, covered = Counter(p["name"] for p in held), Counter(p["name"] for p in held if p["covered"])
    print(f"{campaigns} campaigns, {postures - 1} postures fitted, 1 held out")
    pooled = sum(covered.values()) / len(held)
    print(f"coverage of 90 % intervals, identifiable parameters, pooled: {pooled:.1%} of {len(held)}")
    for name in dict.fromkeys(p["name"] for p in found[0]["parameters"]):
        if tried[name]:
            print(f"  {name:20} {covered[name] / tried[name]:6.1%} of {tried[name]:3d} in which it is identifiable")
        else:
            print(f"  {name:20}    held by the prior in all")
    others = [p["covered"] for run in found for p in run["parameters"] if not p["identifiable"]]
    if others:
        print(f"coverage where the prior holds the parameter: {np.mean(others):.1%} of {len(others)}")
    ratio = np.array([run["held_out"] / run["floor"] for run in found])
    print(f"held-out error over floor: median {np.median(ratio):.3f}, largest {ratio.max():.3f}")
    over = np.array([run["held_out"] / run["noise_floor"] for run in found])
    print(f"held-out error over noise alone: median {np.median(over):.3f}, largest {over.max():.3f}")
    error = [run["held_out"] for run in found]
    print(f"held-out error: median {np.median(error):.3%}, largest {max(error):.3%}")
    print(f"starts that agree: {dict(Counter(run['agreeing'] for run in found))} of 4")
    worst = max(run["misfit"] for run in found)
    print(f"misfit: largest {worst:.3f}; not converged: {sum(not run['converged'] for run in found)}")
    print(f"seconds per fit: median {np.median([run['seconds'] for run in found]):.1f}")


if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    app()
