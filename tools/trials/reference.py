"""The true model refitted: the held-out error that an answer's is compared to.

What is concealed is put into the description as it truly is, everything is fitted as ``twin diagnose`` fits it, on the
postures it uses. A law of amplitude is held at its true numbers and stepped, after blows of their true length. The fit
starts from the robot that was struck: its optimum is next to that, and no search for it can fail.

SPLIT/references/ID.json     the error, and the engine that fitted
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tools.trials.cases import struck
from tools.trials.store import engine_hash, read, write
from twin.diagnose.refit import NONE, Fitted, descend
from twin.diagnose.triage import Triage, triage
from twin.identify.descent import minimise
from twin.identify.elastic_compare import judge
from twin.identify.joint_reaction import Stepped
from twin.identify.objective import Sample
from twin.identify.struck import judge_struck, law_of
from twin.measure.blows import blows
from twin.measure.campaign import FloatArray
from twin.measure.recordings import read_campaign
from twin.model.parameters import SIX, Parameters, free_parameters
from twin.model.recorded import Recorded, without_limits
from twin.physics import CATALOGUE
from twin.robot.description import Entry, Robot, load_robot
from twin.robot.physical import physical

ITERATIONS, GAIN = 20, 0.1  # in ln likelihood: less is not waited for
FEW_LINES = 25  # of a channel, on which a base model is looked for


def refer(split: Path, name: str) -> None:
    """Keep the error of one case, unless this engine's is kept."""
    path = split / "references" / f"{name}.json"
    if not path.exists() or read(path)["engine"] != engine_hash():
        write(path, {"engine": engine_hash(), "held_out": held_out_error(split, name)})


def kept(split: Path, name: str) -> float | None:
    """What this engine's error was."""
    path = split / "references" / f"{name}.json"
    found = read(path) if path.exists() else {}
    error: float | None = found.get("held_out") if found.get("engine") == engine_hash() else None
    return error


def described(effects: Sequence[dict[str, Any]], chain: dict[str, Any]) -> list[Entry] | None:
    """Entries of a description that are what is concealed in a chain; ``None`` where it holds what none can say: a link
    that bends as a beam, a law outside the vocabulary."""
    found = []
    for e in effects:
        known = {p.name for p in CATALOGUE[e["effect"]].parameters} if e["effect"] in CATALOGUE else set()
        if not set(e["parameters"]) <= known:
            return None
        values = e["parameters"]
        if e["effect"] == "servo_compliance":  # which sets its rotor free, whose inertia is not the description's
            i = int(e["site"].removeprefix("joint")) - 1
            values = {"inertia": chain["gear_ratio"][i] ** 2 * chain["rotor_inertia"][i], **values}
        found.append(Entry(effect=e["effect"], site=e["site"], **values))
    return found


def true_values(parameters: Parameters, truth: dict[str, Any]) -> FloatArray:
    """What the robot struck has of the numbers (n,) that a fit may change; a concealed entry's are as described."""
    chain = truth["chain"]
    known = {"posture.sag": float(truth["sag"])}
    for i, (link, k, c) in enumerate(zip(chain["links"], chain["stiffness"], chain["damping"], strict=True), 1):
        for a, stiffness, damping in zip("zxy", k, c, strict=True):
            if stiffness is not None:  # else what is concealed is all there is
                known |= {f"joint{i}.{a}.stiffness": stiffness, f"joint{i}.{a}.damping": damping}
        known |= {f"link{i}.mass": link["mass"]}
        known |= {f"link{i}.com.{a}": value for a, value in zip("xyz", link["com"], strict=True)}
        known |= {f"link{i}.inertia.{a}{b}": link["inertia"]["xyz".index(a)]["xyz".index(b)] for a, b in SIX}
    for name, angles in truth["posture_error"].items():
        known |= {f"posture.{name}.q{i}": value for i, value in enumerate(angles, 1)}
    known |= {f"gain.{label}": value for label, value in truth["gain"].items()}
    return np.array([known.get(p.name, p.mean) for p in parameters])


def held_out_error(split: Path, name: str) -> float | None:
    """Of the true model, refitted to the hammer test of a case; ``None`` where there is none, or no such model."""
    answer = read(split / "answers" / f"{name}.json")
    if answer["recording"] not in ("hammer", "levels"):
        return None
    found = _posed(split, name, answer)
    if found is None:
        return None
    base, laws, known, z = found
    if not known.kept:
        return None
    sample, free = Sample(tuple(known.used), 1 / known.shared), _free(base, known.used)
    if not laws:
        return judge(physical(_refitted(base, free, sample, z).robot), known.kept).error
    (entry,) = laws
    campaign = read_campaign(split / "recordings" / name / "frf.h5")
    pulse_s = struck(answer["kind"], answer["recording"], answer["seed"], answer["number"]).pulse_s
    how = {group: replace(b, pulse_s=pulse_s, known=True) for group, b in (blows(campaign) or {}).items()}
    law, sizes, site, _ = law_of(base.model_copy(update={"physics": [*base.physics, entry]}))
    objective = Stepped(base, free, sample, law=law, site=site, blow=how, fixed=sizes, closely=True)
    z, *_ = minimise(objective, z, ITERATIONS, GAIN)
    robot = free.apply(base, free.values(z))
    return judge_struck(robot.model_copy(update={"physics": [*robot.physics, entry]}), known.kept, how).error


def true_fit(split: Path, name: str) -> Fitted | None:
    """The true model refitted to the hammer test of a case, linear as it must be; ``None`` where no entries say it."""
    answer = read(split / "answers" / f"{name}.json")
    found = _posed(split, name, answer)
    if found is None or found[1]:
        return None
    base, _, known, z = found
    return _refitted(base, _free(base, known.used), Sample(tuple(known.used), 1 / known.shared), z)


def base_fit(split: Path, name: str) -> Fitted | None:
    """The description without what is concealed, refitted to the hammer test of a case; of two starts, the described
    numbers and the true ones, the better."""
    answer = read(split / "answers" / f"{name}.json")
    found = _posed(split, name, {**answer, "effects": []})
    if found is None:
        return None
    base, _, known, z = found
    free, sample = _free(base, known.used), Sample(tuple(known.used), 1 / known.shared)
    few = sample.thin(FEW_LINES)
    ends = [
        descend(base, NONE, free, few, start, logarithmic=rounds, tempered=4, linear=ITERATIONS, tolerance=GAIN)
        for start, rounds in ((z, 0), (np.zeros(len(z)), 10))
    ]
    return _refitted(base, free, sample, min(ends, key=lambda end: end.cost).z)


def kept_recordings(split: Path, name: str) -> list[Recorded]:
    """What was kept aside of the hammer test of a case."""
    found = _posed(split, name, {**read(split / "answers" / f"{name}.json"), "effects": []})
    return [] if found is None else found[2].kept


def _free(base: Robot, used: Sequence[Recorded]) -> Parameters:
    return free_parameters(base, dict.fromkeys(r.setup.name for r in used), used[0].setup.response.label)


def _refitted(base: Robot, free: Parameters, sample: Sample, z: FloatArray) -> Fitted:
    return descend(base, NONE, free, sample, z, tempered=0, linear=ITERATIONS, tolerance=GAIN)


def _posed(split: Path, name: str, answer: dict[str, Any]) -> tuple[Robot, list[Entry], Triage, FloatArray] | None:
    """The described robot with what is concealed, laws of amplitude kept apart; what is fitted to; where from."""
    truth = answer["truth"]["campaign"]
    entries = described(answer["effects"], truth["chain"])
    if entries is None:
        return None
    source = split / "recordings" / name / "frf.h5"
    campaign = read_campaign(source)
    given = load_robot(campaign.robot or "kr90").without(answer["without"])
    laws = [entry for entry in entries if CATALOGUE[entry.effect].amplitude_law]
    given = given.model_copy(update={"physics": [*given.physics, *(e for e in entries if e not in laws)]})
    base, found = without_limits(given), triage(campaign, given, str(source), None)
    free = _free(base, found.used)
    return base, laws, found, free.coordinates(true_values(free, truth))
