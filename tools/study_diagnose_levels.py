"""How often force levels that disagree are named rightly: concealed cases from the truth code, counted with intervals.

    python tools/study_diagnose_levels.py --out out/levels --each 6 --nulls 10
    python tools/study_diagnose_levels.py --out out/levels --table

Effects of ordinary size at joints 1 to 3, six postures at 100 N and 600 N. A gap at a joint that gravity preloads in
every posture cannot show: for gaps at joints 2 and 3 half of the postures carry little weight there, as a test engineer
who suspects play would choose them. Nulls are linear robots. What is judged is the whole answer of the diagnosis, with
what it says is missing beside the law. Every case is one JSON file; an interrupted run goes on.
"""

import argparse
import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from tools.study_diagnose_hammer import wilson

EFFECTS = ("hardening_stiffness", "backlash", "hysteresis")
UNKNOWN = "eddy_current_damper"
UNLOADED_NM = 150.0
FIRST_SEED = 700_000


def cases(each: int, nulls: int, unknown: int, first: int) -> list[tuple[int, str, str]]:
    """(seed, effect, site), interleaved so that any part of the list is a fair sample."""
    found = []
    for number in range(max(each, nulls, unknown)):
        for k, effect in enumerate((*EFFECTS, "none", UNKNOWN)):
            if number < (each, each, each, nulls, unknown)[k]:
                site = "" if effect == "none" else f"joint{(number + k) % 3 + 1}.z"
                found.append((first + 10 * number + k, effect, site))
    return found


def postures(effect: str, site: str, seed: int) -> list[str]:
    """Truth options: six postures, half of them with little weight on the joint where play is concealed."""
    if effect != "backlash" or site == "joint1.z":
        return ["--postures", "6"]
    from twin.identify.sensitivity import structure
    from twin.robot.description import load_robot
    from twin.robot.mechanism import assemble

    robot, rng = load_robot("kr90"), np.random.default_rng(seed)
    options = []
    while len(options) < 12:
        q = np.round([rng.uniform(-85, 85), rng.uniform(25, 135), rng.uniform(-140, -10)])
        model = structure(assemble(robot, robot.angles(q)))
        light = abs(model.load[model.coordinates.index(site)]) < UNLOADED_NM
        if light or len(options) >= 6:
            options += ["--posture", f"p{len(options) // 2 + 1}={q[0]:g},{q[1]:g},{q[2]:g}"]
    return options


def run(case: tuple[int, str, str], folder: Path) -> dict[str, object]:
    from tools.truth.__main__ import main as truth
    from twin.commands.diagnose import diagnose_campaign
    from twin.measure.campaign import read_campaign
    from twin.robot.description import load_robot

    seed, effect, site = case
    recording = folder / f"{seed}.h5"
    options = ["campaign", "--out", str(recording), "--seed", str(seed), "--force-levels", "100", "600"]
    options += [*postures(effect, site, seed), "--coherence", "estimated" if seed % 2 else "expected"]
    if effect != "none":
        options += ["--effect", f"{effect}@{site}"]
    if truth(options):
        raise RuntimeError(f"truth code refused {options}")
    cpu, wall = time.process_time(), time.time()
    finding = diagnose_campaign(read_campaign(recording), load_robot("kr90"))
    answer = json.loads(recording.with_suffix(".truth.json").read_text())["truth"]["effects"]
    recording.unlink()
    return {
        "seed": seed, "effect": effect, "site": site, "truth": answer, "verdict": finding.word,
        "answers": [[m.first.effect, m.first.site, m.probability, m.first.parameters] for m in finding.missing],
        "rivals": [[c.effect, c.site, p] for m in finding.missing for c, p in m.rivals],
        "none": finding.none, "other": finding.other, "error": finding.error,
        "site_found": max(finding.sites, key=finding.sites.__getitem__, default=""),
        "cpu_s": time.process_time() - cpu, "wall_s": time.time() - wall,
    }  # fmt: skip


def held(result: dict[str, Any]) -> list[bool]:
    """Whether the 90 % interval of the law's size holds its true value; slip of other elements has none to compare."""
    true = {(e["kind"], n): v for e in result["truth"] for n, v in e["parameters"].items() if isinstance(v, float)}
    found = [(a[0], n, i) for a in result["answers"] if a[1] == result["site"] for n, i in a[3].items()]
    return [i["interval90"][0] <= true[e, n] <= i["interval90"][1] for e, n, i in found if (e, n) in true]


def table(folder: Path) -> None:
    results = [json.loads(path.read_text()) for path in sorted(folder.glob("*.case.json"))]
    kept = []
    for effect in (*EFFECTS, "none", UNKNOWN):
        some = [r for r in results if r["effect"] == effect and "failed" not in r]
        named = [r["verdict"] in ("named", "ambiguous") for r in some]
        if effect == "none":
            print(f"{effect:22s} false alarms {wilson(sum(named), len(some))}")
        elif effect == UNKNOWN:
            right = sum(r["site_found"] == r["site"] for r in some)
            print(f"{effect:22s} wrong name {wilson(sum(named), len(some))}, right joint {wilson(right, len(some))}")
        else:
            right = [bool(r["answers"]) and r["answers"][0][:2] == [effect, r["site"]] for r in some]
            exact = [first and len(r["answers"]) == 1 for first, r in zip(right, some, strict=True)]
            inside = [ok for r in some for ok in held(r)]
            ratio = [r["error"]["after"]["held_out"] / r["error"]["noise_floor"] for r in some if r["answers"]]
            kept += ratio
            print(f"{effect:22s} top-1 {wilson(sum(right), len(some))}, and nothing beside {sum(exact)},", end=" ")
            print(f"90 % intervals hold {sum(inside)} of {len(inside)}, held out over floor {np.round(ratio, 2)}")
        for r in some:
            true = {n: v for e in r["truth"] for n, v in e["parameters"].items()}
            short = {n: v if isinstance(v, float) else f"Σ {sum(v):.4g}" for n, v in true.items()}
            answers = [
                (f"{a[0]}@{a[1]} {a[2]:.2f}", {n: [i["value"], i["interval90"]] for n, i in a[3].items()})
                for a in r["answers"]
            ]
            print(
                f"    {r['seed']} {r['site']} {short} → {r['verdict']} {answers} none {r['none']:.2f} "
                f"other {r['other']:.2f} rivals {r['rivals']} cpu {r['cpu_s']:.0f} s wall {r['wall_s']:.0f} s"
            )
    if kept:
        print(f"held-out error over the floor: median {np.median(kept):.2f}, largest {max(kept):.2f}")
    for r in results:
        if "failed" in r:
            print("failed:", r["seed"], r["effect"], r["site"], r["failed"].strip().splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=6, help="cases per effect (default 6)")
    parser.add_argument("--nulls", type=int, default=10, help="linear robots (default 10)")
    parser.add_argument("--unknown", type=int, default=0, help="cases of an effect outside the vocabulary")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="seed of the first case")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for case in [] if options.table else cases(options.each, options.nulls, options.unknown, options.first):
        path = options.out / f"{case[0]}.case.json"
        if path.exists():
            continue
        try:
            result = run(case, options.out)
        except Exception:
            result = {"seed": case[0], "effect": case[1], "site": case[2], "failed": traceback.format_exc()}
        path.with_suffix(".part").write_text(json.dumps(result))
        path.with_suffix(".part").replace(path)
        print(case, result.get("verdict", "failed"), file=sys.stderr, flush=True)
    table(options.out)


if __name__ == "__main__":
    main()
