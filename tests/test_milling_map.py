"""Maps: many postures at once against one at a time, blocks that are the same bits whoever computes them, bad input."""

import dataclasses

import numpy as np
import pytest

from twin.commands.map import make_map
from twin.errors import InputError
from twin.identify.damping_transfer import Miss, misses_of_frf, transfer
from twin.identify.posterior import Posterior, load_posterior, save_posterior
from twin.identify.uncertainty import interval
from twin.measure.campaign import Campaign, Channels, PostureFRF
from twin.milling import map as work
from twin.milling import stability
from twin.milling.cut import Cut
from twin.milling.ensemble import ensemble, quantile_of_safe
from twin.milling.postures import tips, without_fast
from twin.milling.tool_point import ToolModes, real_modes, tool_point
from twin.model.frf import frf
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.parameters import Parameter, Parameters
from twin.model.recorded import prepare
from twin.robot.description import Entry, load_robot
from twin.robot.mechanism import assemble

TOOL = {"teeth": 3, "overhang_m": 0.25, "direction": (1, 0, 0), "mass_kg": 20}
CUT = Cut(tool=TOOL, table_z_m=None, depth_max_m=0.02)


@pytest.fixture(scope="module")
def kr90():
    return load_robot("kr90")


@pytest.fixture(scope="module")
def sure(kr90):
    """A posterior of the springs and dampers of the KR90: 1 % and 30 %."""
    names = [f"joint{i}.{a}.{what}" for i in (1, 2, 3) for a in "zxy" for what in ("stiffness", "damping")]
    values = {e.site: e.values for e in kr90.physics if e.effect == "transverse_compliance"}
    values |= {f"joint{i + 1}.z": {"stiffness": a.stiffness, "damping": a.damping} for i, a in enumerate(kr90.axes)}
    items = []
    for name in names:
        site, _, what = name.rpartition(".")
        items.append(Parameter(name, "1", "spring", True, values[site][what], 1.0))
    information = np.diag([1e4 if name.endswith("stiffness") else 11.0 for name in names]) - np.eye(len(names))
    return Posterior(Parameters(tuple(items), np.eye(len(items))), np.zeros(len(items)), information)


def test_frfs_of_a_posture_held_out_say_how_far_its_damping_is_off(kr90, sure):
    """Joint 2 damps 1.5 times as much as the fitted robot has it: every mode's own miss, and a scatter that says so."""
    axes = [a.model_copy(update={"damping": a.damping * (1.5 if i == 1 else 1.0)}) for i, a in enumerate(kr90.axes)]
    struck, q, labels = kr90.model_copy(update={"axes": axes}), np.deg2rad([0, 70, -100]), ["21X+", "21Y+", "21Z+"]
    frequency, rng = np.arange(4, 60, 0.125), np.random.default_rng(0)
    there = Channels(tuple(labels), ("link3",) * 3, np.tile(kr90.flange.position, (3, 1)), np.eye(3))
    known = dataclasses.replace(sure, information=1e4 * sure.information)

    def misses(robot):
        H = frf(linearise(assemble(robot, q)), frequency, labels, labels)
        noise = 1e-3 * np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
        H = H + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
        coherence = np.abs(H) ** 2 / (np.abs(H) ** 2 + 2 * noise**2)
        posture = PostureFRF("p", np.rad2deg(q), "on", frequency, H, "accelerance", coherence, 1)
        return misses_of_frf(kr90, known, list(prepare(Campaign(there, there, {"p": posture}), kr90).values()))

    own, other = (modes(linearise(assemble(robot, q))) for robot in (kr90, struck))
    found = misses(struck)
    assert len(found) >= 3
    for miss in found:
        k, j = (int(np.argmin(np.abs(m.frequency_hz - miss.frequency_hz))) for m in (own, other))
        true = np.log(other.damping_percent[j] / own.damping_percent[k])
        # with coupling and gains free the miss is found to its own deviation
        assert miss.ln_ratio == pytest.approx(true, abs=0.005 + 3 * miss.measured_spread)
    assert transfer(found).scatter > 0.05
    assert transfer(misses(kr90)).scatter < 0.01


def test_many_postures_are_what_one_at_a_time_is(kr90):
    extra = [
        Entry(effect="structural_damping", site="joint1.z", loss_factor=0.02),
        Entry(effect="link_flexibility", site="link3.y", stiffness=1e7, damping=200),
        Entry(effect="servo_compliance", site="joint2", stiffness=3e7, damping=1e4),
    ]
    robot = kr90.model_copy(update={"physics": [*kr90.physics, *extra]})
    q = np.deg2rad([[0, 70, -100], [20, 100, -80.0]])
    many = tips(robot, q, CUT, "off")
    w = np.linspace(1, 400, 30)
    for k in range(2):
        one = tool_point(robot, q[k], "off", CUT)
        G, H = one.modes.receptance(w), many.modes.receptance(w[None])[k]
        assert np.linalg.norm(G - H) < 1e-8 * np.linalg.norm(G)
        np.testing.assert_allclose(one.position, many.position[k], atol=1e-12)


def test_fast_modes_become_static_compliance():
    all_of_them = real_modes([[10.0, 30e3]], [[1.0, 1.0]], [[[1.0, 0.5, 0.0], [400.0, 0.0, 300.0]]])
    slow = without_fast(all_of_them)
    w = np.linspace(1, 2000, 20)[None]
    G, H = slow.receptance(w), all_of_them.receptance(w)
    assert np.linalg.norm(G - H) < 1e-3 * np.linalg.norm(H)
    assert np.abs(slow.shape[0, 1]).max() == 0


def test_lobes_look_deep_enough(kr90):
    places = work.random_postures(kr90, CUT, 5, seed=3)
    seen = tips(kr90, places.q, CUT, "off")
    modes = seen.modes.turned(CUT.frame(seen.axis, places.feed))
    speeds = np.geomspace(1000, 6000, 6)
    depth = work.lobes(modes, CUT, speeds)
    for k in range(5):
        one = ToolModes(modes.pole[k], modes.shape[k])
        exact = np.minimum(stability.limits(one, CUT, speeds, CUT.depth_max_m).first(), CUT.depth_max_m)
        np.testing.assert_allclose(depth[k], exact, rtol=1e-3)


def test_blocks_are_the_same_bits_in_processes_again_and_over_dask(kr90, sure, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(work, "BLOCK", 20)
    places = work.random_postures(kr90, CUT, 50)
    drawn = ensemble(kr90, CUT, 5, posterior=sure)
    task = work.Task(kr90, CUT, places, drawn, 3000.0)
    alone = work.compute(task)
    spread = work.compute(task, processes=2, keep=tmp_path)
    (tmp_path / "block00001.npz").unlink()
    resumed = work.compute(task, keep=tmp_path)
    options = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(protocol="tcp", **options) as cluster:
        there = work.compute(task, scheduler=cluster.scheduler_address)
    for name, values in alone.items():
        for other in (spread, resumed, there):
            assert np.array_equal(values, other[name], equal_nan=True), name
    assert (alone["depth_closed_form_safe90_m"] < alone["depth_closed_form_m"]).mean() > 0.9


def test_a_free_turn_about_the_tool_is_swept_for_depth(monkeypatch):
    monkeypatch.setattr(work, "TURNS", 4)
    robot = load_robot("tests/data/arm6.urdf")
    soft = [a.model_copy(update={"stiffness": 1e5, "damping": 100.0}) for a in robot.axes]
    robot = robot.model_copy(update={"axes": soft})
    cut = Cut(tool={"overhang_m": 0.1}, table_z_m=None, depth_max_m=0.5)
    middle = np.array([0.3, 0.5, 0.4, 0.2, 0.9, 0.1])
    start = work.postures_at(middle[None], robot, cut)
    up = -tips(robot, middle[None], cut, "off").axis
    found = work.reach(robot, cut, start.target, axis=up, start=middle)
    assert found.reached[0]
    seen = tips(robot, np.vstack([found.q, middle]), cut, "off")
    np.testing.assert_allclose(seen.position[0], seen.position[1], atol=1e-5)
    np.testing.assert_allclose(seen.axis[0], seen.axis[1], atol=1e-5)


def test_draws_have_the_intervals_that_a_fit_reports():
    prior = Parameter("joint1.z.damping", "1", "spring", True, 20.0, 2.3)
    information = (1 - 1 / 2.3**2) * 2.3**2  # the data know it to a factor of e
    posterior = Posterior(Parameters((prior,), np.array([[2.3**2]])), np.array([-0.5]), np.array([[information]]))
    values = posterior.draw(3000, seed=1)[:, 0]
    low, high = interval(prior, -0.5 * 2.3, 1.0, -0.5 / 2.3, 1 / 2.3**2)
    assert (values < low).mean() == pytest.approx(0.05, abs=0.02)
    assert (values > high).mean() == pytest.approx(0.05, abs=0.02)


def test_a_posterior_reads_back(sure, tmp_path):
    save_posterior(tmp_path / "posterior.h5", sure)
    again = load_posterior(tmp_path / "posterior.h5")
    assert again.parameters.items == sure.parameters.items
    np.testing.assert_array_equal(again.draw(3), sure.draw(3))
    (tmp_path / "no.h5").write_text("x")
    with pytest.raises(InputError, match="not a posterior"):
        load_posterior(tmp_path / "no.h5")


def test_one_draw_in_ten_is_below_the_safe_depth():
    rng = np.random.default_rng(0)
    draws, later = rng.normal(size=(20, 4000)), rng.normal(size=4000)
    assert (later < quantile_of_safe(draws)).mean() == pytest.approx(0.1, abs=0.015)


def test_scatter_of_damping_is_found_beside_what_is_known():
    rng = np.random.default_rng(1)
    ratio = np.exp(rng.normal(scale=np.hypot(0.4, 0.2), size=4000))
    many = transfer([Miss("p", 10.0, 0.01 * r, 0.01, 0.12, 0.16) for r in ratio])
    assert many.scatter == pytest.approx(0.4, rel=0.1)
    exact = transfer([Miss("p", 10.0, 0.01, 0.01 * np.exp(0.02), 0.1, 0.1)] * 5)
    assert exact.scatter == 0.0
    assert transfer([]).factor90 > 2


def test_a_path_is_mapped_and_written(tmp_path):
    path = tmp_path / "part.nc"
    path.write_text("G21 G90\nG0 X-50 Y-50 Z10\nG1 Z0\nX50\nG1 Y50\nM30\n")
    found = make_map(
        CUT_FILE(tmp_path), path=path, place=(1.9, 0, 0.9), near_deg=(0, 70, -100), spindle_rpm=3000, spacing=0.05,
        out=tmp_path / "out",
    )  # fmt: skip
    assert len(found.places) == 6  # with the plunge
    assert {p.name for p in (tmp_path / "out").iterdir()} >= {
        "map.h5",
        "map.json",
        "map.rrd",
        "path.png",
        "workspace.png",
    }
    assert "line 5" in str(found) or "line 4" in str(found)


def CUT_FILE(folder):
    file = folder / "cut.yaml"
    file.write_text("tool: {teeth: 3, overhang_m: 0.25, direction: [1, 0, 0], mass_kg: 20}\n")
    return file


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"grid": (1, 1, 1), "box": (4, 5, 0, 1, 0, 1)}, "out of reach by"),
        ({"grid": (0, 1, 1)}, "expected three numbers above 0"),
        ({"posture_grid": (3, 3)}, "expected 3 numbers above 0"),
        ({"random": 5, "lobes": -1}, "--lobes"),
        ({"random": 5, "grid": (1, 1, 1)}, "expected one of"),
        ({"random": 2, "scheduler": "tcp://127.0.0.1:9"}, "no Dask scheduler answers|needs Dask"),
    ],
)
def test_bad_input_is_one_line(options, said):
    with pytest.raises(InputError, match=said) as caught:
        make_map(**options)
    assert "\n" not in str(caught.value)


def test_a_path_out_of_reach_or_below_the_table_names_its_line(tmp_path):
    path = tmp_path / "part.csv"
    path.write_text("x_m,y_m,z_m\n1.8,0,1\n1.8,0.1,1\n6,0,1\n")
    with pytest.raises(InputError, match=r"line 4: \(.*out of reach by"):
        make_map(CUT_FILE(tmp_path), path=path, near_deg=(0, 70, -100), spacing=10)
    path.write_text("x_m,y_m,z_m\n1.8,0,1\n1.8,0.1,-0.2\n")
    with pytest.raises(InputError, match=r"line 3: the tip is 0\.2 m below the table"):
        make_map(CUT_FILE(tmp_path), path=path, near_deg=(0, 70, -100), spacing=10)
