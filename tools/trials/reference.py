"""The true model refitted: the held-out error that an answer's is compared to.

What is concealed is put into the description as it truly is, everything is fitted as ``twin diagnose`` fits it, on the
postures it uses. A law of amplitude is held at its true numbers and stepped, after blows of their true length.

SPLIT/references/ID.json     the error, and the engine that fitted
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tools.trials.cases import SIZES, case
from tools.trials.store import engine_hash, read, write
from twin.commands.modal import read_recording
from twin.diagnose.blow import COARSE_HZ
from twin.diagnose.joint_laws import AMPLITUDE
from twin.diagnose.joint_reaction import Stepped, blows
from twin.diagnose.levels_finding import stepped_records
from twin.diagnose.objective import Sample
from twin.diagnose.records import frf_records
from twin.diagnose.refit import minimise
from twin.diagnose.search import converge
from twin.diagnose.struck import law_of
from twin.diagnose.triage import triage
from twin.identify.elastic import without_limits
from twin.identify.parameters import free_parameters
from twin.measure.campaign import FloatArray
from twin.physics import CATALOGUE
from twin.robot.description import Entry, load_robot

LINES, ITERATIONS = 30, 15
TEMPERS = (0.1, 0.03, 0.01)  # relative model error, on the way to none


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


def described(effects: Sequence[dict[str, Any]]) -> list[Entry] | None:
    """Entries of a description that are what is concealed; ``None`` where it holds what none can say: a link that bends
    as a beam, a cascade servo, a law outside the vocabulary."""
    found = []
    for e in effects:
        known = {p.name for p in CATALOGUE[e["effect"]].parameters} if e["effect"] in CATALOGUE else set()
        if not set(e["parameters"]) <= known:
            return None
        found.append(Entry(effect=e["effect"], site=e["site"], **e["parameters"]))
    return found


def held_out_error(split: Path, name: str) -> float | None:
    """Of the true model, refitted to the hammer test of a case; ``None`` where there is none, or no such model."""
    answer = read(split / "answers" / f"{name}.json")
    entries = described(answer["effects"])
    if answer["recording"] not in ("hammer", "levels") or entries is None:
        return None
    source = split / "recordings" / name / "frf.h5"
    campaign = read_recording([source])
    given = load_robot(campaign.robot or "kr90").without(answer["without"])
    laws = [entry for entry in entries if entry.effect in AMPLITUDE]
    given = given.model_copy(update={"physics": [*given.physics, *(e for e in entries if e not in laws)]})
    base, found = without_limits(given), triage(campaign, given, str(source), None)
    sample = Sample(tuple(found.used), 1 / found.shared)
    free = free_parameters(base, dict.fromkeys(r.setup.name for r in found.used), found.used[0].setup.response.label)
    search = converge(base, free, sample)
    records, errors = frf_records(base, search.base, search.base, found.used, found.kept)
    error: dict[str, float | None] = errors["after"]
    for law_entry in laws:
        drawn = case(answer["kind"], answer["recording"], answer["seed"], answer["number"], _sizes(split))
        assert drawn.campaign is not None
        how = {g: replace(b, pulse_s=drawn.campaign.test.pulse_s) for g, b in (blows(campaign) or {}).items()}
        law, sizes, _, plain = law_of(base.model_copy(update={"physics": [*base.physics, law_entry]}))
        stepped = Stepped(plain, free, sample, law=law, site=law_entry.site, blow=how, fixed=sizes)
        z = refitted(stepped, [np.zeros(len(free)), search.robust, search.base.z])
        robot = free.apply(plain, free.values(z))
        robot = robot.model_copy(update={"physics": [*robot.physics, law_entry]})
        fit = replace(search.base, z=z, values=free.values(z), robot=robot)
        _, error = stepped_records(records, stepped, fit, found.used, found.kept, how)
    return error["held_out"]


def refitted(objective: Stepped, starts: Sequence[FloatArray]) -> FloatArray:
    """Coordinates of the best fit from some starts, a law's numbers held."""
    few = replace(objective, sample=objective.sample.thin(LINES))
    ends = []
    for z in starts:
        for temper in TEMPERS:
            z = minimise(replace(few, temper=temper, rate_hz=COARSE_HZ), z, ITERATIONS, 0.5)[0]
        ends.append(minimise(replace(few, closely=True), z, ITERATIONS, 0.1)[:2])
    z = min(ends, key=lambda end: end[1])[0]
    return minimise(replace(objective, closely=True), z, 2 * ITERATIONS, 0.1)[0]


def _sizes(split: Path) -> tuple[float, float]:
    low, high = read(split / "answers" / "plan.json").get("sizes", SIZES)
    return low, high
