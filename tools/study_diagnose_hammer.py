"""How often `twin diagnose` is right on hammer tests: concealed cases from the truth code, diagnosed, scored, counted.

    python tools/study_diagnose_hammer.py --out out/study --each 6 --split development
    python tools/study_diagnose_hammer.py --out out/study --table

Every case is one JSON file; a run that is interrupted goes on where it stopped. Development and evaluation cases have
seeds apart. Rates come with Wilson 95 % intervals.
"""

import argparse
import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

SITES = {
    "transverse_compliance": [f"joint{i}.{a}" for i in (1, 2, 3) for a in "xy"],
    "base_compliance": [f"base.{a}" for a in ("rx", "ry", "x", "y", "z", "rz")],
    "link_flexibility": [f"link{i}.{a}" for i in (1, 2, 3) for a in "yz"],
    "servo_compliance": ["joint1", "joint2", "joint3"],
    "payload": ["flange", "link2", "link3", "link1"],
    "attached_resonator": ["link1", "link2", "link3"],
    "structural_damping": [f"joint{i}.{a}" for i in (1, 2, 3) for a in "zxy"],
    "sensor_gain": ["sensor:21X+", "sensor:21Y+", "sensor:21Z+"],
    "sensor_misalignment": ["sensor:21"],
    "hammer_misalignment": ["hammer:4Y+", "hammer:9Z-", "hammer:15Z+", "hammer:1X+", "hammer:18Y-", "hammer:21Z+"],
    "time_delay": ["sensor:21X+", "sensor:21Y+", "sensor:21Z+"],
    "posture_stiffness": ["joint1.z", "joint2.z", "joint3.z"],
    "fractional_damper": ["joint1.z", "joint2.z", "joint3.z", "joint2.x"],
}
UNKNOWN = ("posture_stiffness", "fractional_damper")
FIRST_SEED = {"development": 1000, "evaluation": 500_000}
SAME = {("payload", "flange"): ("payload", "link3"), ("payload", "link3"): ("payload", "flange")}


def cases(each: int, split: str, unknown: bool) -> list[tuple[int, str, str]]:
    """(seed, effect, site); a quarter null; interleaved so that any part of the list is a fair sample."""
    found, seed = [], FIRST_SEED[split]
    kinds = [k for k in SITES if unknown or k not in UNKNOWN]
    for number in range(each):
        for k, kind in enumerate(kinds):
            sites = SITES[kind]
            found.append((seed, kind, sites[(number * 7 + k) % len(sites)] if len(sites) > 1 else sites[0]))
            seed += 1
            if k % 3 == 2:
                found.append((seed, "none", ""))
                seed += 1
    return found


def run(case: tuple[int, str, str], folder: str, postures: int) -> dict[str, object]:
    from tools.truth.__main__ import main as truth
    from twin.commands.diagnose import diagnose

    seed, effect, site = case
    stem = Path(folder) / f"{seed}"
    recording = stem.with_suffix(".h5")
    options = ["campaign", "--out", str(recording), "--seed", str(seed), "--postures", str(postures)]
    options += ["--coherence", "estimated" if seed % 2 else "expected"]
    without = []
    if effect == "transverse_compliance":
        without = [f"{effect}@{site}"]
    elif effect != "none":
        options += ["--effect", f"{effect}@{site}"]
    if truth(options):
        raise RuntimeError(f"truth code refused {options}")
    wall, cpu = time.perf_counter(), time.process_time()
    verdict = diagnose([recording], without=without)
    data = verdict.data()
    data.pop("location"), data.pop("smallest_visible")
    answer = json.loads(stem.with_suffix(".truth.json").read_text())["truth"]["effects"]
    recording.unlink()
    return {
        "seed": seed, "effect": effect, "site": site, "truth": answer, "diagnosis": data,
        "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu,
    }  # fmt: skip


def score(result: dict) -> dict[str, object]:
    """What the answer was, and whether it is right: top-1, top-3, a false alarm, a wrong name."""
    d = result["diagnosis"]
    answers = []
    for found in d["effects"]:
        answers = [(found["effect"], found["site"], found["probability"])]
        answers += [(a["effect"], a["site"], a["probability"]) for a in found["alternatives"]]
    true = (result["effect"], result["site"])
    right = [a[:2] == true or SAME.get(true) == a[:2] for a in answers]
    named = bool(answers)
    return {
        "named": named, "top1": bool(right[:1] and right[0]), "top3": any(right[:3]), "verdict": d["verdict"],
        "first": answers[0] if answers else None, "held": d["error"]["after"]["held_out"],
        "floor": d["error"]["noise_floor"],
    }  # fmt: skip


def wilson(k: int, n: int) -> str:
    if n == 0:
        return "–"
    z, p = 1.96, k / n
    centre, half = (
        (p + z * z / 2 / n) / (1 + z * z / n),
        z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / 4 / n / n),
    )
    return f"{k}/{n} {p:.0%} [{max(centre - half, 0):.0%}, {min(centre + half, 1):.0%}]"


def table(folder: Path) -> None:
    results = [json.loads(path.read_text()) for path in sorted(folder.glob("*.case.json"))]
    failed = [r for r in results if "error" in r]
    results = [r for r in results if "error" not in r]
    kinds = dict.fromkeys(r["effect"] for r in results)
    totals = [0, 0, 0]
    for kind in kinds:
        scored = [(r, score(r)) for r in results if r["effect"] == kind]
        n = len(scored)
        if kind == "none":
            print(f"{kind:24s} false alarms {wilson(sum(s['named'] for _, s in scored), n)}")
        elif kind in UNKNOWN:
            print(f"{kind:24s} wrong name   {wilson(sum(s['named'] for _, s in scored), n)}")
        else:
            one, three = sum(s["top1"] for _, s in scored), sum(s["top3"] for _, s in scored)
            totals = [totals[0] + one, totals[1] + three, totals[2] + n]
            print(f"{kind:24s} top-1 {wilson(one, n)}   top-3 {wilson(three, n)}")
        for r, s in scored:
            wrong = s["named"] if kind in ("none", *UNKNOWN) else not s["top1"]
            if wrong:
                d = r["diagnosis"]
                errors = {k: d["error"][k]["train"] for k in ("before", "after")}
                print(f"    {r['seed']} {r['site']} → {s['verdict']} {s['first']} {errors} floor {s['floor']:.4f}")
    print(f"all                      top-1 {wilson(totals[0], totals[2])}   top-3 {wilson(totals[1], totals[2])}")
    if results:
        wall, cpu = (np.median([r[key] for r in results]) for key in ("wall_s", "cpu_s"))
        print(f"wall {wall:.0f} s, cpu {cpu:.0f} s")
    for r in failed:
        print("failed:", r["seed"], r["effect"], r["site"], r["error"].strip().splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=6, help="cases per effect (default 6)")
    parser.add_argument("--split", choices=tuple(FIRST_SEED), default="development")
    parser.add_argument("--postures", type=int, default=6)
    parser.add_argument("--unknown", action="store_true", help="effects outside the vocabulary too")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    folder = options.out / options.split
    folder.mkdir(parents=True, exist_ok=True)
    if not options.table:
        wanted = cases(options.each, options.split, options.unknown)
        todo = [c for c in wanted if not (folder / f"{c[0]}.case.json").exists()]
        with ProcessPoolExecutor(options.processes) as pool:
            jobs = {pool.submit(run, case, str(folder), options.postures): case for case in todo}
            for number, job in enumerate(as_completed(jobs), 1):
                seed, effect, site = jobs[job]
                try:
                    result = job.result()
                    line = str(score(result)["first"] or result["diagnosis"]["verdict"])
                except Exception:
                    result = {"seed": seed, "effect": effect, "site": site, "error": traceback.format_exc()}
                    line = result["error"].strip().splitlines()[-1]
                path = folder / f"{seed}.case.json"
                path.with_suffix(".part").write_text(json.dumps(result))
                path.with_suffix(".part").replace(path)
                print(f"{number}/{len(todo)} {effect} {site} → {line}", file=sys.stderr, flush=True)
    table(folder)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    main()
