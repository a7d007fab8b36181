"""The example is what its script makes, and the README's first screen is what the commands print."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from matplotlib.image import imread

from tools import make_arm, make_example, readme_example
from tools.truth.effects import parse
from twin import progress
from twin.commands.example import EXAMPLES
from twin.result import written


def contents(path: Path) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_the_shipped_example_is_what_its_script_makes(tmp_path: Path) -> None:
    make_example.make_campaign(tmp_path / "campaign.h5", parse(make_example.FAULT))
    make_example.make_log(tmp_path / "log.h5")
    for name in ("campaign.h5", "log.h5"):
        made, shipped = contents(tmp_path / name), contents(make_example.FOLDER / name)
        assert made.keys() == shipped.keys()
        for key, values in made.items():
            if values.dtype.kind in "fc":
                np.testing.assert_allclose(values, shipped[key], rtol=1e-4, atol=3e-4 * np.abs(values).max())
            else:
                assert values.tolist() == shipped[key].tolist()
    assert json.loads((tmp_path / "answer.json").read_text()) == json.loads(
        (make_example.FOLDER / "answer.json").read_text()
    )


def test_the_shipped_arm_is_what_its_script_makes(tmp_path: Path) -> None:
    make_arm.write(tmp_path)
    for made in tmp_path.iterdir():
        shipped = make_arm.FOLDER / made.name
        if made.suffix == ".csv":
            one, other = (np.loadtxt(path, skiprows=1) for path in (made, shipped))
            np.testing.assert_allclose(one, other, atol=2e-3)
        else:
            assert made.read_text() == shipped.read_text()


def test_the_examples_keep_the_wheel_small() -> None:
    assert sum(file.stat().st_size for file in EXAMPLES.rglob("*") if file.is_file()) < 3e6


@pytest.mark.slow
def test_the_first_screen_of_the_readme_is_what_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shown = readme_example.BLOCK.search(readme_example.README.read_text(encoding="utf-8"))
    assert shown is not None
    printed = readme_example.printed(tmp_path)
    number = re.compile(r"\d+(?:\.\d+)?(?:e[+-]\d+)?")
    assert number.sub("#", printed) == number.sub("#", shown[0]), "python -m tools.readme_example"
    for now, then in zip(number.findall(printed), number.findall(shown[0]), strict=True):
        assert float(now) == pytest.approx(float(then), rel=0.03, abs=0.02), "python -m tools.readme_example"
    (concealed,) = json.loads((tmp_path / "cell" / "answer.json").read_text())["concealed"]
    assert f"{concealed['effect']} at {concealed['site']}" in printed
    low, high = map(float, re.findall(r"stiffness .*90 %: (\S+) … (\S+)", printed)[0])
    assert low < concealed["stiffness"] < high
    drawn = imread(tmp_path / "out" / "campaign" / "overlay.png")
    shown_there = imread(readme_example.PICTURE)
    assert drawn.shape == shown_there.shape
    moved = np.mean(np.abs(drawn - shown_there).max(axis=2) > 0.2)  # a curve's edge may shift, a label may not
    assert moved < 0.01, "python -m tools.readme_example"


def test_quiet_says_one_line_and_verbose_names_every_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, twin: Callable[..., SimpleNamespace]
) -> None:
    monkeypatch.chdir(tmp_path)
    plain, quiet, loud = (twin(*how, "example") for how in ([], ["-q"], ["-v"]))
    assert quiet.out == plain.out.partition("\n")[0] + "\n"
    files = sorted(str(Path("cell") / file.name) for file in (tmp_path / "cell").glob("[!.]*"))
    assert sorted(loud.out.removeprefix(plain.out).splitlines()) == files
    both = twin("-q", "-v", "example")
    assert both.code == 2
    assert both.err.count("\n") == 1


def test_a_summary_names_what_is_opened_first() -> None:
    files = [*(f"out/{i}.png" for i in range(40)), "out/report.html", "out/robot.xml", "out/robot.yaml", "out/frf.h5"]
    assert written(files) == "wrote into out: report.html, robot.yaml, robot.xml, frf.h5 and 40 figures"
    files = [
        "out/meshes/link1.stl",
        "out/robot.yaml",
        "out/report.html",
        "out/robot.xml",
        "out/describe.json",
        "out/1.png",
    ]
    assert written(files) == "wrote into out: report.html, robot.yaml, robot.xml, describe.json and 2 more (1 figure)"


def test_nothing_to_do_shows_no_bar_of_nothing() -> None:
    with progress() as bars:
        bars("nothing", 0)(0)


def test_a_file_gets_a_line_of_progress_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter([0.0, 30.0, 61.0, 90.0, 200.0])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with progress() as bars:
        tick = bars("speeds", 40)
        for _ in range(4):
            tick(10)
    told = capsys.readouterr().err.splitlines()
    assert told == ["twin: speeds 20 of 40 after 61 s", "twin: speeds 40 of 40 after 200 s"]
