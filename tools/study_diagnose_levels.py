"""How often force levels that disagree are named rightly: concealed cases from the truth code, counted with intervals.

    python tools/study_diagnose_levels.py --out out/levels --each 6 --nulls 10
    python tools/study_diagnose_levels.py --out out/levels --table

Effects of ordinary size at joints 1 to 3, six postures at 100 N and 600 N. A gap at a joint that gravity preloads in
every posture cannot show: for gaps at joints 2 and 3 half of the postures carry little weight there, as a test engineer
who suspects play would choose them. Nulls are linear robots. Every case is one JSON file; an interrupted run goes on.
"""

import argparse
import json
import os
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from tools.study_diagnose_hammer import wilson

EFFECTS = ("hardening_stiffness", "backlash", "hysteresis")
UNKNOWN = "eddy_current_damper"
UNLOADED_NM = 150.0
FIRST_SEED = 700_000


def cases(each: int, nulls: int, unknown: int) -> list[tuple[int, str, str]]:
    """(seed, effect, site), interleaved so that any part of the list is a fair sample."""
    found = []
    for number in range(max(each, nulls, unknown)):
        for k, effect in enumerate((*EFFECTS, "none", UNKNOWN)):
            if number < (each, each, each, nulls, unknown)[k]:
                site = "" if effect == "none" else f"joint{(number + k) % 3 + 1}.z"
                found.append((FIRST_SEED + 10 * number + k, effect, site))
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
    from twin.diagnose.levels import decide_levels, explain_levels
    from twin.diagnose.objective import Sample
    from twin.diagnose.search import converge
    from twin.diagnose.triage import triage
    from twin.diagnose.verdict import estimates_of, judge
    from twin.identify.elastic import without_limits
    from twin.identify.parameters import free_parameters
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
    cpu = time.process_time()
    campaign, base = read_campaign(recording), without_limits(load_robot("kr90"))
    found = triage(campaign, base, "case", None)
    sample = Sample(tuple(found.used))
    free = free_parameters(base, dict.fromkeys(r.setup.name for r in found.used), campaign.response.label)
    free = free.select(k for k, p in enumerate(free) if p.kind != "sag")
    search = converge(base, free, sample)
    levels = explain_levels(campaign, base, search.base, sample, search.robust)
    assert levels is not None
    decision = decide_levels(levels)
    answer = json.loads(recording.with_suffix(".truth.json").read_text())["truth"]["effects"]
    recording.unlink()
    return {
        "seed": seed, "effect": effect, "site": site, "truth": answer, "flagged": found.nonlinear,
        "linearity": max(check.value for check in found.checks if check.kind == "linearity"),
        "verdict": judge(decision), "none": decision.none, "other": decision.other,
        "answers": [
            [fit.hypothesis.effect, fit.hypothesis.site, p, fit.misfit, fit.evidence(), estimates_of(fit, fit.own)]
            for fit, p in zip(decision.ranked, decision.probability, strict=True)
        ],
        "places": [[place.site, place.cost] for place in levels.places], "base_misfit": levels.base.misfit,
        "base_evidence": levels.base.evidence(), "window": levels.window, "temper": levels.temper,
        "cpu_s": time.process_time() - cpu,
    }  # fmt: skip


def table(folder: Path) -> None:
    results = [json.loads(path.read_text()) for path in sorted(folder.glob("*.case.json"))]
    for effect in (*EFFECTS, "none", UNKNOWN):
        some = [r for r in results if r["effect"] == effect and "error" not in r]
        named = [r["flagged"] and r["verdict"] in ("named", "ambiguous") for r in some]
        first = [tuple(r["answers"][0][:2]) if n else None for r, n in zip(some, named, strict=True)]
        if effect == "none":
            print(
                f"{effect:22s} false alarms {wilson(sum(named), len(some))}; even if levels had been flagged ", end=""
            )
            print(wilson(sum(r["verdict"] in ("named", "ambiguous") for r in some), len(some)))
        elif effect == UNKNOWN:
            right = sum(r["places"][0][0] == r["site"] for r in some)
            print(f"{effect:22s} wrong name {wilson(sum(named), len(some))}, right joint {wilson(right, len(some))}")
        else:
            right = [answer == (effect, r["site"]) for answer, r in zip(first, some, strict=True)]
            where = sum(r["places"][0][0] == r["site"] for r in some)
            print(f"{effect:22s} top-1 {wilson(sum(right), len(some))}, right joint {wilson(where, len(some))}")
        for r in some:
            answers = [f"{a[0]}@{a[1]} {a[2]:.2f} χ² {a[3]:.2f}" for a in r["answers"][:2]]
            sizes = [{n: i["value"] for n, i in a[5].items()} for a in r["answers"][:1]]
            true = {n: v for e in r["truth"] for n, v in e["parameters"].items()}
            short = {n: v if isinstance(v, float) else f"Σ {sum(v):.4g}" for n, v in true.items()}
            print(
                f"    {r['seed']} {r['site']} {short} linearity {r['linearity']:.1f} → {r['verdict']} {answers} {sizes}"
                f" none {r['none']:.2f} other {r['other']:.2f} base χ² {r['base_misfit']:.1f} cpu {r['cpu_s']:.0f} s"
            )
    for r in results:
        if "error" in r:
            print("failed:", r["seed"], r["effect"], r["site"], r["error"].strip().splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=6, help="cases per effect (default 6)")
    parser.add_argument("--nulls", type=int, default=10, help="linear robots (default 10)")
    parser.add_argument("--unknown", type=int, default=0, help="cases of an effect outside the vocabulary")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for case in [] if options.table else cases(options.each, options.nulls, options.unknown):
        path = options.out / f"{case[0]}.case.json"
        if path.exists():
            continue
        try:
            result = run(case, options.out)
        except Exception:
            result = {"seed": case[0], "effect": case[1], "site": case[2], "error": traceback.format_exc()}
        path.with_suffix(".part").write_text(json.dumps(result))
        path.with_suffix(".part").replace(path)
        print(case, result.get("verdict", "failed"), file=sys.stderr, flush=True)
    table(options.out)


if __name__ == "__main__":
    main()
