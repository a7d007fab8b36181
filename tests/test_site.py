"""The documentation: tutorials run as notebooks, formats name all that files hold, every effect has a page."""

import json
import os
import re
import sys
from pathlib import Path

import h5py
import nbclient
import nbformat
import numpy as np
import pytest

from tools import effect_pages, notebooks, site_hooks
from twin.cli import app
from twin.commands.posture_file import Hammer
from twin.identify.posterior import FILE
from twin.measure.campaign import Campaign, Channels, Hits, PostureFRF, write_campaign
from twin.measure.motion_log import SERIES, MotionLog, MotionRun, write_motion_log
from twin.physics import CATALOGUE

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


VERDICTS = {  # that a tutorial shows
    "tutorial-arm": ("named",),
    "tutorial-hits": ("named", "ambiguous"),
    "tutorial-log": ("named", "adequate"),
}


@pytest.mark.parametrize("page", notebooks.PAGES)
def test_a_notebook_is_its_page(page: str) -> None:
    path = notebooks.FOLDER / f"{page}.ipynb"
    assert path.read_text() == notebooks.notebook(page), "out of date: python -m tools.notebooks"


@pytest.mark.parametrize("page", [pytest.param(page, marks=pytest.mark.slow) for page in notebooks.PAGES])
def test_a_tutorial_runs_as_a_notebook_and_finds_what_was_concealed(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = notebooks.FOLDER / f"{page}.ipynb"
    command = tmp_path / "bin" / "twin"  # of this checkout
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m twin "$@"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(command.parent) + os.pathsep + os.environ["PATH"])
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    content = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(content, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    said = "".join(output.get("text", "") for cell in content.cells for output in cell.get("outputs", []))
    left_out = re.search(r'without\(\["(\S+)"\]', "\n".join(cell.source for cell in content.cells))
    (file,) = tmp_path.glob("*/answer.json")
    answer = json.loads(file.read_text())["concealed"][0]
    concealed = left_out[1] if left_out else f"{answer['effect']}@{answer['site']}"
    for verdict in VERDICTS[page]:
        assert f"{verdict}: " in said
    assert concealed.replace("@", " at ") in said


def h5_names(path: Path) -> set[str]:
    """Every dataset and attribute of a file, groups that bear a name of the user's aside."""
    names: set[str] = set()

    def visit(where: str, item: h5py.Group | h5py.Dataset) -> None:
        names.update(item.attrs)
        if isinstance(item, h5py.Dataset):
            names.add(where.rpartition("/")[2])

    with h5py.File(path) as file:
        visit("", file)
        file.visititems(visit)
    return names


def test_the_formats_page_names_all_that_files_hold(tmp_path: Path) -> None:
    page = set(re.findall(r"`(?:\w+/)?(\w+)(?:=\S*)?`", (DOCS / "formats.md").read_text()))
    one = Channels(("21Z+",), ("link3",), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    hits = Hits(np.tile(np.arange(8.0), (1, 2, 1)), np.ones((1, 2, 1, 8)), 100.0)
    line = np.ones((2, 1, 1))
    posture = PostureFRF(
        "p", np.zeros(3), "on", np.array([1.0, 2.0]), line.astype(complex), "accelerance", line, 5, 300.0, 1.0, hits,
        0.008, 1.0,
    )  # fmt: skip
    write_campaign(tmp_path / "campaign.h5", Campaign(one, one, {"p": posture}, "kr90"))
    series = {key: np.zeros((4, 1)) for key in SERIES}
    run = MotionRun("r", np.arange(4.0), sample_rate_hz=1.0, **series)
    write_motion_log(tmp_path / "log.h5", MotionLog({"r": run}, "kr90"))
    for name in ("campaign.h5", "log.h5"):
        assert h5_names(tmp_path / name) <= page
    assert {f"hammer.{field}" for field in Hammer.model_fields} <= set(
        re.findall(r"`([\w.]+)`", (DOCS / "formats.md").read_text())
    )
    assert FILE in (DOCS / "formats.md").read_text()


def test_every_effect_has_a_page_with_its_signature() -> None:
    drawn = {}
    for name, page, figures in effect_pages.pages():
        assert all(f"`{parameter.name}`" in page for parameter in CATALOGUE[name].parameters)
        drawn[name] = figures
        for figure in figures.values():
            upper = figure.axes[0]
            assert upper.get_ylabel()
            curves = {str(line.get_label()): np.asarray(line.get_ydata()) for line in upper.lines}
            shown = next(values for label, values in curves.items() if label != "without")
            assert np.abs(shown - curves["without"]).max() > 0, name
    assert [name for name, figures in drawn.items() if not figures] == []


def test_formulas_of_plain_text_are_set_and_code_is_left_alone() -> None:
    page = "<p>F_c of |H|²_rms, e^(−σ_w t), 1e-9 and 2.4e8 at 30 Hz</p><pre>F_c 1e-9</pre>"
    page += "<p><code>a_b --grid</code></p>"
    assert site_hooks.on_page_content(page) == (
        '<p>F<sub>c</sub> of |H<span class="whole">|²<sub>rms</sub></span>, '
        'e<sup class="whole">−σ<sub>w</sub> t</sup>, '
        "10<sup>−9</sup> and "
        "2.4\u00a0×\u00a010<sup>8</sup> at 30\u00a0Hz</p>"
        '<pre tabindex="0">F_c 1e-9</pre><p><code>a_b <span class="whole">--grid</span></code></p>'
    )


def test_a_signature_bears_the_name_that_python_users_call() -> None:
    page = '<h3 id="a.read_motion_log">twin.read_log</h3> <div class="language-python doc-signature highlight">'
    page += '<span class="nf">read_motion_log</span>'
    assert site_hooks.on_page_content(page) == page.replace('"nf">read_motion_log', '"nf">read_log')


def test_a_block_that_begins_with_a_command_is_called_a_shells() -> None:
    page = '<div class="language-text highlight"><pre><span></span><code>{}</code></pre></div>'
    for line in ("twin example", "pip install .", "$ twin simulate cell/milling.yaml"):
        assert 'class="language-bash highlight"' in site_hooks.on_page_content(page.format(line))
    assert 'class="language-text highlight"' in site_hooks.on_page_content(page.format("twins = 2"))


def test_examples_of_the_help_fit_a_terminal_of_80_columns() -> None:
    examples = [
        line
        for command in app.registered_commands
        for block in re.findall(r"```\w*\n(.*?)```", command.callback.__doc__ or "", re.DOTALL)
        for line in block.splitlines()
    ]
    assert len(examples) > 30
    assert [line for line in examples if len(line.removeprefix("    ")) > 76] == []


def test_pages_that_help_and_messages_name_are_where_the_command_says(capsys: pytest.CaptureFixture[str]) -> None:
    app(["--docs"], standalone_mode=False)
    folder = Path(capsys.readouterr().out.strip())
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "twin").rglob("*.py"))
    named = set(re.findall(r"docs/([\w-]+\.md)", sources))
    assert len(named) > 4
    assert [page for page in sorted(named) if not (folder / page).is_file()] == []
