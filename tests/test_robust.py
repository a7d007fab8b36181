"""The edges: what breaks a reader or a calculation ends in one line, and work that is stopped leaves nothing behind."""

import ctypes
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import h5py
import numpy as np
import pytest
import scipy.io.wavfile
from pydantic import ValidationError
from ruamel.yaml import YAML

from tools.fuzz import seeds
from tools.fuzz.__main__ import main as fuzz
from tools.large import hammer_test
from twin import effort
from twin.commands.example import EXAMPLES
from twin.commands.outputs import Outputs, exchange
from twin.diagnose.joint import Knowledge
from twin.diagnose.refit import Fitted
from twin.errors import InputError, NumericalError, Told, numbers_of
from twin.importing import matlab
from twin.importing.map import LogMap
from twin.measure import hdf5
from twin.measure.campaign import Hits, check_campaign, read_campaign, write_campaign
from twin.measure.modal_table import read_modal_table
from twin.measure.motion_log import MotionLog, MotionRun, write_motion_log
from twin.measure.recordings import read_recordings
from twin.measure.uff import Point, read_uff, write_uff
from twin.milling.cut import read_cut
from twin.milling.stability import collocate
from twin.milling.tool_point import with_tool
from twin.model.parameters import free_parameters
from twin.model.replay import replay
from twin.physics import CATALOGUE
from twin.ranges import ill_named
from twin.robot.datasheet import read_sheet, read_tools
from twin.robot.description import Robot, first_problem, parse_robot
from twin.robot.urdf import read_urdf
from twin.stopping import TIMED_OUT, Stopped, hold, stoppable
from twin.yamlfile import read_yaml

SLICE = 24  # cases; `python -m tools.fuzz` runs thousands

Twin = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def frf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("frf") / "frf.h5"
    write_campaign(path, hammer_test(1, lines=40, blows=1))
    return path


def test_a_slice_of_mutated_inputs_breaks_nothing(tmp_path: Path) -> None:
    code = subprocess.run(
        [sys.executable, "-m", "tools.fuzz", "--cases", str(SLICE), "--seed", "7", "--out", str(tmp_path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert code.returncode == 0, code.stdout[-3000:] + code.stderr[-3000:]


def test_the_corpus_is_taken_up_again_and_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = '{"number": %d, "kind": "%s", "command": ["fit", "x"], "change": "c", "code": 2, "seconds": 1, "said": ""}\n'
    (tmp_path / "seeds").mkdir()
    (tmp_path / "seeds" / "hammer.unv").touch()
    (tmp_path / "corpus-0.jsonl").write_text(line % (0, "refused") + line % (1, "hang"))
    assert fuzz(["--cases", "2", "--out", str(tmp_path)]) == 1
    assert "1 hang" in capsys.readouterr().out


@pytest.mark.parametrize(
    "formula",
    ["q9", "c1*sin", "c1/0", "(" * 2000 + "q1" + ")" * 2000, "c1*" + "-" * 3000 + "q1", "c2*q1", "c1*1e300", "q1.real"],
)
def test_formulas_outside_their_grammar_are_refused(formula: str) -> None:
    values = {"formula": formula, "coefficients": [1.0]}
    effect = CATALOGUE["discovered"]
    assert (effect.check(values) or effect.check_axes(values, 3) or "").startswith(("formula: ", "coefficients: "))


def test_formulas_of_the_grammar_pass() -> None:
    values = {"formula": "c1*abs(v1)*v1 + c2*sin(3*q2)/2 - load3**2 + sign(v1)*exp(-t)", "coefficients": [1.0, 2.0]}
    assert CATALOGUE["discovered"].check(values) is None
    assert CATALOGUE["discovered"].check_axes(values, 3) is None


@pytest.mark.parametrize(
    "text",
    [
        "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 30)),
        "a: &a [*a]\n",
        "a: " + "[" * 3000 + "]" * 3000,
        "a: " + "x" * 100_000,
    ],
    ids=["anchors", "itself", "brackets", "text"],
)
def test_yaml_that_would_fill_the_memory_is_refused_at_once(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    begin = time.process_time()
    with pytest.raises(InputError, match=r"a\.yaml"):
        read_yaml(tmp_path / "a.yaml")
    assert time.process_time() - begin < 3


@pytest.mark.parametrize("place", [("links", 0, "mass"), ("axes", 0, "stiffness"), ("axes", 1, "a")])
@pytest.mark.parametrize("value", [1e300, 1e-300])
def test_numbers_of_no_machine_are_refused(kr90: Robot, place: tuple[Any, ...], value: float) -> None:
    data: Any = kr90.model_dump(mode="json")
    holder = data
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    if place[-1] == "a" and value < 1:  # what rounding leaves of a zero
        Robot.model_validate(data)
        return
    with pytest.raises(ValueError, match=r"plausible|expected metres, up to 50"):
        Robot.model_validate(data)


def test_five_thousand_links_and_unknown_encodings_are_refused(tmp_path: Path, twin: Twin) -> None:
    for text in (
        "<robot name='r'>" + "".join(f"<link name='l{k}'/>" for k in range(5000)) + "</robot>",
        "<?xml version='1.0' encoding='nonsense-9'?><robot name='r'/>",
    ):
        (tmp_path / "r.urdf").write_text(text)
        with pytest.raises(InputError, match=r"r\.urdf"):
            read_urdf(tmp_path / "r.urdf")
        found = twin("describe", tmp_path / "r.urdf", "--json")
        assert (found.code, len(found.err.splitlines())) == (2, 1)


@pytest.mark.parametrize("made", ["huge", "empty", "itself"])
def test_data_sets_that_claim_the_impossible_are_refused(tmp_path: Path, twin: Twin, made: str) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.attrs.update({"format": "motion-log", "version": 1})
        run = file.create_group("runs/a")
        run.attrs["sample_rate_hz"] = 100.0
        run["time"] = np.arange(100) / 100
        if made == "huge":
            run.create_dataset("position", (10**12, 6), "f8", chunks=(1000, 6))
        else:
            run["position"] = h5py.Empty("f8") if made == "empty" else h5py.SoftLink("/runs/a/position")
    found = twin("compare", tmp_path / "log.h5", "--robot", "kr90", "--json")
    assert found.code == 2
    assert found.err.startswith(f"twin: {tmp_path / 'log.h5'}: runs/a/position: expected")
    assert len(found.err.splitlines()) == 1


@pytest.mark.parametrize(
    "options", [("--sample-rate-hz", "1e12"), ("--harmonics", "1000"), ("--sample-rate-hz", "nan")]
)
def test_requests_without_measure_are_refused(twin: Twin, options: tuple[str, str]) -> None:
    found = twin("excite", *options, "--json")
    assert found.code == 2
    assert found.err.startswith(f"twin: {options[0]}: ")
    assert len(found.err.splitlines()) == 1


def test_arguments_that_make_no_sense_get_one_line(twin: Twin) -> None:
    found = twin("excite", "--seed", "-1")
    assert found.code == 2
    assert found.err.startswith("twin: --seed: ")
    assert len(found.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (("modal", "frf.h5", "--fmin", "nan"), "--fmin: nan: expected Hz from 0 to 1e+08"),
        (("modal", "frf.h5", "--fmax", "-1"), "--fmax: -1: expected Hz"),
        (("modal", "frf.h5", "--max-order", "1"), "--max-order: 1: expected 2 to 500"),
        (("view", "gone.yaml", "--out", "gone.rrd"), "gone.yaml: no such file"),
        (("excite", "--robot", "."), ".: is a folder; expected a robot.yaml"),
        (("fit", "frf.h5", "-o", "robot.yaml"), "--out: robot.yaml: is named like a file; expected a folder"),
    ],
)
def test_a_wrong_option_is_named_with_what_was_given(
    twin: Twin, frf: Path, line: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(frf.parent)
    found = twin(*line)
    assert found.code == 2
    assert found.err.startswith(f"twin: {said}")
    assert len(found.err.splitlines()) == 1


@pytest.mark.parametrize("name", ["\u202egnillim", "a\u200bb", "milling\n", "\x85"])
def test_names_that_do_not_show_as_they_are_are_refused(name: str) -> None:
    assert "expected names of 1 to 100 characters" in str(ill_named(name))


def test_pipes_are_refused_before_they_are_waited_for(tmp_path: Path, twin: Twin) -> None:
    os.mkfifo(tmp_path / "log.h5")
    found = twin("compare", tmp_path / "log.h5")
    assert (found.code, found.err) == (2, f"twin: {tmp_path / 'log.h5'}: is a pipe or a device; expected a file\n")


def test_millimetres_taken_for_metres_are_told(tmp_path: Path, frf: Path, twin: Twin) -> None:
    campaign = read_campaign(frf)
    far = replace(campaign.excitation, position=1e3 * campaign.excitation.position)
    with pytest.raises(InputError, match="excitation/position: 1Z"):
        write_campaign(tmp_path / "mm.h5", replace(campaign, excitation=far))
    shutil.copy(frf, tmp_path / "mm.h5")
    with h5py.File(tmp_path / "mm.h5", "r+") as file:
        file["excitation/position"][:] = far.position
    found = twin("compare", tmp_path / "mm.h5", "--as-is")
    assert found.code == 2
    assert "mm.h5: excitation/position: 1Z+ is " in found.err
    assert "expected metres, up to 50" in found.err
    (tmp_path / "tool.yaml").write_text("name: spindle\nmass: 3\ncom: [0, 0, 120]\n")
    with pytest.raises(InputError, match=r"com\[2\]: expected metres"):
        read_tools(tmp_path / "tool.yaml")


def test_a_file_that_ends_its_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matlab, "_loaded", lambda path: os.kill(os.getpid(), signal.SIGKILL))
    with pytest.raises(InputError, match=r"a\.mat: cannot be read: the file is damaged"):
        matlab._variables(tmp_path / "a.mat")


@pytest.mark.parametrize("harm", [lambda: os.kill(os.getpid(), signal.SIGKILL), lambda: any(iter(int, 1))])
def test_a_recording_that_ends_or_hangs_its_reader_is_refused(
    tmp_path: Path, frf: Path, monkeypatch: pytest.MonkeyPatch, harm: Callable[[], Any]
) -> None:
    """As damaged HDF5 does inside its library, where no signal is heard."""
    file = tmp_path / "damaged.h5"
    shutil.copy(frf, file)
    monkeypatch.setattr(hdf5, "LOOKED_S", 0)
    monkeypatch.setattr(hdf5.h5py.h5o, "get_info", lambda place: harm())
    with pytest.raises(InputError, match=r"damaged\.h5: the file is damaged"):
        read_recordings([file])


def test_a_recording_read_in_a_thread_leaves_the_process_its_time(frf: Path) -> None:
    """The process of the caller was given seconds to live: a server or a notebook that diagnosed ended."""
    code = (
        "import resource, sys, threading, twin\n"
        "before = resource.getrlimit(resource.RLIMIT_CPU)\n"
        "thread = threading.Thread(target=twin.read_campaign, args=(sys.argv[1],))\n"
        "thread.start(); thread.join()\n"
        "assert resource.getrlimit(resource.RLIMIT_CPU) == before\n"
    )
    subprocess.run([sys.executable, "-c", code, str(frf)], check=True, capture_output=True)


def test_an_attribute_of_an_impossible_type_is_refused_by_name(tmp_path: Path) -> None:
    """Its datatype claims 3.6 GB for a character of 8 bits."""
    file = tmp_path / "a.h5"
    with h5py.File(file, "w") as made:
        made.attrs["format"] = "motion-log"
    of_eight_bits = b"\1\0\0\0\0\0\x08\0"
    assert file.read_bytes().count(of_eight_bits) == 1
    file.write_bytes(file.read_bytes().replace(of_eight_bits, b"\1\0\0\xd8\0\0\x08\0"))
    with pytest.raises(InputError, match=r"a\.h5: format: expected a number or text"):
        read_recordings([file])


def test_counts_of_hundreds_of_digits_are_refused(twin: Twin) -> None:
    found = twin("excite", "--count", "9" * 400)
    assert found.code == 2
    assert found.err.startswith("twin: --count: 9999")
    assert len(found.err) < 200


@pytest.mark.parametrize("kind", ["cut off", "next to nothing"])
def test_torque_that_tells_nothing_is_said_so(tmp_path: Path, twin: Twin, kind: str) -> None:
    time = np.arange(0, 12, 0.01)
    q = 0.3 * np.sin(2 * np.pi * np.outer(time, [0.2, 0.3, 0.25]))
    torque = 1e-300 * q if kind == "next to nothing" else np.sign(q)
    run = MotionRun("a", time, np.deg2rad([0, 70, -100]) + q, 100.0, torque=torque)
    write_motion_log(tmp_path / "log.h5", MotionLog({"a": run}, "kr90"))
    found = twin("compare", tmp_path / "log.h5", "--as-is")
    assert found.code == 2
    said = "saturated for 100%" if kind == "cut off" else "expected a plausible number [N·m], at least 1e-12, found 3"
    assert f"log.h5: runs/a/torque: {said}" in found.err


def test_a_signal_during_a_deletion_is_not_shown_as_a_fault(capfd: pytest.CaptureFixture[str]) -> None:
    class Deleted:
        def __del__(self) -> None:
            raise Stopped(TIMED_OUT)

    with stoppable():
        gone = Deleted()
        del gone
    assert capfd.readouterr().err == ""


def test_a_mode_that_swings_a_thousand_times_in_a_cut_is_refused() -> None:
    cut = read_cut(YAML(typ="safe").load(seeds.CUT))
    with pytest.raises(InputError, match=r"a mode swings \d+ times while a tooth cuts; expected a faster spindle"):
        collocate(cut, 1e5)


def test_a_log_that_its_model_misses_still_tells_something_of_links(kr90: Robot) -> None:
    """Of what it does not hold, as much of the prior is taken out again as was put in."""
    free = free_parameters(kr90)
    for misfit in (1.0, 4.0):
        values = free.values(np.zeros(len(free)))
        log = SimpleNamespace(parameters=free, values=values, covariance=misfit * free.covariance, misfit=misfit)
        log.z = np.zeros(len(free))
        known = Knowledge.of(cast(Fitted, log)).on(free, kr90)
        np.testing.assert_allclose(known.covariance, free.covariance, rtol=1e-6, atol=1e-12)


def test_numbers_that_break_a_calculation_name_their_source() -> None:
    said = r"frf\.h5: bent: the calculation broke down \(Singular matrix\)"
    with pytest.raises(NumericalError, match=said), numbers_of("frf.h5", "bent"):
        np.linalg.inv(np.zeros((2, 2)))


def test_a_full_disk_gets_one_line_that_names_the_folder(tmp_path: Path) -> None:
    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    (tmp_path / "bent.yaml").write_text("posture: {q_deg: [0, 70, -100]}\nhammer: false\n")
    line = [sys.executable, "-m", "twin", "simulate", str(tmp_path / "bent.yaml"), "-o", str(tmp_path / "out")]
    found = subprocess.run(line, capture_output=True, text=True, preexec_fn=small, check=False)
    assert (found.returncode, found.stderr) == (
        2,
        f"twin: --out: {tmp_path / 'out'}: cannot be written (File too large)\n",
    )
    assert [path.name for path in tmp_path.iterdir()] == ["bent.yaml"]


@pytest.mark.parametrize(("how", "code"), [("--timeout", 124), (signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stopped_work_ends_within_a_second_and_leaves_nothing(tmp_path: Path, how: Any, code: int) -> None:
    line = [sys.executable, "-m", "twin", "excite", "--count", "50", "-o", str(tmp_path / "out")]
    line += ["--timeout", "2.5"] if how == "--timeout" else []
    child = subprocess.Popen(line, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    begin = time.monotonic()
    if how != "--timeout":
        time.sleep(3)
        begin = time.monotonic()
        os.kill(child.pid, how)
    _, said = child.communicate(timeout=60)
    assert child.returncode == code
    assert said.strip().endswith("nothing was written")
    assert not list(tmp_path.iterdir())
    assert how == "--timeout" or time.monotonic() - begin < 3  # one second, on a machine with other work


def test_a_second_signal_is_no_other_end(capfd: pytest.CaptureFixture[str]) -> None:
    cleared = []

    def work() -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.1)  # the thread has read the first one
        finally:
            os.kill(os.getpid(), signal.SIGTERM)  # an impatient hand, or a shell that tells the whole group
            time.sleep(0.05)
            cleared.append(True)

    with pytest.raises(Stopped) as stopped, stoppable():
        work()
    assert cleared
    assert stopped.value.code == 143
    assert "Exception ignored" not in capfd.readouterr().err


OLD = "of the earlier run"


def simulate(folder: Path, *more: str, **how: Any) -> subprocess.CompletedProcess[str]:
    """``twin simulate`` of a posture without a hammer, into ``folder/out``."""
    (folder / "bent.yaml").write_text("posture: {q_deg: [0, 70, -100]}\nhammer: false\n")
    line = [sys.executable, "-m", "twin", "simulate", str(folder / "bent.yaml"), "-o", str(folder / "out"), *more]
    return subprocess.run(line, capture_output=True, text=True, check=False, **how)


def test_an_earlier_run_is_replaced_whole_and_the_users_own_files_stay(tmp_path: Path) -> None:
    with Outputs(tmp_path / "out", "fit") as name:
        for file in ("robot.yaml", "gone.csv"):
            name(file).write_text(OLD)
    (tmp_path / "out" / "sub").mkdir()
    (tmp_path / "out" / "sub" / "mine.txt").write_text("mine")
    with Outputs(tmp_path / "out", "modal") as name:
        name("modes.yaml").write_text("of another command")
    with Outputs(tmp_path / "out", "fit") as name:
        name("robot.yaml").write_text("new")
        assert (tmp_path / "out" / "robot.yaml").read_text() == OLD
        assert (tmp_path / "out" / "gone.csv").read_text() == OLD
    found = {
        str(p.relative_to(tmp_path / "out")): p.read_text() for p in (tmp_path / "out").rglob("[!.]*") if p.is_file()
    }
    assert found == {"robot.yaml": "new", "sub/mine.txt": "mine", "modes.yaml": "of another command"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_file_of_another_command_that_is_replaced_is_told(tmp_path: Path) -> None:
    """Two commands on one recording have one folder, and its robot.yaml is that of the last."""
    with Outputs(tmp_path / "out", "identify") as name:
        name("robot.yaml").write_text(OLD)
    with (
        pytest.warns(Told, match="robot.yaml of `twin identify`: replaced"),
        Outputs(tmp_path / "out", "diagnose") as name,
    ):
        name("robot.yaml").write_text("new")
    with warnings.catch_warnings():
        warnings.simplefilter("error", Told)
        with Outputs(tmp_path / "out", "diagnose") as name:
            name("robot.yaml").write_text("newer")


@pytest.mark.parametrize("swap", [True, False], ids=["exchange", "two renames"])
def test_folders_are_exchanged(tmp_path: Path, swap: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    if not swap:
        monkeypatch.setattr("sys.platform", "darwin")
    exchange(tmp_path / "a", tmp_path / "b")
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["a"]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
    assert len(list(tmp_path.iterdir())) == 2


def test_a_failed_run_leaves_the_earlier_one(tmp_path: Path) -> None:
    with Outputs(tmp_path / "out", "fit") as name:
        name("robot.yaml").write_text(OLD)

    def fail() -> None:
        with Outputs(tmp_path / "out", "fit") as name:
            name("robot.yaml").write_text("new")
            raise RuntimeError("half")

    with pytest.raises(RuntimeError, match="half"):
        fail()
    assert (tmp_path / "out" / "robot.yaml").read_text() == OLD
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(sys.platform != "linux", reason="folders are held by abstract sockets, which Linux has")
def test_two_runs_into_one_folder_get_one_line(tmp_path: Path) -> None:
    with stoppable():
        assert hold(str((tmp_path / "out").resolve()))
        found = simulate(tmp_path)
    assert (found.returncode, found.stderr.count("\n")) == (2, 1)
    assert found.stderr.startswith(f"twin: --out: {tmp_path / 'out'}: another run is writing there")
    assert simulate(tmp_path).returncode == 0  # the other has ended


def test_what_a_killed_run_left_is_cleared_by_the_next(tmp_path: Path) -> None:
    stale = tmp_path / ".out.abcd1234.writing"
    (stale / "half").mkdir(parents=True)
    assert simulate(tmp_path).returncode == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bent.yaml", "out"]


def _as_any_user() -> None:
    """Root may write anywhere: take that right (CAP_DAC_OVERRIDE, 1) from what is run next (PR_CAPBSET_DROP, 24)."""
    if sys.platform == "linux" and os.getuid() == 0:
        ctypes.CDLL(None).prctl(24, 1, 0, 0, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="its folders have no such modes")
def test_a_read_only_folder_gets_one_line(tmp_path: Path) -> None:
    (tmp_path / "bent.yaml").write_text("")
    tmp_path.chmod(0o500)
    line = [sys.executable, "-m", "twin", "example", "-o", str(tmp_path / "out")]
    found = subprocess.run(line, capture_output=True, text=True, check=False, preexec_fn=_as_any_user)
    tmp_path.chmod(0o700)
    assert (found.returncode, found.stderr.count("\n")) == (2, 1)
    assert "no permission" in found.stderr


def test_a_clock_set_back_is_of_no_consequence(tmp_path: Path) -> None:
    """What is there is told by names and locks, never by dates: an earlier run of the future is replaced as any."""
    assert simulate(tmp_path).returncode == 0
    first = {path.name for path in (tmp_path / "out").iterdir()}
    for path in [tmp_path / "out", *(tmp_path / "out").rglob("*")]:
        os.utime(path, (4e9, 4e9))
    assert simulate(tmp_path).returncode == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == first
    assert max(path.stat().st_mtime for path in (tmp_path / "out").rglob("*") if path.is_file()) < 4e9


@pytest.mark.parametrize("suffix", ["tdms", "wav", "mcap", "mat"])
def test_foreign_files_cut_short_are_refused(copies: Path, tmp_path: Path, suffix: str, twin: Twin) -> None:
    file = tmp_path / f"cut.{suffix}"
    whole = (tmp_path / ("blows.wav" if suffix == "wav" else f"foreign.{suffix}")).read_bytes()
    for short in (8, len(whole) // 2):
        file.write_bytes(whole[:-short])
        found = twin("import", file, "--map", tmp_path / f"{suffix}-map.yaml", "--json")
        assert (found.code, found.err.count("\n")) == (2, 1), found.err
        assert found.err.startswith(f"twin: {file}: ")


@pytest.mark.parametrize(
    ("mode", "field"),
    [
        ("{frequency_hz: 10, damping_percent: 5428}", "damping_percent"),
        ("{frequency_hz: 10, damping_percent: 1.0e-300}", "damping_percent"),
        ("{frequency_hz: 10, damping: 2}", "damping"),
        ("{frequency_hz: 4.1e+7}", "frequency_hz"),
    ],
)
def test_modes_that_are_none_and_fields_unknown_are_refused(tmp_path: Path, mode: str, field: str) -> None:
    (tmp_path / "modes.yaml").write_text(f"postures: {{a: {{q_deg: [0, 0, 0], modes: [{mode}]}}}}\n")
    with pytest.raises(InputError, match=rf"postures\.a\.modes\[0\]\.{field}: "):
        read_modal_table(tmp_path / "modes.yaml")


def test_a_joint_from_a_link_to_itself_and_speeds_of_no_machine_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.urdf").write_text(seeds.URDF.replace('<child link="upper"/>', '<child link="base"/>'))
    with pytest.raises(InputError, match="joint a1: expected two links"):
        read_urdf(tmp_path / "a.urdf")
    origin = '<origin xyz="0 0 0.3" rpy="0 0 0"/>'
    (tmp_path / "a.urdf").write_text(seeds.URDF.replace(origin, 2 * origin))
    with pytest.raises(InputError, match="joint a1: expected one <origin> in <joint>, found 2"):
        read_urdf(tmp_path / "a.urdf")
    (tmp_path / "sheet.yaml").write_text("max_speed: [1.2e+5, 120]\n")
    with pytest.raises(InputError, match="max_speed"):
        read_sheet(tmp_path / "sheet.yaml")


def test_a_long_wait_is_told_beforehand(
    twin: Callable[..., SimpleNamespace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = EXAMPLES / "cell" / "log.h5"
    assert "minutes" not in twin("identify", log, "--json").err
    monkeypatch.setitem(effort.SECONDS, ("identify", "motion-log"), 4e-3)
    found = twin("identify", log, "--json")
    assert found.code == 0
    assert found.err.startswith("twin: about 3 minutes for a recording of this size")
    assert effort.expected_s("identify", [tmp_path / "none.h5", Path(__file__)]) == 0
    test = [EXAMPLES / "cell" / "campaign.h5"]
    assert 0 < effort.expected_s("compare --as-is", test) < effort.expected_s("compare", test)
    six, three = tmp_path / "six.h5", tmp_path / "three.h5"
    for path, axes in ((six, 6), (three, 3)):
        with h5py.File(path, "w") as file:
            file.attrs["format"] = "frf-campaign"
            file.create_dataset("postures/p1/frf", (100, 3, 4), complex)
            file["postures/p1"].attrs["q_deg"] = np.zeros(axes)
    assert effort.expected_s("diagnose", [six]) == pytest.approx(4 * effort.expected_s("diagnose", [three]))


@pytest.mark.parametrize("option", [("--place-turn-deg", "-1e300"), ("--place", "0", "1e7", "0")])
def test_a_place_beyond_reason_is_refused(twin: Twin, option: tuple[str, ...]) -> None:
    found = twin("map", "--robot", "kr90", "--random", "1", *option)
    assert (found.code, found.err.count("\n")) == (2, 1)
    assert found.err.startswith(f"twin: {option[0]}: ")
    assert "expected up to " in found.err


def test_what_a_recording_says_twice_must_agree(tmp_path: Path, frf: Path) -> None:
    """Lines a millionth of a hertz apart from records of a second, blows sampled too slowly for their FRFs."""
    campaign = read_campaign(frf)
    posture = next(iter(campaign.postures.values()))
    lines, blows = posture.frf.shape[0], np.zeros((posture.frf.shape[2], 1, 64))
    force, response = blows.copy(), np.zeros((posture.frf.shape[2], 1, posture.frf.shape[1], 64))
    force[..., 3], response[..., 4], top = 1.0, 1.0, posture.frequency[-1]
    hits = Hits(force, response, 4 * top, 0.0, True)
    fine = 1e-6 * np.arange(1, lines + 1)
    for changed, problem in (
        (replace(posture, record_s=1.0, frequency=fine), "frequency: expected lines as far apart as records of 1 s"),
        (replace(posture, frequency=1e4 * posture.frequency), "frequency: expected lines up to 50000 Hz, found"),
        (replace(posture, hits=replace(hits, sample_rate_hz=top)), "hits: sample_rate_hz: expected twice the highest"),
        (replace(posture, hits=replace(hits, force=np.ones_like(force))), "hits/force: expected blows at every point"),
        (replace(posture, hits=replace(hits, response=0 * response)), "hits/response: expected motion after the blows"),
    ):
        with pytest.raises(InputError, match=problem):
            check_campaign("a.h5", replace(campaign, postures={"a": changed}))
    check_campaign("a.h5", replace(campaign, postures={"a": replace(posture, hits=hits)}))


def test_a_node_that_is_struck_has_a_place(tmp_path: Path, frf: Path) -> None:
    write_uff(tmp_path / "a.unv", read_campaign(frf))
    text = (tmp_path / "a.unv").read_text().splitlines(keepends=True)
    nodes = text.index(next(line for line in text if line.strip() == "15"))
    end = next(k for k in range(nodes, len(text)) if text[k].strip() == "-1")
    for first, last in ((nodes + 1, nodes + 2), (nodes - 1, end + 1)):  # a node of them; the whole set
        (tmp_path / "a.unv").write_text("".join(text[:first] + text[last:]))
        with pytest.raises(InputError, match=r"node 1: expected its coordinates in a data set of nodes"):
            read_uff(tmp_path / "a.unv")


@pytest.mark.parametrize(
    ("line", "change", "problem"),
    [
        ("   164", "", "data set 1: expected its type on the first line"),
        ("    15", "0", "data set 2: expected its type on the first line"),
        (
            "   1.00",
            "   1.00000000000000000D+02   1.0000000000000000D+00   1.0000000000000000D+00\n",
            "found code 1 with",
        ),
        ("brakes=", "averages=5 peak_force_n=100q\n", "expected numbers in the ID lines: .*100q"),
        ("q_deg=", "q_deg=1e12\n", "expected q_deg=.* as before in this posture, found 1e12"),
        ("         6", "         6       x01\n", r"data set \d+ from line \d+: its lines are not as type 58 lays down"),
    ],
)
def test_a_universal_file_whose_words_are_no_numbers_is_refused(
    tmp_path: Path, frf: Path, line: str, change: str, problem: str
) -> None:
    write_uff(tmp_path / "a.unv", read_campaign(frf))
    text = (tmp_path / "a.unv").read_text().splitlines(keepends=True)
    at = [n for n, one in enumerate(text) if one.startswith(line)][-1]
    (tmp_path / "a.unv").write_text("".join([*text[:at], change, *text[at + 1 :]]))
    with pytest.raises(InputError, match=problem):
        read_uff(tmp_path / "a.unv")


def test_a_map_and_a_universal_file_agree_on_where_a_node_is(tmp_path: Path, frf: Path) -> None:
    write_uff(tmp_path / "a.unv", read_campaign(frf))
    body = read_campaign(frf).excitation.body[0]
    assert body != "base"
    with pytest.raises(InputError, match=f"node 1: expected one body, found {body} in the file and base in the map"):
        read_uff(tmp_path / "a.unv", points={1: Point("base", np.zeros(3))})


def test_a_mode_told_twice_is_refused(tmp_path: Path) -> None:
    lines = [f"    - {{frequency_hz: {f}, damping_percent: 1}}" for f in (10, 12, 10)]
    (tmp_path / "modes.yaml").write_text("\n".join(["postures:", "  a:", "    q_deg: [0]", "    modes:", *lines]))
    with pytest.raises(InputError, match=r"modes\[2\]: expected every mode once"):
        read_modal_table(tmp_path / "modes.yaml")


def test_gears_and_tools_of_no_robot_and_names_that_cannot_be_shown_are_refused(tmp_path: Path, kr90: Robot) -> None:
    data = kr90.model_dump(mode="json")
    data["drives"][0]["gear_ratio"] *= 1e-6
    with pytest.raises(InputError, match=r"drives\[0\]\.gear_ratio: .* at least 0\.01"):
        parse_robot(data)
    data = kr90.model_dump(mode="json")
    data["axes"][1]["alpha_deg"] = 1e12
    with pytest.raises(InputError, match=r"axes\[1\]\.alpha_deg: .* 360"):
        parse_robot(data)
    data = kr90.model_dump(mode="json")
    data["test_points"][0]["position"] = [0.8, 0, 100]
    with pytest.raises(InputError, match=r"test_points\[0\]\.position\[2\]: expected metres"):
        parse_robot(data)
    for prior, fits in (("link0", False), ("joint9.z.stiffness", False), ("no_effect@*.stiffness", False),
                        ("joint*.damping", True), ("base_compliance@base.r*.stiffness", True)):  # fmt: skip
        some = kr90.model_dump(mode="json") | {"priors": [{"parameter": prior, "factor": 2.0}]}
        if fits:
            assert parse_robot(some).priors[0].parameter == prior
            continue
        with pytest.raises(InputError, match=r"priors\[0\]\.parameter: .* names no number"):
            parse_robot(some)
    with pytest.raises(InputError, match=r"tool\.mass_kg: expected kg, no more than the robot's links weigh"):
        with_tool(kr90, read_cut({"tool": {"mass_kg": 1900}}))
    (tmp_path / "tool.yaml").write_text('name: "\\a"\nmass: 3\ncom: [0, 0, 0.1]\n')
    with pytest.raises(InputError, match=r"name: expected names"):
        read_tools(tmp_path / "tool.yaml")


@pytest.mark.parametrize(
    ("place", "value", "problem"),
    [
        (("workspace",), {"x": [-3, 3], "y": [-1e12, 3], "z": [-2, 4]}, r"workspace\.y"),
        (("links", 1, "mass"), 1e-4, r"links\[1\].*inertia: expected that of 0.0001 kg within 50 m"),
        (("links", 1, "com"), [100, 0, 0], r"links\[1\].*com\[0\]: expected metres"),
        (("tolerances", "mass"), 1e12, r"tolerances\.mass"),
        (("name",), " ", r"name: expected a name"),
        (("priors",), [{"parameter": "joint*.z.stiffness", "factor": 2.0}] * 2, r"priors\[1\]\.parameter: .* twice"),
    ],
)
def test_what_no_robot_has_is_refused(kr90: Robot, place: tuple[Any, ...], value: Any, problem: str) -> None:
    data: Any = kr90.model_dump(mode="json")
    holder = data
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    with pytest.raises(InputError, match=problem):
        parse_robot(data)


def test_a_modal_table_is_diagnosed_within_limits(tmp_path: Path, twin: Twin) -> None:
    (tmp_path / "two.yaml").write_text(seeds.ROBOT)
    table = "robot: two.yaml\npostures: {a: {q_deg: [1.0e+7, 40], modes: [{frequency_hz: 41.7, damping_percent: 5}]}}\n"
    (tmp_path / "modes.yaml").write_text(table)
    found = twin("diagnose", tmp_path / "modes.yaml", "--json")
    assert found.code == 2
    assert "modes.yaml: postures.a: q_deg: expected degrees (m), up to 3600, found 1e+07" in found.err


def test_recordings_that_are_there_twice_are_refused(tmp_path: Path, frf: Path) -> None:
    campaign = read_campaign(frf)
    posture = next(iter(campaign.postures.values()))
    with pytest.raises(InputError, match=r"postures/b: expected every posture once, .* as 'a'"):
        check_campaign("a.h5", replace(campaign, postures={"a": posture, "b": replace(posture)}))
    other = replace(posture, peak_force_n=2 * (posture.peak_force_n or 1.0))
    check_campaign("a.h5", replace(campaign, postures={"a": posture, "b": other}))
    time = np.arange(0, 2, 0.01)
    run = MotionRun("a", time, np.sin(time)[:, None], 100.0, torque=np.cos(time)[:, None])
    write_motion_log(tmp_path / "log.h5", MotionLog({"a": run, "b": replace(run, name="b")}))
    with pytest.raises(InputError, match=r"runs/b: expected every run once, .* as 'a'"):
        read_recordings([tmp_path / "log.h5"])


@pytest.mark.parametrize(
    ("row", "problem"),
    [("1,2", "expected 3 numbers separated by commas, found '1,2'"), ("1,None,2", "found '1,None,2'")],
)
def test_a_row_that_is_none_is_told_by_its_line(tmp_path: Path, row: str, problem: str) -> None:
    (tmp_path / "log.csv").write_text(f"time,q1,tau1\n0,0,0\n\n{row}\n")
    with pytest.raises(InputError, match=f"log.csv: line 4: .*{problem}"):
        read_recordings([tmp_path / "log.csv"])


@pytest.mark.parametrize(
    ("cut", "problem"),
    [
        ({"immersion": 1e-306}, "immersion: input should be greater than or equal to 0.0001"),
        ({"feed_per_tooth_m": 1e-300}, "feed_per_tooth_m: input should be greater"),
        ({"tool": {"teeth": "x" * 5000}}, r"tool\.teeth: .{1,99}$"),
    ],
)
def test_a_cut_that_removes_nothing_is_refused_and_long_words_are_cut(cut: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        read_cut(cut)


def test_a_line_names_fields_and_no_types_and_shows_no_word_of_thousands() -> None:
    for value, problem in (
        ({"channels": 1e-9}, r"position\.channels: expected a word"),
        ({"channels": "q", "factor": 1e300}, r"position\.factor: expected a plausible number"),
    ):
        with pytest.raises(ValidationError) as caught:
            LogMap.model_validate({"makes": "motion-log", "position": value, "torque": {"channels": "t"}})
        assert re.match(problem, ": ".join(first_problem(caught.value)))
    assert len(str(InputError("a.yaml", "name", f"expected a name, found {'x' * 5000}"))) < 120


def test_a_coupled_drive_without_inertia_is_named_in_a_replay(tmp_path: Path) -> None:
    robot = parse_robot(YAML(typ="safe", pure=True).load(seeds.ROBOT.replace("2.0e-3, coupling", "0, coupling")))
    time = np.arange(0, 2, 0.01)
    run = MotionRun("a", time, 0.1 * np.sin(np.column_stack([time, time])), 100.0)
    with pytest.raises(InputError, match=r"drives\[1\]\.rotor_inertia: an elastic axis needs"):
        replay(robot, run)


def test_records_of_no_hammer_and_speeds_of_no_gear_are_refused(copies: Path, tmp_path: Path, twin: Twin) -> None:
    rate, record = scipy.io.wavfile.read(tmp_path / "blows.wav")
    for channel, unit in ((0, "N"), (1, "m/s²")):
        spoilt = record.copy()
        spoilt[700, channel] = 1e30
        scipy.io.wavfile.write(tmp_path / "spoilt.wav", rate, spoilt)
        found = twin("import", tmp_path / "spoilt.wav", "--map", tmp_path / "wav-map.yaml", "--json")
        assert found.code == 2
        assert f"channel.{channel + 1}: expected {unit} up to" in found.err
    assert twin("import", tmp_path / "blows.wav", "--map", tmp_path / "wav-map.yaml", "--json").code == 0
    (tmp_path / "sheet.yaml").write_text("max_speed: [1.2e-4, 120]\n")
    found = twin("describe", tmp_path / "arm.urdf", "--sheet", tmp_path / "sheet.yaml", "--json")
    assert (found.code, found.err.count("\n")) == (2, 1)
    assert "arm as the sheet and scaling laws complete it: drives[0].gear_ratio: " in found.err


@pytest.mark.parametrize("command", ["import", "view", "example"])
def test_a_file_that_meets_a_full_disk_gets_one_line_and_leaves_nothing(
    copies: Path, tmp_path: Path, command: str
) -> None:
    """The libraries of HDF5 and of recordings ended the process over it, or waited for ever."""
    before = sorted(path.name for path in tmp_path.iterdir())
    line = {
        "import": ["import", "foreign.csv", "--map", "csv-map.yaml", "-o", "a.h5"],
        "view": ["view", "two.yaml", "-o", "a.rrd"],
        "example": ["example", "arm", "-o", "arm"],
    }[command]

    def small() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    found = subprocess.run(
        [sys.executable, "-m", "twin", *line],
        capture_output=True, text=True, preexec_fn=small, check=False, cwd=tmp_path, timeout=120,
    )  # fmt: skip
    assert (found.returncode, found.stderr.count("\n")) == (2, 1), found.stderr
    assert "File too large" in found.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before
