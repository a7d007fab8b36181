"""The example is what its script makes, and the README's first screen is what the commands print."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from tools import make_example, readme_example
from tools.truth.effects import parse


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
    assert sum(file.stat().st_size for file in make_example.FOLDER.iterdir()) < 3e6


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
