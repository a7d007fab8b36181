"""``import twin``: what it costs, what it offers, that objects do as paths do, and that the pages of the docs run."""

import ast
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import twin
from tools.truth.__main__ import main as truth
from twin.measure.uff import write_uff
from twin.physics import CATALOGUE

ROOT = Path(__file__).parents[1]
HEAVY = {"matplotlib", "mujoco", "numpy", "rerun", "rich", "scipy", "typer"}


def test_import_is_quick_and_loads_no_plot_viewer_or_command_line() -> None:
    code = (
        "import sys, time; start = time.process_time(); import twin; spent = time.process_time() - start;"
        f"print(spent); print(*(set(sys.modules) & {HEAVY!r}))"
    )
    printed = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    spent, loaded = printed.split("\n")[:2]
    assert float(spent) < 0.3
    assert not loaded


def test_computing_loads_no_plot_viewer_or_command_line() -> None:
    code = (
        "import sys, twin; twin.simulate([0, 70, -100]); twin.diagnose; twin.fit; twin.identify; twin.compare;"
        "print(*(set(sys.modules) & {'matplotlib', 'rerun', 'rich', 'typer', 'jinja2'}))"
    )
    printed = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert not printed.strip()


def test_every_name_is_there_and_is_the_one_that_type_checkers_see() -> None:
    assert set(twin.__all__) <= set(dir(twin))
    tree = ast.parse((ROOT / "twin" / "__init__.py").read_text())
    typed = {
        name.asname: (node.module, name.name)
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert {"__version__", *typed} == set(twin.__all__)
    for name, (module, inner) in typed.items():
        assert twin._HOME[name] == module
        assert getattr(twin, name) is getattr(sys.modules[module], inner)


def test_objects_print_as_a_few_lines(tmp_path: Path) -> None:
    """Arrays of a recording filled screens where a notebook showed it."""
    planned = twin.simulate([0, 70, -100], robot="kr90", hammer={"duration_s": 1}).campaign
    assert planned is not None
    assert "of kr90: 3 responses × 23 excitations\n  posture: q = 0, 70, -100; brakes on; accelerance;" in repr(planned)
    time = np.arange(5) / 100
    log = twin.MotionLog({"run1": twin.MotionRun("run1", time, np.zeros((5, 3)), 100.0)}, notes=("repaired",))
    assert repr(log) == "motion log motion log: 1 run\n  run1: 3 axes; 0.04 s at 100 Hz; position\n  repaired"
    head, *entries = str(twin.load_robot("kr90")).split("\n")
    assert head == "robot kr90: 3 axes; links of 984 kg in all"
    assert "  gravity_compensator at joint2" in entries


def test_rooms_of_a_command_s_name_do_not_hide_it() -> None:
    import twin.diagnose.verdict
    import twin.identify.rigid

    assert callable(twin.diagnose)
    assert callable(twin.identify)
    with pytest.raises(AttributeError, match="no attribute 'diagnosis'"):
        _ = twin.diagnosis


def with_three_points() -> twin.Robot:
    """kr90 hit at its accelerometers alone."""
    robot = twin.load_robot("kr90")
    points = [point for point in robot.test_points if point.label in robot.accelerometers]
    return robot.model_copy(update={"test_points": points})


@pytest.fixture(scope="module")
def struck() -> twin.Simulation:
    """A quick hammer test and a replay."""
    time = np.arange(0, 10, 0.004)
    position = np.deg2rad([0, 80, -100]) + 0.3 * np.sin(np.outer(time, [1.3, 1.9, 1.6]))
    path = twin.MotionLog({"path": twin.MotionRun("path", time, position, 250.0)})
    hammer = {"duration_s": 2, "hits": 2, "response_noise": 1e-3}
    return twin.simulate([0, 70, -100], robot=with_three_points(), hammer=hammer, trajectory=path, seed=1)


def test_results_print_themselves_show_as_tables_and_draw_their_figures(struck: twin.Simulation) -> None:
    robot = twin.load_robot("kr90")
    assert struck.campaign is not None
    analysis = twin.modal(struck.campaign, robot=robot, fmax=30)
    results = [
        struck,
        analysis,
        twin.fit(struck.campaign, robot=robot, starts=1),
        twin.identify(struck.log, robot=robot),
        twin.compare([struck.campaign, struck.log, analysis.table], robot=robot),
        twin.excite(robot, count=1, harmonics=1),
    ]
    for result in results:
        assert str(result).strip()
        assert result.origin["version"] == twin.__version__
        html = result._repr_html_()
        assert html.count("<table>") == len(result.tables()) > 0
        assert all(len(row) == len(table.header) for table in result.tables() for row in table.rows)
        figures = result.figures()
        assert figures
        assert all(figure.axes for figure in figures.values())


def test_objects_do_as_their_files_do(struck: twin.Simulation, tmp_path: Path) -> None:
    assert struck.campaign is not None
    twin.write_campaign(tmp_path / "frf.h5", struck.campaign)
    write_uff(tmp_path / "frf.unv", struck.campaign)
    twin.write_log(tmp_path / "log.h5", struck.log)
    for name, rtol in (("frf.h5", 0), ("frf.unv", 1e-5)):
        of_file, of_object = twin.modal(tmp_path / name, fmax=30), twin.modal(struck.campaign, fmax=30)
        pairs = zip(of_file.results["posture"].modes, of_object.results["posture"].modes, strict=True)
        assert all(np.isclose(a.frequency_hz, b.frequency_hz, rtol=rtol, atol=0) for a, b in pairs)
    read = twin.compare([twin.read_campaign(tmp_path / "frf.h5"), twin.read_log(tmp_path / "log.h5")], robot="kr90")
    assert list(twin.compare([tmp_path / "frf.h5", tmp_path / "log.h5"], robot="kr90").errors.values()) == list(
        read.errors.values()
    )
    robot = twin.load_robot("kr90")
    inputs = twin.compare(struck.campaign, robot=robot).origin["inputs"]
    assert set(inputs) == {struck.campaign.source, "kr90"}
    assert inputs == twin.compare(struck.campaign, robot=robot).origin["inputs"]


def test_a_table_of_modes_finds_the_robot_of_its_recording(struck: twin.Simulation, tmp_path: Path) -> None:
    robot = with_three_points().without(["transverse_compliance@joint1.x"])
    found = twin.simulate([0, 70, -100], robot=robot, hammer={"duration_s": 2}, out=tmp_path / "simulated")
    assert found.campaign is not None
    twin.modal(tmp_path / "simulated" / "hammer.h5", fmax=30, out=tmp_path / "deep" / "modal")
    table = twin.read_modal_table(tmp_path / "deep" / "modal" / "modes.yaml")
    assert table.robot == "../../simulated/robot.yaml"
    assert twin.compare(tmp_path / "deep" / "modal" / "modes.yaml").errors.popitem()[1] < 2e-3


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: twin.modal([]), "expected at least one"),
        (lambda: twin.fit("nowhere.h5"), "nowhere.h5: no such file"),
        (lambda: twin.identify(twin.MotionLog()), "no runs"),
        (lambda: twin.modal(twin.ModalTable({})), "no postures"),
        (lambda: twin.compare(["a.h5", "a.h5"]), "given twice"),
        (lambda: twin.simulate({"posture": {"q_deg": [0]}}), "expected 3 values"),
        (lambda: twin.excite("nobody"), "no such robot"),
    ],
)
def test_faults_of_the_input_are_told_in_one_line(call, line: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(twin.InputError, match=line) as error:
        call()
    assert "\n" not in str(error.value)


def test_what_is_no_recording_is_a_type_error() -> None:
    with pytest.raises(TypeError, match="found int"):
        twin.diagnose([1])


@pytest.mark.parametrize("page", ["api.md", "effects-of-your-own.md", "formats.md", "campaign.md"])
def test_the_pages_of_the_docs_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    known = dict(CATALOGUE)
    text = (ROOT / "docs" / page).read_text()
    names: dict[str, object] = {}
    try:
        for language, code in re.findall(r"^```(\w+)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            if language == "bash":
                for line in code.replace("\\\n", " ").splitlines():
                    words = shlex.split(line)
                    assert words[:3] == ["python", "-m", "tools.truth"]
                    assert truth(words[3:]) == 0
            elif language == "python":
                exec(compile(code, page, "exec"), names)
    finally:
        for name in CATALOGUE.keys() - known.keys():
            del CATALOGUE[name]
    assert "twin" in names
    if page == "api.md":
        first = re.search(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        assert first is not None
        assert len([line for line in first[1].splitlines() if line]) <= 5
        assert names["verdict"].word == "named"  # type: ignore[attr-defined]
