"""Record the cases of a split and seal their answers."""

import hashlib
import secrets
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tools.trials.cases import Case, case, plan
from tools.trials.store import read, sha256, write
from tools.truth.effects import Effect
from tools.truth.motion import write_log
from tools.truth.recording import plain, streams, write_campaign

BAD_CHANNELS = 0.15  # share of hammer tests with one blow point whose FRFs are noise
EDIT = Effect("payload", "flange", {"mass": 15.0, "com": [1.615, -0.041, 0.0]})
"""What is hung on robot and model in the edit test."""


def prepare(split: Path, count: int, seed: int | None) -> list[tuple[str, str, str, int, int]]:
    """(id, kind, recording, seed, number) of every case; drawn once, then read back."""
    path = split / "answers" / "plan.json"
    if not path.exists():
        secret = secrets.randbits(60) if seed is None else seed
        write(path, {"seed": secret, "cases": plan(count, secret), "salt": secrets.token_hex(16)})
    content = read(path)
    return [
        (hashlib.sha256(f"{content['salt']}/{n}".encode()).hexdigest()[:12], kind, recording, seed, n)
        for n, (kind, recording, seed) in enumerate(content["cases"])
    ]


def record(split: Path, name: str, kind: str, recording: str, seed: int, number: int) -> dict[str, Any]:
    """Write one case unless it is there, and return its line of the manifest."""
    answer, file, edited = (split / f"{room}/{name}.{end}" for room, end in
                            (("answers", "json"), ("recordings", "h5"), ("edit", "h5")))  # fmt: skip
    if not answer.exists():
        found = case(kind, recording, seed, number)  # type: ignore[arg-type]
        for path in (file, edited):
            path.parent.mkdir(parents=True, exist_ok=True)
        _write(found, file)
        other = replace(found.truth, effects=(*found.truth.effects, EDIT))
        _write(replace(found, truth=other, postures=found.postures[:3], runs=found.runs[:1]), edited)
        write(
            answer,
            {
                "kind": kind, "recording": recording, "seed": seed, "number": number,
                "effects": [
                    {"effect": e.kind, "site": e.site, "parameters": e.parameters, "multiple": m}
                    for e, m in zip(found.truth.effects, found.multiples, strict=True)
                ],
                "without": found.without, "truth": plain(found.truth),
            },
        )  # fmt: skip
    without = read(answer)["without"]
    return {"id": name, "without": without, "recording": sha256(file), "answer": sha256(answer)}


def _write(found: Case, path: Path) -> None:
    noise = streams(found.seed)[3]
    if found.log is not None:
        write_log(path, found.truth, found.runs, found.log, noise)
        return
    assert found.test is not None
    write_campaign(path, found.truth, found.postures, found.test, noise)
    bad = np.random.default_rng([found.seed, 3])
    if bad.random() < BAD_CHANNELS:
        with h5py.File(path, "r+") as file:
            column = int(bad.integers(len(file["excitation/label"])))
            for posture in file["postures"].values():
                frf = posture["frf"]
                shape, size = frf[:, :, column].shape, np.median(np.abs(frf[()]))
                frf[:, :, column] = size * (bad.normal(size=shape) + 1j * bad.normal(size=shape))
                posture["coherence"][:, :, column] = bad.uniform(0, 0.3, shape)
