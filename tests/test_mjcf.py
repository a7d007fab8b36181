"""The written MJCF: loads in plain MuJoCo, gives the same modes, rests where it is told to."""

import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import POSTURES

from twin.model.linear import linearise
from twin.model.modes import modes
from twin.robot.description import SHIPPED, Robot, load_robot, parse_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))


def plain_modes(path: Path) -> np.ndarray:
    """Poles of an MJCF file by MuJoCo alone: mass matrix and differences of forces."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        return data.qfrc_bias - data.qfrc_passive

    step, rest, nv = 1e-6 * np.eye(model.nv), np.zeros(model.nv), model.nv
    K = np.transpose([(force(e, rest) - force(-e, rest)) / 2e-6 for e in step])
    C = np.transpose([(force(rest, e) - force(rest, -e)) / 2e-6 for e in step])
    A = np.block([[np.zeros((nv, nv)), np.eye(nv)], [-np.linalg.solve(M, np.hstack([K, C]))]])
    pole = np.linalg.eigvals(A)
    pole = pole[pole.imag > 1e-6]
    return pole[np.argsort(np.abs(pole))]


@pytest.mark.parametrize("posture", POSTURES)
def test_written_xml_gives_the_same_modes_in_plain_mujoco(kr90: Robot, tmp_path: Path, posture: str) -> None:
    mechanism = assemble(kr90, kr90.angles(POSTURES[posture]))
    save_mjcf(tmp_path / "robot.xml", build_spec(mechanism))
    np.testing.assert_allclose(plain_modes(tmp_path / "robot.xml"), modes(linearise(mechanism)).pole, rtol=1e-7)


@pytest.mark.parametrize("drives", ["held", "servo"])
def test_commanded_posture_is_the_equilibrium(kr90: Robot, drives: str) -> None:
    """Stepped for a second from the written state nothing moves: gravity is in the springs and in the servo."""
    mechanism = assemble(kr90, kr90.angles(POSTURES["upright"]), drives=drives)  # type: ignore[arg-type]
    model = build_spec(mechanism, visual=False).compile()
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    start = data.qpos.copy()
    mujoco.mj_step(model, data, 1000)
    np.testing.assert_allclose(data.qpos, start, atol=1e-10)


def test_shipped_mjcf_is_what_the_description_gives(tmp_path: Path) -> None:
    from make_mjcf import make

    make(tmp_path / "kr90.xml")
    fresh, shipped = ((folder / "kr90.xml").read_text() for folder in (tmp_path, SHIPPED))
    without_paths = [re.sub(r'file="[^"]*"', "", text) for text in (fresh, shipped)]
    assert without_paths[0] == without_paths[1], "run python tools/make_mjcf.py"


def test_scene_loads_and_holds_meshes_for_every_link_and_motor() -> None:
    model = mujoco.MjModel.from_xml_path(str(SHIPPED / "scene.xml"))
    assert {model.mesh(k).name for k in range(model.nmesh)} >= {
        f"{part}{i}" for part in ("link", "motor") for i in (1, 2, 3)
    }


def test_what_mujoco_has_natively_is_written_natively(with_entry, milling: np.ndarray, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    def xml(effect: str, site: str, **values: object) -> str:
        robot = with_entry(effect, site, keep=("transverse_compliance",), **values)
        save_mjcf(tmp_path / "r.xml", build_spec(assemble(robot, milling, brakes="off", drives="servo"), visual=False))
        mujoco.MjModel.from_xml_path(str(tmp_path / "r.xml"))
        return (tmp_path / "r.xml").read_text()

    assert 'frictionloss="123"' in xml("coulomb_friction", "joint1", torque=123)
    assert 'damping="321"' in xml("viscous_friction", "joint1", coefficient=321)
    assert re.search(r"<fixed .*springyield", xml("hysteresis", "joint2.z", stiffness=[1e6], yield_torque=[50]))
    assert re.search(r'<fixed name="joint2.z.gap"', xml("backlash", "joint2.z", gap=1e-4))
    assert re.search(r'joint2.z" stiffness="6900000 0 4e\+12"', xml("hardening_stiffness", "joint2.z", cubic=4e12))
    for effect, values in {
        "torque_ripple": {"amplitude": 50, "order": 40, "phase": 0.2},
        "gravity_compensator": {"coefficients": [-100, 20, 3]},
        "stribeck_friction": {"static_excess": 20, "velocity": 0.05},
    }.items():
        assert "dcmotor" in xml(effect, "joint2", **values)
    assert "springref" in xml("cable_stiffness", "joint2", stiffness=100, rest=0.3)
    assert re.search(
        r'<fixed name="joint2.coupling1" armature="5"',
        xml("joint_coupling", "joint2", **{"from": "joint3", "ratio": 0.5, "inertia": 5}),
    )
    assert 'delay="0.002"' in xml("time_delay", "sensor:21X+", delay=0.002)
    assert '"link2.part1"' in xml(
        "attached_resonator", "link2", mass=5, frequency_hz=12, damping_ratio=0.02, axis="y", position=[0.5, 0, 0]
    )
    assert '"link3.tip"' in xml("link_flexibility", "link3.y", stiffness=1e6, damping=10)
    assert '"base.rx"' in xml("base_compliance", "base.rx", stiffness=1e7, damping=10)


def test_two_drives_that_turn_with_one_axis_are_two_tendons(kr90: Robot) -> None:
    """Found by a log of the six-axis robot: joint4 by joint5 and by joint6."""
    data = kr90.model_dump(mode="json")
    for number, drive in enumerate(("joint2", "joint3"), 1):
        coupling = {"effect": "joint_coupling", "site": "joint1", "from": drive, "ratio": 0.1, "inertia": 5.0 * number}
        data["physics"].append(coupling)
    model = build_spec(assemble(parse_robot(data), kr90.angles(POSTURES["upright"]), drives="servo")).compile()
    tendons = [model.tendon(f"joint1.coupling{number}").id for number in (1, 2)]
    assert model.tendon_armature[tendons].tolist() == [5, 10]


def test_a_plate_that_rounding_makes_impossible_is_written(kr90: Robot) -> None:
    """Found by fuzzing: the largest moment is the sum of the others, turned by a product; MuJoCo's own sum is less."""
    data = kr90.model_dump(mode="json")
    data["links"][0]["inertia"] = [4.0, 5.0, 1.0, 0.0, 0.1, 0.0]
    model = build_spec(assemble(parse_robot(data), kr90.angles(POSTURES["upright"]))).compile()
    assert sorted(model.body_inertia[model.body("link1").id]) == pytest.approx([0.99669, 4.00331, 5.0], rel=1e-4)


def test_model_names_do_not_depend_on_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_robot("kr90").name == "kr90"


def test_a_written_robot_is_lit_and_on_a_floor_that_touches_nothing(kr90: Robot, milling: np.ndarray) -> None:
    plain = build_spec(assemble(kr90, milling))
    scene = lit(plain)
    bare, shown = plain.compile(), scene.compile()
    assert (shown.nlight, bare.nlight) == (1, 0)
    floor = shown.geom("floor")
    assert (floor.contype[0], floor.conaffinity[0]) == (0, 0)
    np.testing.assert_array_equal(shown.body_mass, bare.body_mass)
    np.testing.assert_array_equal(shown.qpos_spring, bare.qpos_spring)
    assert shown.nq == bare.nq
    on_a_wall = kr90.model_copy(update={"gravity": [9.81, 0.0, 0.0]})
    assert "floor" not in [geom.name for geom in lit(build_spec(assemble(on_a_wall, milling))).geoms]
