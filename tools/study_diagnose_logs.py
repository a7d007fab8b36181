"""How often `twin diagnose` is right on motion logs: concealed cases from the truth code, diagnosed, scored, counted.

    python tools/study_diagnose_logs.py --out out/logs --each 6 --nulls 60
    python tools/study_diagnose_logs.py --out out/logs --table

Truth: KR90 with masses, inertias, rotors, compensator and friction off within tolerance, random Fourier motions with
dwells, encoder counts, white and coloured torque noise, in every second case ripple at every joint and a gas law for
the compensator, in every third bristles for friction, in every fourth (and with play) encoders on the links too.
Sizes are log-uniform from one to thirty times the smallest visible (VISIBLE). What the description has (friction) is
taken out of it, and the truth is given the size that is left. Every case is one JSON file; a study that
is interrupted goes on where it stopped. Rates come with Wilson 95 % intervals.
"""

import argparse
import json
import os
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

JOINTS = ("joint1", "joint2", "joint3")
VISIBLE = {  # smallest size seen on four runs of 45 s; what the size is of
    "viscous_friction": 8.0, "coulomb_friction": 4.0, "asymmetric_friction": 4.0, "stribeck_friction": 6.0,
    "load_dependent_friction": 0.005, "friction_drift": 0.05, "gravity_compensator": 6.0, "payload": 9.0,
    "cable_stiffness": 6.0, "torque_ripple": 3.0, "joint_coupling": 0.004, "rotor_inertia": 240.0, "hysteresis": 4.5,
    "torque_constant": 0.018, "time_delay": 3e-4, "backlash": 2e-5,
}  # fmt: skip
SITES: dict[str, tuple[str, ...]] = {effect: JOINTS for effect in VISIBLE} | {
    "payload": ("flange", "link2", "link3"),
    "gravity_compensator": ("joint1", "joint3", "joint2"),
    "hysteresis": tuple(f"{j}.z" for j in JOINTS),
    "backlash": tuple(f"{j}.z" for j in JOINTS),
    "time_delay": ("log",),
}
LARGEST = {"joint_coupling": 0.3, "torque_constant": 0.15, "payload": 120.0, "rotor_inertia": 3000.0}
FIRST_SEED = {"development": 20_000, "evaluation": 700_000, "last": 910_000}
SAME = [{("payload", "flange"), ("payload", "link3"), ("parameter", "link3.mass")}]

Case = tuple[int, str, str]


def cases(each: int, nulls: int, split: str) -> list[Case]:
    """(seed, effect, site), nulls among them."""
    found: list[Case] = []
    seed = FIRST_SEED[split]
    every = max(1, round(each * len(VISIBLE) / max(nulls, 1)))
    for number in range(each):
        for effect, sites in SITES.items():
            found.append((seed, effect, sites[number % len(sites)]))
            seed += 1
            if sum(c[1] == "none" for c in found) < nulls and len(found) % (every + 1) == every:
                found.append((seed, "none", ""))
                seed += 1
    while sum(c[1] == "none" for c in found) < nulls:
        found.append((seed, "none", ""))
        seed += 1
    return found


def concealed(case: Case) -> tuple[list[str], list[str], float]:
    """Options of the truth code, entries to leave out of the description, and the size over the smallest visible."""
    from tools.truth.recording import draw_truth

    seed, effect, site = case
    rng = np.random.default_rng([seed, 77])
    nuisance = ["--ripple", "1.5", "--compensator", "gas"] if seed % 2 else []
    nuisance += ["--friction", "lugre"] if seed % 3 == 0 else []
    nuisance += ["--link-encoder"] if effect == "backlash" or seed % 4 == 0 else []
    if effect == "none":
        return nuisance, [], 0.0
    if effect == "gravity_compensator" and site == "joint2":
        others = [word for word in nuisance if word not in ("--compensator", "gas")]
        return [*others, "--compensator", "gas"], [f"{effect}@{site}"], 100.0
    size = VISIBLE[effect] * float(np.exp(rng.uniform(0, np.log(30))))
    size = min(size, LARGEST.get(effect, np.inf))
    sign = float(rng.choice([-1, 1]))
    truth = draw_truth(seed, (), (), log=True).chain
    j = int(site[5]) - 1 if site.startswith("joint") else 0
    without: list[str] = []
    match effect:
        case "viscous_friction":
            values, without = f"coefficient={size - truth.viscous[j]}", [f"{effect}@{site}"]
        case "coulomb_friction":
            values, without = f"torque={size - truth.coulomb[j]}", [f"{effect}@{site}"]
        case "asymmetric_friction":
            values = f"torque_difference={sign * size},viscous_difference={size * rng.choice([-1, 1])}"
        case "stribeck_friction":
            values = f"static_excess={size},velocity={np.exp(rng.uniform(np.log(0.02), np.log(0.2)))}"
        case "load_dependent_friction":
            values = f"coefficient={size}"
        case "friction_drift":
            values = f"amplitude={sign * min(size, 0.6)},time_constant={np.exp(rng.uniform(np.log(60), np.log(600)))}"
        case "gravity_compensator":
            B = size * rng.choice([-1, 1], 3) * [1, 0.5, 0.3]
            values = "coefficients=" + "|".join(str(b) for b in B)
        case "payload":
            values = f"mass={size}"
        case "cable_stiffness":
            values = f"stiffness={size},rest={rng.uniform(-1, 1)}"
        case "torque_ripple":
            order = np.exp(rng.uniform(np.log(4), np.log(40)))
            values = f"amplitude={size},order={order},phase={rng.uniform(-3, 3)}"
        case "joint_coupling":
            other = int(rng.choice([k for k in (1, 2, 3) if k != j + 1]))
            values = f"from={other},ratio={sign * size}"
        case "rotor_inertia":
            values = f"inertia={size}"
        case "hysteresis":
            travel = np.exp(rng.uniform(np.log(1e-4), np.log(4e-3)))  # many elements whose yield torques grow
            share = ((np.arange(15) + 0.5) / 15) ** rng.uniform(1, 2.5)
            limits = size * share / share.sum()
            values = "stiffness=" + "|".join([str(size / travel / 15)] * 15)
            values += ",yield_torque=" + "|".join(map(str, limits))
        case "torque_constant":
            values = f"gain={1 + sign * size}"
        case "time_delay":
            values = f"delay={size}"
        case _:
            values = f"gap={size}"
    return [*nuisance, "--effect", f"{effect}@{site}:{values}"], without, size / VISIBLE[effect]


def run(case: Case, folder: Path) -> dict[str, object]:
    """One case: recorded, diagnosed."""
    from tools.truth.__main__ import main as truth
    from twin.diagnose.torque import diagnose_log
    from twin.diagnose.verdict import Verdict
    from twin.measure.motion_log import read_motion_log
    from twin.robot.description import load_robot

    seed, effect, site = case
    path = folder / f"{seed}.h5"
    options, without, size = concealed(case)
    base = ["log", "--out", str(path), "--seed", str(seed), "--runs", "4", "--seconds", "45", "--dwells", "2"]
    if truth([*base, *options]):
        raise RuntimeError(f"truth code refused {options}")
    robot = load_robot("kr90").without(without)
    wall, cpu = time.perf_counter(), time.process_time()
    data = Verdict.of(diagnose_log(read_motion_log(path), robot, str(path))).data()
    spent = time.perf_counter() - wall, time.process_time() - cpu
    path.unlink()
    answer = json.loads(path.with_suffix(".truth.json").read_text())["truth"]["effects"]
    path.with_suffix(".truth.json").unlink()
    visible = [
        v["value"] for v in data["smallest_visible"] if (v["effect"], v["site"]) == (effect, site) and v["value"] > 0
    ]
    keep = {k: data[k] for k in ("verdict", "effects", "probabilities", "error")}
    return {
        "seed": seed, "effect": effect, "site": site, "options": options, "size": size, "truth": answer,
        "visible": min(visible, default=None), "diagnosis": keep, "wall_s": spent[0], "cpu_s": spent[1],
    }  # fmt: skip


def score(result: dict) -> dict:  # type: ignore[type-arg]
    """First answer, top-1, top-3 (first answer and its alternatives), and what else was named."""
    effects = result["diagnosis"]["effects"]
    true = (result["effect"], result["site"])
    same = next((s for s in SAME if true in s), {true})
    answers: list[tuple[str, str]] = []
    if effects:
        answers = [(effects[0]["effect"], effects[0]["site"])]
        answers += [(a["effect"], a["site"]) for a in effects[0]["alternatives"]]
    anywhere = [(e["effect"], e["site"]) for e in effects]
    error = result["diagnosis"]["error"]
    return {
        "named": bool(effects),
        "top1": bool(answers) and answers[0] in same, "top3": any(a in same for a in answers[:3]),
        "anywhere": any(a in same for a in anywhere), "extra": max(len(effects) - 1, 0), "answers": answers[:3],
        "ratio": (error["after"]["held_out"] or np.nan) / error["noise_floor"],
        "probability": effects[0]["probability"] if effects else None,
    }  # fmt: skip


def wilson(k: int, n: int) -> str:
    """Share with its 95 % interval."""
    if n == 0:
        return "–"
    z, p = 1.96, k / n
    centre = (p + z * z / 2 / n) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / 4 / n / n)
    return f"{k}/{n} {p:.0%} [{max(centre - half, 0):.0%}, {min(centre + half, 1):.0%}]"


def multiple(result: dict) -> float:  # type: ignore[type-arg]
    """Size over the smallest visible that the diagnosis itself reports; over the table's where it does not."""
    table = VISIBLE.get(result["effect"], np.nan)
    return float(result["size"] * table / (result["visible"] or table))


def table(folder: Path) -> None:
    """What was counted."""
    results = [json.loads(path.read_text()) for path in sorted(folder.glob("*.case.json"))]
    failed = [r for r in results if "failed" in r]
    results = [r for r in results if "failed" not in r]
    scored = [(r, score(r)) for r in results]
    nulls = [(r, s) for r, s in scored if r["effect"] == "none"]
    print("nulls: false alarms", wilson(sum(s["named"] for _, s in nulls), len(nulls)))
    for r, s in nulls:
        if s["named"]:
            print(f"    {r['seed']} {r['options']} → {s['answers']} {s['probability']:.2f}")
    for least in (2.0, 1.0, 0.0):
        part = [(r, s) for r, s in scored if r["effect"] != "none" and multiple(r) >= least]
        one, three = (sum(s[key] for _, s in part) for key in ("top1", "top3"))
        extra = sum(s["extra"] > 0 for _, s in part)
        print(f"≥ {least:g} × visible: top-1 {wilson(one, len(part))}  top-3 {wilson(three, len(part))}  more {extra}")
    for effect in VISIBLE:
        part = [(r, s) for r, s in scored if r["effect"] == effect]
        seen = [(r, s) for r, s in part if multiple(r) >= 2]
        one, three = (sum(s[key] for _, s in seen) for key in ("top1", "top3"))
        print(f"{effect:26s} top-1 {wilson(one, len(seen))}  top-3 {wilson(three, len(seen))}  of {len(part)} cases")
        for r, s in part:
            if not s["top1"] or s["extra"]:
                more = [(e["effect"], e["site"]) for e in r["diagnosis"]["effects"][1:]]
                print(
                    f"    {r['seed']} {r['site']} {multiple(r):5.1f} × → {r['diagnosis']['verdict']} {s['answers']}"
                    f"{' and ' + str(more) if more else ''}"
                )
    ratios = np.array([s["ratio"] for _, s in scored])
    if len(ratios):
        print(f"held out over floor: median {np.nanmedian(ratios):.3f}, 95 % {np.nanquantile(ratios, 0.95):.3f}, "
              f"≤ 1.2 in {wilson(int(np.sum(ratios <= 1.2)), int(np.sum(np.isfinite(ratios))))}")  # fmt: skip
        answered = [(s["probability"], s["top1"]) for _, s in scored if s["named"]]
        if answered:
            p, right = np.array(answered, float).T
            brier = np.mean((p - right) ** 2)
            print(f"answers: mean probability {p.mean():.3f}, right {right.mean():.3f}, Brier {brier:.3f}")
        wall, cpu = (np.median([r[key] for r in results]) for key in ("wall_s", "cpu_s"))
        print(f"wall {wall:.1f} s, cpu {cpu:.1f} s (median of {len(results)})")
    for r in failed:
        print("failed:", r["seed"], r["effect"], r["site"], r["failed"].strip().splitlines()[-1])


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--each", type=int, default=6, help="cases per effect (default 6)")
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--only", nargs="*", help="effects, none among them")
    parser.add_argument("--split", choices=tuple(FIRST_SEED), default="development")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    options = parser.parse_args()
    folder = options.out / options.split
    folder.mkdir(parents=True, exist_ok=True)
    todo = [] if options.table else cases(options.each, options.nulls, options.split)
    for case in todo:
        path = folder / f"{case[0]}.case.json"
        if path.exists() or (options.only and case[1] not in options.only):
            continue
        try:
            result = run(case, folder)
            line = str(score(result)["answers"] or result["diagnosis"]["verdict"])  # type: ignore[index]
        except Exception:
            result = {"seed": case[0], "effect": case[1], "site": case[2], "failed": traceback.format_exc()}
            line = str(result["failed"]).strip().splitlines()[-1]
        path.with_suffix(".part").write_text(json.dumps(result))
        path.with_suffix(".part").replace(path)
        print(*case, result.get("size"), "→", line, file=sys.stderr, flush=True)
    table(folder)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    main()
