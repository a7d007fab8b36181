"""The naive rule: of all effects, the one whose signature correlates best with the misfit of the model as described.

Nothing is refitted. The truth code is the model here, at the described values and with effects of ordinary size.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.signal import savgol_filter

from tools.trials.cases import OUTSIDE, SITES, Recording
from tools.trials.visible import STEP, scaled
from tools.truth.chain import Array, Chain, kr90
from tools.truth.effects import Effect, TruthError, draw
from tools.truth.motion import Log, Run, motor_torque
from tools.truth.recording import HAMMER, HammerTest, Posture, Truth, accelerance

POSTURES, THIN = 3, 4  # postures taken, and lines of which one is
RUNS, EVERY, SMOOTH = 2, 5, 51  # runs and samples of a log, and window of the derivatives
RIGID = {"viscous_friction": "viscous", "coulomb_friction": "coulomb", "gravity_compensator": "compensator"}


def best_correlated(room: Path, without: list[str]) -> str:
    """The hypothesis, EFFECT@SITE, of the case recorded in the folder `room`."""
    chain = described(without)
    found: dict[str, float] = {}
    for path in sorted(room.glob("*.h5")):
        with h5py.File(path) as file:
            rows = list(_struck(file, chain) if "postures" in file else _moved(file, chain))
        for name, cosine in rows:
            found[name] = max(found.get(name, 0.0), abs(cosine))
    return max(found, key=lambda name: found[name], default="none")


def described(without: list[str]) -> Chain:
    """The robot as described, without the entries that the command was told to leave out."""
    chain = kr90()
    for entry in without:
        kind, _, site = entry.partition("@")
        name = RIGID.get(kind, "stiffness")
        values = getattr(chain, name).copy()
        if name == "stiffness":
            values[int(site[5]) - 1, "zxy".index(site[-1])] = np.inf
        else:
            values[int(site[5]) - 1] = 0.0
        chain = replace(chain, **{name: values})
    return chain


def _hypotheses(recording: Recording, chain: Chain) -> Iterator[tuple[str, Effect]]:
    rng = np.random.default_rng(0)
    for kind, sites in SITES[recording].items():
        for site in sites:
            if kind not in OUTSIDE[recording]:
                yield f"{kind}@{site}", scaled(draw(Effect(kind, site), chain, rng, log=recording == "log"), STEP)


def _struck(file: h5py.File, chain: Chain) -> Iterator[tuple[str, float]]:
    groups = list(file["postures"].items())[:POSTURES]
    points = [[c.label for c in HAMMER].index(label.decode()) for label in file["excitation/label"][()]]
    frequency = groups[0][1]["frequency"][()]
    test = HammerTest(
        start_hz=float(frequency[0]), spacing_hz=float(frequency[1] - frequency[0]) * THIN,
        lines=len(frequency[::THIN]), window=float(groups[0][1].attrs.get("exponential_window_rate", 0.0)),
    )  # fmt: skip
    postures = tuple(Posture(name, tuple(g.attrs["q_deg"]), g.attrs.get("brakes")) for name, g in groups)
    seen = [g["frf"][()][::THIN] for _, g in groups]
    size = [np.abs(f).mean((0, 2), keepdims=True) for f in seen]

    def predicted(*effects: Effect) -> Array:
        frfs = accelerance(Truth(chain, effects, sag=False), postures, test)
        return _real([f[0, 0][:, :, points] / s for f, s in zip(frfs, size, strict=True)])

    base = predicted()
    misfit = _real([f / s for f, s in zip(seen, size, strict=True)]) - base
    for name, effect in _hypotheses("hammer", chain):
        try:
            yield name, _cosine(misfit, predicted(effect) - base)
        except (TruthError, ZeroDivisionError):
            continue  # a site that is rigid in this robot
    if any("peak_force_n" in g.attrs for g in file["postures"].values()):
        yield from _levels(file, chain)


def _levels(file: h5py.File, chain: Chain) -> Iterator[tuple[str, float]]:
    """Force levels that differ: the change of the FRFs against that by a softer spring of each joint.

    Every law of amplitude changes a spring first; of the three the most frequent, backlash, is answered.
    """
    groups = list(file["postures"].values())
    first = [g for g in groups if np.array_equal(g.attrs["q_deg"], groups[0].attrs["q_deg"])]
    low, high = first[0], first[-1]
    change = _real([high["frf"][()] - low["frf"][()]])
    points = [[c.label for c in HAMMER].index(label.decode()) for label in file["excitation/label"][()]]
    frequency = low["frequency"][()]
    test = HammerTest(
        start_hz=float(frequency[0]), spacing_hz=float(frequency[1] - frequency[0]), lines=len(frequency),
        window=float(low.attrs.get("exponential_window_rate", 0.0)),
    )  # fmt: skip
    postures = (Posture("one", tuple(low.attrs["q_deg"]), low.attrs.get("brakes")),)

    def predicted(stiffness: Array) -> Array:
        truth = Truth(replace(chain, stiffness=stiffness), sag=False)
        return _real([accelerance(truth, postures, test)[0][0, 0][:, :, points]])

    base = predicted(chain.stiffness)
    for i in range(chain.n):
        softer = chain.stiffness.copy()
        softer[i, 0] *= 1 - 1e-3
        yield f"backlash@joint{i + 1}.z", _cosine(change, predicted(softer) - base)


def _moved(file: h5py.File, chain: Chain) -> Iterator[tuple[str, float]]:
    log, parts, runs = Log(), [], []
    for name, run in list(file["runs"].items())[:RUNS]:
        time, position = run["time"][()], run["position"][()]
        step = float(time[1] - time[0])
        path = [savgol_filter(position, SMOOTH, 3, deriv=k, delta=step, axis=0)[::EVERY] for k in range(3)]
        runs.append(Run(name, lambda _, path=path: path, (time - time[0])[::EVERY], float(time[0])))  # type: ignore[misc]
        parts.append(savgol_filter(run["torque"][()], SMOOTH, 3, axis=0)[::EVERY])

    def predicted(*effects: Effect) -> Array:
        torque = [sum(motor_torque(Truth(chain, effects), run, log)[2].values()) for run in runs]
        return np.concatenate([np.ravel(t - np.mean(t, 0)) for t in torque])

    base = predicted()
    misfit = np.concatenate([np.ravel(t - t.mean(0)) for t in parts]) - base
    for name, effect in _hypotheses("log", chain):
        if effect.site != "log":  # a delay needs the trajectory itself
            yield name, _cosine(misfit, predicted(effect) - base)


def _real(parts: list[Any]) -> Array:
    return np.concatenate([np.asarray(p).ravel() for p in parts]).astype(complex).view(float)


def _cosine(a: Array, b: Array) -> float:
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0
