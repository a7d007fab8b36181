"""Record the cases of a split and seal their answers."""

import hashlib
import os
import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tools.trials.cases import RECORDINGS, SIZES, Campaign, Case, Motion, case, plan
from tools.trials.store import read, sha256, write
from tools.truth.effects import Effect
from tools.truth.motion import write_log
from tools.truth.recording import plain, streams, write_campaign

LINK_COUNTS, LINK_NOISE_RAD = 2**22, 5e-6  # of a second encoder: per turn, white
ATTEMPTS = 20
EDIT = Effect("payload", "flange", {"mass": 15.0, "com": [1.615, -0.041, 0.0]})
"""What is hung on robot and model in the edit test."""


def prepare(
    split: Path,
    count: int,
    seed: int | None,
    recordings: Sequence[str] = tuple(RECORDINGS),
    each: int = 0,
    sizes: tuple[float, float] = SIZES,
) -> list[tuple[str, str, str, int, int, tuple[float, float]]]:
    """(id, kind, recording, seed, number, sizes) of every case; drawn once, then read back."""
    path = split / "answers" / "plan.json"
    if not path.exists():
        secret = secrets.randbits(60) if seed is None else seed
        drawn = plan(count, secret, recordings, each)
        write(path, {"seed": secret, "cases": drawn, "sizes": sizes, "salt": secrets.token_hex(16)})
    content = read(path)
    return [
        (hashlib.sha256(f"{content['salt']}/{n}".encode()).hexdigest()[:12], *drawn, tuple(content.get("sizes", SIZES)))
        for n, drawn in enumerate(content["cases"])
    ]


def record(
    split: Path, name: str, kind: str, recording: str, seed: int, number: int, sizes: tuple[float, float] = SIZES
) -> dict[str, Any]:
    """Write one case unless it is there, and return its line of the manifest."""
    answer, room, edit = split / "answers" / f"{name}.json", split / "recordings" / name, split / "edit" / name
    if not answer.exists():
        found = _recorded(kind, recording, seed, number, sizes, room, edit)
        write(
            answer,
            {
                "kind": kind, "recording": recording, "seed": found.seed, "number": number, "overlap": found.overlap,
                "kept": found.kept,
                "effects": [
                    {"effect": e.kind, "site": e.site, "parameters": plain(e.parameters), "multiple": m}
                    for e, m in zip(found.effects, found.multiples, strict=True)
                ],
                "without": found.without, "circumstances": found.circumstances,
                "truth": {part: plain(getattr(found, part).truth) for part in ("campaign", "motion")
                          if getattr(found, part)},
            },
        )  # fmt: skip
    files = {path.name: sha256(path) for path in sorted(room.glob("*.h5"))}
    return {"id": name, "without": read(answer)["without"], "files": files, "answer": sha256(answer)}


def _recorded(
    kind: str, recording: str, seed: int, number: int, sizes: tuple[float, float], room: Path, edit: Path
) -> Case:
    """The case of the seed, written, or of the next seed where an effect drawn shows nowhere in what was to be
    recorded, or the truth code refuses the robot."""
    for later in range(ATTEMPTS):
        try:
            found = case(kind, recording, seed + later, number, sizes)  # type: ignore[arg-type]
            write_case(found, room)
            write_case(_edited(found), edit)
            return found
        except ValueError:  # of which the truth code's own is one, and NumPy's for a singular matrix
            if later == ATTEMPTS - 1:
                raise
    raise AssertionError


def _edited(found: Case) -> Case:
    """The robot with another load, recorded briefly and once."""
    if found.campaign:
        truth = replace(found.campaign.truth, effects=(*found.campaign.truth.effects, EDIT))
        brief = replace(found.campaign, truth=truth, postures=found.campaign.postures[:2])
        return replace(found, campaign=brief, motion=None)
    assert found.motion is not None
    truth = replace(found.motion.truth, effects=(*found.motion.truth.effects, EDIT))
    return replace(found, motion=replace(found.motion, truth=truth, runs=found.motion.runs[:1]))


def write_case(found: Case, room: Path) -> None:
    """Record a case into the folder `room`: frf.h5, log.h5 or both."""
    room.mkdir(parents=True, exist_ok=True)
    noise = streams(found.seed)[3]
    if found.campaign:
        _strike(found.campaign, found.seed, room / "frf.h5", noise)
    if found.motion:
        _move(found.motion, room / "log.h5", noise)


def _strike(campaign: Campaign, seed: int, path: Path, noise: np.random.Generator) -> None:
    """The FRFs at the points struck, as an analyser keeps them: time signals dropped, one bad channel now and then."""
    points, aside, whole = list(campaign.points), path.with_suffix(".part"), path.with_suffix(".whole")
    bad = np.random.default_rng([seed, 4])
    column = None if campaign.dead is None else points.index(campaign.dead)
    try:
        write_campaign(whole, campaign.truth, campaign.postures, campaign.test, noise)
        with h5py.File(whole) as source, h5py.File(aside, "w") as target:
            target.attrs.update(source.attrs)
            source.copy("response", target)
            for key, values in source["excitation"].items():
                target[f"excitation/{key}"] = values[()][points]
            for name, posture in source["postures"].items():
                group = target.create_group(f"postures/{name}")
                group.attrs.update(posture.attrs)
                group["frequency"] = posture["frequency"][()]
                frf, coherence = (posture[key][()][:, :, points] for key in ("frf", "coherence"))
                if column is not None:
                    shape, size = frf[:, :, column].shape, np.median(np.abs(frf))
                    frf[:, :, column] = size * (bad.normal(size=shape) + 1j * bad.normal(size=shape))
                    coherence[:, :, column] = bad.uniform(0, 0.3, shape)
                for key, values in (("frf", frf), ("coherence", coherence)):
                    group[key] = values
                    group[key].attrs.update(posture[key].attrs)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
        whole.unlink(missing_ok=True)


def _move(motion: Motion, path: Path, noise: np.random.Generator) -> None:
    """The log; a second encoder counts too."""
    aside = path.with_suffix(".part")
    try:
        write_log(aside, motion.truth, motion.runs, motion.log, noise)
        with h5py.File(aside, "r+") as file:
            for run in file["runs"].values():
                if "link_position" in run:
                    count = 2 * np.pi / LINK_COUNTS
                    link = run["link_position"][()]
                    seen = link + LINK_NOISE_RAD * noise.normal(size=link.shape)
                    run["link_position"][...] = np.round(seen / count) * count
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
