"""How often the hammer-test diagnosis is right: concealed cases from the truth code, diagnosed, scored, counted.

    python tools/study_diagnose_hammer.py --out out/study --each 6 --split development
    python tools/study_diagnose_hammer.py --out out/study --table

Sizes are two to six times the smallest visible, as the truth code counts it (tools/trials/visible.py); effects outside
the vocabulary ten to thirty times. Every case is one JSON file; a run that is interrupted goes on where it stopped.
Development and evaluation cases have seeds apart. Rates come with Wilson 95 % intervals.
"""

import argparse
import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from tools.trials.cases import OUTSIDE, SITES
from tools.trials.visible import hammer_signal, multiple_of_visible
from tools.truth.chain import Tolerances
from tools.truth.effects import Effect, draw
from tools.truth.recording import HAMMER, HammerTest, draw_postures, draw_truth, streams, write_campaign

FIRST_SEED = {"development": 1000, "evaluation": 500_000}
SIZES, OUTSIDE_SIZES = (2.0, 6.0), (10.0, 30.0)  # of the smallest visible
SAME = {("payload", "flange"): ("payload", "link3"), ("payload", "link3"): ("payload", "flange")}
PAIRS = 2  # among every round of single effects

Case = tuple[int, list[tuple[str, str]]]


def cases(each: int, split: str) -> list[Case]:
    """Seeds and what is concealed; a quarter null; interleaved so that any part of the list is a fair sample."""
    rng = np.random.default_rng(FIRST_SEED[split])
    table = SITES["hammer"] | OUTSIDE["hammer"]
    found: list[list[tuple[str, str]]] = []
    for number in range(each):
        for k, kind in enumerate(table):
            found.append([(kind, table[kind][(number * 7 + k) % len(table[kind])])])
            found += [[]] * (k % 3 == 2)
        for _ in range(PAIRS):
            kinds = rng.choice(list(SITES["hammer"]), 2, replace=False)
            found.append([(str(kind), str(rng.choice(SITES["hammer"][kind]))) for kind in kinds])
    return [(FIRST_SEED[split] + n, things) for n, things in enumerate(found)]


def record(seed: int, things: list[tuple[str, str]], path: Path, postures: int) -> tuple[list[Effect], list[str]]:
    """Write a campaign; what it conceals, and which entries the base model is to be without."""
    rng = np.random.default_rng([seed, 1])
    places = tuple(replace(p, brakes="off") for p in draw_postures(postures, streams(seed)[1]))
    test = HammerTest(coherence="estimated" if seed % 2 else "expected", averages=int(rng.integers(4, 8)))
    truth = draw_truth(seed, (), places, Tolerances())
    missing = [site for kind, site in things if kind == "transverse_compliance"]
    stiffness = truth.chain.stiffness.copy()
    for site in missing:
        stiffness[int(site[5]) - 1, "zxy".index(site[-1])] = np.inf
    truth = replace(truth, chain=replace(truth.chain, stiffness=stiffness))
    signal, effects = hammer_signal(places, test, range(len(HAMMER))), []
    for kind, site in things:
        drawn = draw(Effect(kind, site), truth.chain, rng)
        low, high = OUTSIDE_SIZES if kind in OUTSIDE["hammer"] else SIZES
        multiple = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        effects.append(multiple_of_visible(drawn, truth, signal, multiple))
    write_campaign(path, replace(truth, effects=tuple(effects)), places, test, streams(seed)[3])
    return effects, [f"transverse_compliance@{site}" for site in missing]


def run(case: Case, folder: str, postures: int) -> dict[str, Any]:
    from twin.commands.diagnose import diagnose_campaign
    from twin.measure.campaign import read_campaign
    from twin.robot.description import load_robot

    seed, things = case
    path = Path(folder) / f"{seed}.h5"
    effects, without = record(seed, things, path, postures)
    campaign = read_campaign(path)
    path.unlink()
    wall, cpu = time.perf_counter(), time.process_time()
    finding = diagnose_campaign(campaign, load_robot("kr90").without(without), path.name)
    return {
        "seed": seed, "things": things, "truth": [e.parameters for e in effects], "verdict": finding.word,
        "effects": [m.data() for m in finding.missing], "none": finding.none, "other": finding.other,
        "error": finding.error, "sites": finding.sites, "finalists": finding.finalists,
        "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu,
    }  # fmt: skip


def score(result: dict[str, Any]) -> dict[str, Any]:
    """Whether the answer is right: every concealed thing first, or among the first three, and nothing else."""
    true = [tuple(thing) for thing in result["things"]]
    answers = [
        [(e["effect"], e["site"]), *((a["effect"], a["site"]) for a in e["alternatives"])] for e in result["effects"]
    ]

    def found(thing: tuple[str, str], depth: int) -> bool:
        return any(a in (thing, SAME.get(thing)) for answer in answers for a in answer[:depth])

    joint = true[0][1].partition(".")[0] if true else ""
    return {
        "named": bool(answers), "first": [answer[0] for answer in answers],
        "top1": len(answers) == len(true) and all(found(thing, 1) for thing in true),
        "top3": all(found(thing, 3) for thing in true),
        "joint": bool(result["sites"]) and next(iter(result["sites"])).startswith(joint),
        "probability": result["effects"][0]["probability"] if answers else result["none"],
    }  # fmt: skip


def wilson(k: int, n: int) -> str:
    """Share with its 95 % interval (Wilson 1927)."""
    if n == 0:
        return "–"
    z, p = 1.96, k / n
    centre = (p + z * z / 2 / n) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / 4 / n / n)
    return f"{k}/{n} {p:.0%} [{max(centre - half, 0):.0%}, {min(centre + half, 1):.0%}]"


def results(folder: Path) -> list[dict[str, Any]]:
    """Finished cases."""
    return [json.loads(path.read_text()) for path in sorted(folder.glob("*.case.json"))]


def calibration_error(scored: list[dict[str, Any]], bins: int = 5) -> float:
    """Expected calibration error of the first answers (Naeini et al. 2015)."""
    stated = np.array([s["probability"] for s in scored])
    right = np.array([s["right"] for s in scored], float)
    place = np.minimum((stated * bins).astype(int), bins - 1)
    gaps = [abs(right[place == b].mean() - stated[place == b].mean()) * np.mean(place == b) for b in set(place)]
    return float(sum(gaps))


def table(folder: Path) -> None:
    found = results(folder)
    done = [r for r in found if "problem" not in r]
    kinds: dict[str, list[dict[str, Any]]] = {}
    for r in done:
        name = "pair" if len(r["things"]) > 1 else r["things"][0][0] if r["things"] else "none"
        kinds.setdefault(name, []).append(r)
    singles, everything = [], []
    for kind, members in kinds.items():
        scored = [score(r) for r in members]
        n = len(scored)
        for s in scored:
            s["right"] = not s["named"] if kind == "none" else s["top1"]
        if kind in OUTSIDE["hammer"]:
            located = wilson(sum(s["joint"] for s in scored), n)
            print(f"{kind:24s} wrong name {wilson(sum(s['named'] for s in scored), n)}   right joint {located}")
        elif kind == "none":
            print(f"{kind:24s} false alarms {wilson(sum(s['named'] for s in scored), n)}")
        else:
            one, three = (wilson(sum(s[key] for s in scored), n) for key in ("top1", "top3"))
            print(f"{kind:24s} top-1 {one}   top-3 {three}")
            singles += scored if kind != "pair" else []
        everything += scored if kind not in OUTSIDE["hammer"] else []
        for r, s in zip(members, scored, strict=True):
            if not s["right"]:
                print(f"    {r['seed']} {r['things']} → {r['verdict']} {s['first']}")
    one, three = (wilson(sum(s[key] for s in singles), len(singles)) for key in ("top1", "top3"))
    print(f"single effects           top-1 {one}   top-3 {three}")
    if everything:
        print(f"calibration error {calibration_error(everything):.3f} on {len(everything)}")
        wall, cpu = (np.median([r[key] for r in done]) for key in ("wall_s", "cpu_s"))
        print(f"median wall {wall:.0f} s, cpu {cpu:.0f} s")
    for r in found:
        if "problem" in r:
            print("failed:", r["seed"], r["things"], r["problem"].strip().splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=6, help="cases per effect (default 6)")
    parser.add_argument("--split", choices=tuple(FIRST_SEED), default="development")
    parser.add_argument("--postures", type=int, default=6)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    folder = options.out / options.split
    folder.mkdir(parents=True, exist_ok=True)
    if not options.table:
        todo = [c for c in cases(options.each, options.split) if not (folder / f"{c[0]}.case.json").exists()]
        with ProcessPoolExecutor(options.processes) as pool:
            jobs = {pool.submit(run, case, str(folder), options.postures): case for case in todo}
            for number, job in enumerate(as_completed(jobs), 1):
                seed, things = jobs[job]
                try:
                    result = job.result()
                    line = f"{result['verdict']} {score(result)['first']} {result['cpu_s']:.0f} s"
                except Exception:
                    result = {"seed": seed, "things": things, "problem": traceback.format_exc()}
                    line = result["problem"].strip().splitlines()[-1]
                path = folder / f"{seed}.case.json"
                path.with_suffix(".part").write_text(json.dumps(result))
                path.with_suffix(".part").replace(path)
                print(f"{number}/{len(todo)} {seed} {things} → {line}", file=sys.stderr, flush=True)
    table(folder)


if __name__ == "__main__":
    main()
