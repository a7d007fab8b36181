"""Milling with concealed physics: `python -m tools.trials.milling make | ask | cut | score | prove`.

Robots of the truth code are struck as in `tools.trials`. From the hammer test the twin states how deep the robot may
cut, in postures that nobody struck, before its diagnosis and after. Then the true robot cuts: `tools.truth.milling`.

  make   record the robots of a split, seal the answers, draw the cuts
  ask    diagnose every robot; keep the model before and after with what each knows of itself
  cut    open the answers; state depths, refit the true model, step the true robot's cuts
  score  write the page

SPLIT/cuts/ID.yaml           postures and cuts, as a user of the twin knows them
SPLIT/models/ID/             before/ and after/: robot.yaml and posterior.h5; true/: the true model refitted
SPLIT/depths/ID.json         depths stated and true
"""

import argparse
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from tools.trials import make, milling_page, reference, store
from tools.trials.__main__ import every, executor
from tools.trials.cases import usual
from tools.truth.effects import Effect
from tools.truth.elastic import Structure, assemble
from tools.truth.milling import Cut, arc, chatters_at, growth_at, last_link, poles, tip_rows
from tools.truth.recording import draw_postures, plain
from twin.diagnose.hammer import diagnose_campaign
from twin.diagnose.refit import Fitted
from twin.errors import InputError
from twin.identify.damping_transfer import Transfer, misses_of_frf, transfer
from twin.identify.posterior import FILE, Posterior, save_posterior
from twin.measure.recordings import read_campaign
from twin.milling.cut import published_coefficients, read_cut
from twin.milling.ensemble import ensemble, quantile_of_safe
from twin.milling.map import lobes
from twin.milling.postures import tips
from twin.milling.tool_point import ToolModes
from twin.robot.description import load_robot, save_robot
from twin.robot.physical import physical

ATTEMPTS = 20  # seeds in a row, where the truth code refuses a robot
POSTURES, CUTS = 2, 2  # unseen ones of each robot; cuts in each
STAGES = ("base", "after", "true")  # the described model refitted; as diagnosed; the true model refitted
DRAWS = 40
TOGETHER = 25  # robots whose cuts are stepped side by side
SPINDLE_KG, OVERHANG_M, SPINDLE_COM_M = 20.0, 0.25, 0.12
KNOWN_PERCENT = 15.0  # one deviation of each cutting coefficient
MATERIALS = ("aluminium_7075", "aluminium_7075_helical", "steel_s235", "titanium_ti6al4v")
HELICES_DEG = (0.0, 30.0, 45.0)
DEEPEST_M = 0.02  # of interest
FEED_M = 1e-4
LATE_S = 240  # for the depths of one model: a mode of kilohertz takes the lobes minutes


def make_all(split: Path, robots: int, processes: int) -> None:
    """Record robots and draw their cuts."""
    with executor(processes, None) as pool:
        jobs = [(split, *case[:5]) for case in make.prepare(split, robots, None, ("hammer",))]
        lines = every("record", pool, record, jobs)
    store.write(split / "manifest.json", {"format": "twin-trials-milling", "version": 1, "cases": lines})
    store.entered(split, f"{len(jobs)} robots drawn")


def record(split: Path, name: str, kind: str, recording: str, seed: int, number: int) -> dict[str, Any]:
    """Write one robot's hammer test, its sealed answer and its cuts, unless they are there."""
    answer, room = split / "answers" / f"{name}.json", split / "recordings" / name
    if not answer.exists():
        for later in range(ATTEMPTS):
            try:
                found = usual(kind, recording, seed + later, number)  # type: ignore[arg-type]
                make.write_case(found, room)
                break
            except ValueError:  # the truth code refuses the robot
                if later == ATTEMPTS - 1:
                    raise
        assert found.campaign is not None
        effects = [{"effect": e.kind, "site": e.site, "parameters": plain(e.parameters)} for e in found.effects]
        store.write(split / "cuts" / f"{name}.json", draw_cuts(found.seed))
        store.write(
            answer,
            {
                "kind": kind, "recording": recording, "seed": found.seed, "number": number, "effects": effects,
                "without": found.without, "truth": {"campaign": plain(found.campaign.truth)},
            },
        )  # fmt: skip
    files = {path.name: store.sha256(path) for path in sorted(room.glob("*.h5"))}
    return {
        "id": name, "without": store.read(answer)["without"], "files": files, "answer": store.sha256(answer)
    }  # fmt: skip


def draw_cuts(seed: int) -> list[dict[str, Any]]:
    """Postures that were not struck, and cuts in them, as the user states them."""
    rng = np.random.default_rng([seed, 11])
    postures = draw_postures(3 + POSTURES, rng)[3:]
    return [drawn_cut(posture.q_deg, rng) for posture in postures for _ in range(CUTS)]


def drawn_cut(q_deg: tuple[float, ...], rng: np.random.Generator) -> dict[str, Any]:
    """A cut in a posture: teeth, immersion, direction and speed at random."""
    tool = {
        "diameter_m": 0.02, "teeth": int(rng.integers(2, 5)), "overhang_m": OVERHANG_M, "direction": [1.0, 0.0, 0.0],
        "mass_kg": SPINDLE_KG, "com_m": SPINDLE_COM_M, "helix_deg": float(rng.choice(HELICES_DEG)),
    }  # fmt: skip
    material = str(rng.choice(MATERIALS))
    known = published_coefficients()[material].model_dump(mode="json")
    cut = {
        "tool": tool, "coefficients": {**known, "deviation_percent": KNOWN_PERCENT, "source": material},
        "immersion": float(np.round(rng.uniform(0.05, 1.0), 2)), "milling": str(rng.choice(["up", "down"])),
        "feed_per_tooth_m": FEED_M, "feed_direction": [float(v) for v in np.round(rng.normal(size=3), 2)],
        "table_z_m": None, "depth_max_m": DEEPEST_M,
    }  # fmt: skip
    rpm = float(np.round(np.exp(rng.uniform(np.log(600), np.log(6000)))))
    return {"q_deg": list(q_deg), "cut": cut, "spindle_rpm": rpm}


def ask(split: Path, name: str, without: list[str], deadline: float | None) -> bool:
    """Diagnose one robot; whether it was: not past `deadline`."""
    path = split / "results" / f"{name}.json"
    if path.exists() and store.read(path)["engine"] == store.engine_hash():
        return True
    if deadline is not None and time.time() > deadline:
        return False
    source = split / "recordings" / name / "frf.h5"
    result: dict[str, Any] = {"engine": store.engine_hash(), "complaint": None}
    begin = time.process_time()
    try:
        given = load_robot("kr90").without(without)
        finding = diagnose_campaign(read_campaign(source), given, str(source))
        before, after = finding.fits
        keep_model(split / "models" / name / "before", before)
        keep_model(split / "models" / name / "after", after, finding.damping)
        result |= {
            "word": finding.word, "error": finding.error, "none": finding.none, "other": finding.other,
            "effects": [m.data() for m in finding.missing],
        }  # fmt: skip
    except (InputError, ValueError, np.linalg.LinAlgError) as error:  # a refusal is an answer too
        result["complaint"] = str(error)
    result["cpu_s"] = time.process_time() - begin
    store.write(path, result)
    return True


def keep_model(folder: Path, fit: Fitted, damping: Transfer | None = None) -> None:
    """As `twin fit` and `twin diagnose` keep one; ``damping`` is what they say of it in unseen postures."""
    folder.mkdir(parents=True, exist_ok=True)
    limits = load_robot("kr90").axes
    robot = physical(fit.robot)
    axes = [a.model_copy(update={"limits": b.limits}) for a, b in zip(robot.axes, limits, strict=True)]
    save_robot(folder / "robot.yaml", robot.model_copy(update={"axes": axes}))
    known = Posterior.of(fit)
    save_posterior(folder / FILE, damping.known_in(known) if damping else known)


def refer(split: Path, name: str, deadline: float | None) -> None:
    """The base model and the true model refitted, kept beside the diagnosed ones; nothing past `deadline`."""
    for stage, fit in (("base", reference.base_fit), ("true", reference.true_fit)):
        folder = split / "models" / name / stage
        if (folder / FILE).exists() or (deadline is not None and time.time() > deadline):
            continue
        try:
            found = fit(split, name)
            if found is None:
                continue
            misses = misses_of_frf(physical(found.robot), Posterior.of(found), reference.kept_recordings(split, name))
        except (InputError, ValueError, np.linalg.LinAlgError) as error:
            store.write(folder / "complaint.json", str(error))
            continue
        keep_model(folder, found, transfer(misses))


# --- depths -----------------------------------------------------------------------------------------------------------


def state(split: Path, name: str) -> None:
    """What each model of a robot states: its limit for every cut, and the depth stable with 90 % probability."""
    path = split / "depths" / f"{name}.json"
    found = store.read(path) if path.exists() else {}
    for stage in STAGES:
        folder = split / "models" / name / stage
        if stage not in found and (folder / FILE).exists():
            signal.signal(signal.SIGALRM, _late)
            signal.alarm(LATE_S)
            try:
                found[stage] = stated(folder, store.read(split / "cuts" / f"{name}.json"))
            except InputError as error:  # as `twin lobes` refuses it
                found.setdefault("refused", {})[stage] = str(error)
            finally:
                signal.alarm(0)
            store.write(path, found)


def _late(*_: object) -> None:
    raise InputError("lobes", "", f"no limit within {LATE_S} s")


def stated(folder: Path, cuts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each cut: limit (m), the depth that is 90 % safe, damping ratios of the modes with their intervals."""
    robot = load_robot(folder / "robot.yaml")
    drawn = ensemble(robot, read_cut(cuts[0]["cut"]), DRAWS, 0)
    assert drawn is not None
    found = []
    for number, asked in enumerate(cuts):
        cut = read_cut({**asked["cut"], "depth_max_m": DEEPEST_M})
        coefficients = cut.coefficients.draw(np.random.default_rng([0, number]), DRAWS)
        q = robot.angles(asked["q_deg"])[None]
        own = tips(robot, q, cut, "off")
        rotation = cut.frame(own.axis)
        speed = np.array([asked["spindle_rpm"]])
        limit = float(lobes(own.modes.turned(rotation), cut, speed)[0, 0])
        seen = drawn.tips(q, cut, "off").modes
        modes = ToolModes(seen.pole[:, 0], seen.shape[:, 0]).turned(rotation[0])
        depth = lobes(modes, cut, speed, coefficients)[:, 0]
        ratio = np.quantile(seen.damping_percent[:, 0], (0.05, 0.95), axis=0)
        found.append(
            {
                "limit_m": limit, "safe90_m": float(quantile_of_safe(depth)),
                "frequency_hz": own.modes.frequency_hz[0].tolist(),
                "damping_percent": own.modes.damping_percent[0].tolist(), "damping_interval90": ratio.T.tolist(),
            }
        )  # fmt: skip
    return found


def true_cut(split: Path, name: str, number: int) -> tuple[Structure, Cut]:
    """The true robot with the spindle on, in the posture as it truly stands, and the cut with its true coefficients."""
    answer = store.read(split / "answers" / f"{name}.json")
    asked = store.read(split / "cuts" / f"{name}.json")[number]
    rng = np.random.default_rng([answer["seed"], 12])
    error = [np.deg2rad(0.2) * rng.uniform(-1, 1, 3) for _ in range(POSTURES)][number // CUTS]
    spread = np.sqrt(np.log1p((KNOWN_PERCENT / 100) ** 2))
    drift = [np.exp(spread * rng.normal(size=3)) for _ in range(POSTURES * CUTS)][number]
    truth = usual(answer["kind"], "hammer", answer["seed"], answer["number"]).campaign
    assert truth is not None
    given, tool, known = asked["cut"], asked["cut"]["tool"], read_cut(asked["cut"]).coefficients
    place = [truth.truth.chain.flange[0] + tool["com_m"], *truth.truth.chain.flange[1:]]
    spindle = Effect("payload", "flange", {"mass": tool["mass_kg"], "com": [float(v) for v in place]})
    q = np.deg2rad(asked["q_deg"]) + error
    structure = assemble(truth.truth.chain, q, (*truth.truth.effects, spindle), sag=truth.truth.sag)
    tip = truth.truth.chain.flange + np.array([tool["overhang_m"], 0.0, 0.0])
    return structure, Cut(
        tip, -last_link(structure)[:, 0], np.array(given["feed_direction"]), tool["teeth"],
        arc(given["immersion"], given["milling"] == "up"), known.shear * drift, asked["spindle_rpm"],
        given["feed_per_tooth_m"], known.edge, float(np.deg2rad(tool["helix_deg"])), tool["diameter_m"],
    )  # fmt: skip


def mill(split: Path, names: list[str]) -> None:
    """Step the true cuts at every depth that was stated, some robots at a time, and keep what grew."""
    path = split / "milled.json"
    names = [name for name in names if _can_be_stepped(split, name)]
    for first in range(0, len(names), TOGETHER):
        kept = store.read(path) if path.exists() and first else {}
        store.write(path, kept | _milled(split, names[first : first + TOGETHER]))


def _can_be_stepped(split: Path, name: str) -> bool:
    """Whether the true robot has modes with the spindle on: a coordinate without mass has none."""
    try:
        for number in range(POSTURES * CUTS):
            structure, cut = true_cut(split, name, number)
            poles(structure, tip_rows(structure, cut))
    except np.linalg.LinAlgError:
        print(f"{name} is left out: its mass matrix is singular", file=sys.stderr)
        return False
    return True


def _milled(split: Path, names: list[str]) -> dict[str, Any]:
    cases, depths, keys = [], [], []
    for name in names:
        found = store.read(split / "depths" / f"{name}.json")
        for number in range(POSTURES * CUTS):
            cases.append(true_cut(split, name, number))
            keys.append((name, number))
            depths.append([
                found[stage][number][what] if stage in found else 1e-6
                for stage in STAGES for what in ("limit_m", "safe90_m")
            ])  # fmt: skip
    rate = growth_at(cases, np.array(depths).T)
    what = [f"{stage} {word}" for stage in STAGES for word in ("limit_m", "safe90_m")]
    safe = [k for k, name in enumerate(what) if name.endswith("safe90_m")]
    goes_on = chatters_at(cases, np.array(depths).T[safe])
    out: dict[str, Any] = {}
    for k, (name, number) in enumerate(keys):
        pole, _ = poles(cases[k][0], tip_rows(*cases[k]))
        out.setdefault(name, {})[str(number)] = {
            "growth": dict(zip(what, rate[:, k].tolist(), strict=True)),
            "chatters": dict(zip(STAGES, goes_on[:, k].tolist(), strict=True)),
            "frequency_hz": (np.abs(pole) / (2 * np.pi)).tolist(),
            "damping_percent": (-100 * pole.real / np.abs(pole)).tolist(),
        }  # fmt: skip
    return out


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tools.trials.milling", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("make", "ask", "refer", "state", "cut", "score", "prove"))
    parser.add_argument("--out", type=Path, default=Path("out/trials"), help="folder of the splits")
    parser.add_argument("--split", default="milling")
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--minutes", type=float, help="begin no diagnosis later than this after the start")
    parser.add_argument("--page", type=Path, help="Markdown page to write (default: in the split's folder)")
    options = parser.parse_args(arguments)
    split = (options.out / options.split).resolve()
    deadline = None if options.minutes is None else time.time() + 60 * options.minutes
    if options.step in ("make", "prove"):
        make_all(split, options.robots, options.processes)
    if not (split / "manifest.json").exists():
        sys.exit(f"{split}: no robots yet; make first")
    cases = store.read(split / "manifest.json")["cases"]
    if options.step in ("ask", "prove"):
        with executor(options.processes, None) as pool:
            asked = every("diagnose", pool, ask, [(split, c["id"], c["without"], deadline) for c in cases])
        print(f"{sum(asked)} of {len(cases)} diagnosed", file=sys.stderr)
    if options.step in ("refer", "prove"):
        with executor(options.processes, None) as pool:
            every("refer", pool, refer, [(split, c["id"], deadline) for c in cases])
    if options.step in ("state", "cut", "prove"):
        names = [c["id"] for c in cases if (split / "models" / c["id"] / "base" / FILE).exists()]
        names.sort(key=lambda name: not (split / "models" / name / "after" / FILE).exists())  # the diagnosed first
        store.entered(split, f"answers opened: cuts of {len(names)} robots")
        with executor(options.processes, None) as pool:
            every("state", pool, state, [(split, name) for name in names])
    if options.step in ("cut", "prove"):
        mill(split, [name for name in names if (split / "depths" / f"{name}.json").exists()])
    if options.step in ("cut", "score", "prove"):
        target = options.page or split / "proof-milling.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(milling_page.page(split, DEEPEST_M, store.entered(split, "scored")), encoding="utf-8")
        print(f"wrote {target}")


if __name__ == "__main__":
    main()
