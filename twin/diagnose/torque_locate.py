"""Where the torque of a motion log is missed, without naming why: run, joint and band; state; reversals."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np

from twin.diagnose.records import LogRecord
from twin.diagnose.torque_search import Search
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import MotionLog, MotionRun
from twin.model.torque_base import Base, base_of
from twin.model.torque_laws import State, entry_torque
from twin.model.torque_rows import Bands, joint_run
from twin.model.torque_signal import Run, run_of
from twin.parallel import spread
from twin.physics import CATALOGUE

FLAT = 8  # a motion of 5 Hz sampled at 250 Hz leaves 1e-7 of itself
LONGEST_S, ALL_S = 60.0, 240.0  # of a run, and of all together, in which disturbances are looked for: they last
RESTLESS = 0.5  # of the power beyond noise that is left of a joint above the fit's band, all runs together


def spots(
    records: Sequence[LogRecord], source: str, stop_hz: float, count: int = 5, bands: int = 6
) -> list[dict[str, Any]]:
    """Where most of the refitted base model's residual is, beyond noise: run, joint, band, share of all.

    Args:
        records: beside the models; held-out runs are looked at too.
        source: the file, as given.
        stop_hz: of the low-pass.
    """
    edges = np.concatenate([[0.0], np.geomspace(stop_hz / 2 ** (bands - 1), stop_hz, bands)])
    found = []
    for record in records:
        rate = (len(record.time) - 1) / (record.time[-1] - record.time[0])
        rest = np.where(record.valid[:, None], record.measured - record.predicted["before"], 0.0)
        power = np.abs(np.fft.rfft(rest / np.maximum(record.noise, 1e-300), axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(rest), 1 / rate)
        for low, high in pairwise(edges):
            inside = (frequency >= low) & (frequency < high)
            expected = record.valid.mean() * (high - low) / stop_hz * len(rest) ** 2 / 2
            for joint in range(rest.shape[1]):
                energy = float(power[inside, joint].sum())
                found.append((max(energy - expected, 0.0), record.name, joint, float(low), float(high)))
    total = sum(item[0] for item in found)
    best = sorted(found, key=lambda item: -item[0])[:count]
    return [
        _spot(source, name, joint, low, high, float(energy / total))
        for energy, name, joint, low, high in best
        if energy > 0
    ]


def disturbances(
    log: MotionLog, search: Search, source: str, processes: int = 1, *, wide_hz: float = 40.0, excess: float = 3.0
) -> list[dict[str, Any]]:
    """Bands above the fit's in which one run is restless and another is not, where that is most of what a joint has.

    Friction that is not exactly as modelled, and small gear waves, differ from run to run, too; they are less. So does
    what noise of the encoders makes of the model's own torque: inertia follows the posture.
    The model has the answer's friction and loads, not its delays and gains: these act on every band alike.

    Args:
        log: as recorded; search: what was found; source: the file.
        processes: the work is spread over so many.
        wide_hz: up to which a disturbance is looked for.
        excess: times the power of the quietest run and of encoder noise in a band is restless.
    """
    count, places = 8, []  # bands
    runs = [run for run in log.runs.values() if run.torque is not None and run.sample_rate_hz >= 2.5 * wide_hz]
    if len(runs) < 2:
        return []
    system = search.system
    regressor = system.base.regressor
    below = system.base.runs[0].bands.fit[1]
    bands = Bands((0.9 * wide_hz, wide_hz), (1.2 * wide_hz, 1.5 * wide_hz))
    edges = np.linspace(below, 0.9 * wide_hz, count + 1)
    z = system.plain(search.after.z)
    entries = [e for e in system.entries(search.after.z) if not CATALOGUE[e.effect].records_torque]

    def state_of(run: MotionRun, changes: list[FloatArray] | None = None) -> tuple[Base, Run, State]:
        wide = run_of(regressor, joint_run(regressor.robot, run), bands)
        base = base_of(regressor, [wide], system.base.sliding, changes)
        known = np.zeros(len(base.parameters))
        known[: base.lasting] = z[: base.lasting]
        return base, base.runs[0], base.state(0, known)

    def in_bands(signal: FloatArray, rate_hz: float) -> FloatArray:
        """Power (bands, joints) per second of a signal (samples, joints)."""
        spectrum = np.abs(np.fft.rfft((signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None], axis=0)) ** 2
        frequency = np.fft.rfftfreq(len(signal), 1 / rate_hz)
        bins = [(frequency >= low) & (frequency < high) for low, high in pairwise(edges)]
        return np.array([spectrum[inside].sum(axis=0) / len(signal) ** 2 for inside in bins])

    def power(number: int) -> FloatArray:
        """Of what the model leaves of a run, and of what encoder noise makes of its torque: (2, bands, joints)."""
        run = runs[number]
        end = int(min(len(run.time), min(LONGEST_S, ALL_S / len(runs)) * run.sample_rate_hz))
        short = replace(
            run, time=run.time[:end], position=run.position[:end], torque=run.torque[:end],  # type: ignore[index]
            velocity=None, acceleration=None, link_position=None,
        )  # fmt: skip
        base, wide, state = state_of(short)
        shaken = replace(short, position=short.position + encoder_noise(short.position, number))
        changes = [columns for _, columns in wide.changes]  # noise of encoders moves them by next to nothing
        noise = in_bands((state_of(shaken, changes)[2].torque - state.torque)[wide.valid], wide.rate_hz)
        found = [entry_torque(wide, state, entry, entry.values) for entry in entries]
        rest = (wide.torque - state.torque)[wide.valid]
        for joint in range(rest.shape[1]):  # sizes again: the band is wider than that they were found in
            design = base.design(0, joint)
            columns = np.column_stack([design, *(torque[:, joint] for torque in found)])[wide.valid]
            ridge = np.diag([*np.full(design.shape[1], 0.1 * np.var(rest[:, joint])), *np.zeros(len(found))])
            ridge += 1e-9 * np.trace(columns.T @ columns) * np.eye(len(ridge))
            rest[:, joint] -= columns @ np.linalg.solve(columns.T @ columns + ridge, columns.T @ rest[:, joint])
        return np.array([in_bands(rest, wide.rate_hz), noise])

    P, noise = np.array(list(spread(power, len(runs), processes))).swapaxes(0, 1)  # runs, bands, joints
    expected = np.maximum(P.min(axis=0) + noise, 1e-300)
    beyond = np.maximum(P - expected, 0.0)
    total = float(P.sum())
    for k, run in enumerate(runs):
        for joint in range(P.shape[2]):
            loud = P[k, :, joint] > excess * expected[k, :, joint]
            if beyond[k, loud, joint].sum() > RESTLESS * beyond[:, :, joint].sum():
                first, last = np.flatnonzero(loud)[[0, -1]]
                share = float(P[k, loud, joint].sum() / total)
                places.append(_spot(source, run.name, joint, float(edges[first]), float(edges[last + 1]), share))
    return sorted(places, key=lambda spot: -spot["share"])


def encoder_noise(position: FloatArray, seed: int) -> FloatArray:
    """White noise (samples, joints) as large as the encoders' own, by differences of order ``FLAT``: no motion is in
    them."""
    size = np.diff(position, FLAT, axis=0).std(axis=0) / np.sqrt(comb(2 * FLAT, FLAT))
    return np.asarray(size * np.random.default_rng(seed).normal(size=position.shape))


def _spot(source: str, run: str, joint: int, low: float, high: float, share: float) -> dict[str, Any]:
    return {
        "recording": source, "posture": None, "run": run, "site": f"joint{joint + 1}",
        "band_hz": [round(low, 3), round(high, 3)], "channels": [], "share": share,
    }  # fmt: skip
