"""Foreign files are diagnosed: whatever wrote them, the answer is that of the recording.

The recording is of an arm of one axis, by the closed form of a rigid body on three springs and of a turning mass with
friction. The motion log is diagnosed by a description without the friction, the hammer test by the whole one.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_import import (
    LBF,
    LOGS,
    G,
    Recorded,
    mapped,
    matlab5_frfs,
    matlab_frfs,
    nodes,
    records,
    stance,
    universal,
)

import twin
from twin.commands.foreign import import_files
from twin.robot.description import Robot, parse_robot, save_robot

MASS, COM, INERTIA = 60.0, np.array([0.4, 0.1, 0.2]), np.array([5.0, 12.0, 9.0])
SPRINGS, DAMPERS = np.array([0.9e6, 3.0e6, 2.0e6]), np.array([400.0, 800.0, 900.0])  # about x, y, z
GEAR, ROTOR, VISCOUS, DRY = 100.0, 1e-3, 40.0, 30.0
SENSOR, STRUCK = np.array([0.8, 0.1, 0.3]), np.array([[0.8, 0.1, 0.3], [0.5, -0.3, 0.4]])
RATE, RECORD_S, PULSE_S = 1024.0, 1.5, 0.004


@pytest.fixture(scope="module")
def arm() -> Robot:
    links = [{"mass": MASS, "com": COM.tolist(), "inertia": [*INERTIA.tolist(), 0, 0, 0]}]
    limits = {"position": [-3, 3], "velocity": 3, "acceleration": 15}
    physics: list[dict[str, Any]] = [
        {"effect": "transverse_compliance", "site": f"joint1.{axis}", "stiffness": SPRINGS[k], "damping": DAMPERS[k]}
        for k, axis in enumerate("xy")
    ]
    physics += [
        {"effect": "viscous_friction", "site": "joint1", "coefficient": VISCOUS},
        {"effect": "coulomb_friction", "site": "joint1", "torque": DRY},
    ]
    return parse_robot(
        {
            "name": "arm", "gravity": [0, 0, 0], "links": links, "physics": physics,
            "axes": [{"stiffness": SPRINGS[2], "damping": DAMPERS[2], "limits": limits}],
            "drives": [{"gear_ratio": GEAR, "rotor_inertia": ROTOR}], "flange": {"position": [0.8, 0, 0]},
        }
    )  # fmt: skip


def about(points: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) that take a rotation about the joint's centre to the motion of points (n, 3)."""
    return np.array([np.cross(np.eye(3), p).T for p in points])


def dynamic(s: np.ndarray) -> np.ndarray:
    """s²M + sC + K of the body about the joint's centre, (nf, 3, 3)."""
    arm = about(COM[None])[0]
    inertia = np.diag(INERTIA) + MASS * arm.T @ arm
    return s[:, None, None] ** 2 * inertia + s[:, None, None] * np.diag(DAMPERS) + np.diag(SPRINGS)


def accelerance(s: np.ndarray) -> np.ndarray:
    """(nf, 3, 2): sensor along x, y, z; struck along y and along z."""
    struck = np.stack([about(STRUCK)[0][1], about(STRUCK)[1][2]])
    return np.asarray(s[:, None, None] ** 2 * (about(SENSOR[None])[0] @ np.linalg.solve(dynamic(s), struck.T)))


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    random = np.random.default_rng(5)
    time = np.arange(0, 10, 0.01)
    q, v, a = np.zeros((3, len(time)))
    for k in range(1, 6):
        w, phase = 2 * np.pi * 0.2 * k, random.uniform(0, 2 * np.pi)
        wave = 0.5 / k * np.exp(1j * (w * time + phase))
        q, v, a = q + wave.real, v + (1j * w * wave).real, a - (w**2 * wave).real
    inertia = INERTIA[2] + MASS * (COM[0] ** 2 + COM[1] ** 2) + ROTOR * GEAR**2
    torque = inertia * a + VISCOUS * v + DRY * np.sign(v) + random.normal(scale=2.0, size=len(time))

    frequency = np.arange(10.0, 90.0, 0.5)
    frf = accelerance(2j * np.pi * frequency)
    noise = 0.02 * np.abs(frf) + 5e-4
    scatter = (random.normal(size=frf.shape) + 1j * random.normal(size=frf.shape)) / np.sqrt(2 * 3)
    coherence = np.abs(frf) ** 2 / (np.abs(frf) ** 2 + noise**2)

    count, long = int(RATE * RECORD_S), int(RATE * 8)
    at = np.arange(long) / RATE - 0.1
    blow = 300 * np.where((at >= 0) & (at < PULSE_S), np.sin(np.pi * at / PULSE_S), 0)
    answer = np.fft.irfft(
        np.fft.rfft(blow)[:, None, None] * accelerance(2j * np.pi * np.fft.rfftfreq(long, 1 / RATE)), axis=0
    )
    force = np.tile(blow[:count], (2, 3, 1)) * random.uniform(0.8, 1.2, size=(2, 3, 1))
    response = answer[:count].transpose(2, 1, 0)[:, None] * force.max(axis=2)[:, :, None, None] / blow.max()
    response = response + random.normal(scale=2e-3, size=response.shape)

    sensors = [{"label": f"1{axis}+", "body": "link1", "position": SENSOR.tolist()} for axis in "XYZ"]
    points = [
        {"label": label, "body": "link1", "position": place.tolist()}
        for label, place in zip(("1Y+", "2Z+"), STRUCK, strict=True)
    ]
    return Recorded(
        time, q[:, None], torque[:, None], frequency, frf + scatter * noise, coherence, force, response, RATE, [0.0],
        points, sensors,
    )  # fmt: skip


@pytest.mark.parametrize("name", LOGS)
def test_the_friction_is_named_whatever_the_log_was_written_by(
    name: str, recorded: Recorded, arm: Robot, tmp_path: Path
) -> None:
    save_robot(tmp_path / "arm.yaml", arm)
    plan = LOGS[name](tmp_path / name, recorded)
    path = mapped(tmp_path, makes="motion-log", robot="arm.yaml", **plan)
    import_files([tmp_path / name], path, tmp_path / "log.h5")
    verdict = twin.diagnose(tmp_path / "log.h5", robot=arm.without(["coulomb_friction"]))
    assert verdict.word == "named"
    (found,) = verdict.missing
    assert found.first.key == "coulomb_friction@joint1"
    assert found.first.parameters["torque"]["value"] == pytest.approx(DRY, rel=0.05)


FRFS = {
    "58.unv": {"binary": False},
    "58b.unv": {"binary": True, "response": G, "force": LBF},
    "v73.mat": matlab_frfs,
    "v5.mat": matlab5_frfs,
    "wav": None,
    "tdms": None,
}


@pytest.mark.parametrize("name", FRFS)
def test_nothing_is_missing_whatever_the_hammer_test_was_written_by(
    name: str, recorded: Recorded, arm: Robot, tmp_path: Path
) -> None:
    save_robot(tmp_path / "arm.yaml", arm)
    files, how = [tmp_path / name], FRFS[name]
    if isinstance(how, dict):
        universal(files[0], recorded, **how)
        plan = {"postures": stance(recorded), "nodes": nodes(recorded)}
        plan["unit"] = "g/lbf" if how["binary"] else "(m/s²)/N"
    elif how is not None:
        plan = how(files[0], recorded)
    else:
        files, plan = records(tmp_path, name, recorded)
        plan |= {"record_s": RECORD_S - 0.05, "pretrigger_s": 0.05, "band_hz": [10, 90]}
    path = mapped(tmp_path, makes="frf-campaign", robot="arm.yaml", **plan)
    import_files(files, path, tmp_path / "campaign.h5")
    verdict = twin.diagnose(tmp_path / "campaign.h5", robot=arm)
    assert verdict.word == "adequate"
    assert verdict.findings[0].error["after"]["train"] < 0.03
