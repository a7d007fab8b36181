"""``twin modal`` as a user runs it, on recordings of the independent truth code."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from test_kr90 import TABLE_7

from tools.truth.__main__ import main as truth
from twin.measure.campaign import read_campaign
from twin.measure.modal_table import read_modal_table
from twin.measure.uff import write_uff


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("truth") / "measured.h5"
    options = ["--nominal", "--seed", "4", "--spacing-hz", "0.25", "--lines", "140", "--robot", "kr90"]
    assert truth(["campaign", "--out", str(path), *options]) == 0
    return path


def test_table_7_from_another_code_s_recording(twin, recording: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "out"
    found = twin("modal", recording, "--fmax", "30", "--json", "--out", out)
    assert found.code == 0, found.err
    for name, (frequency, damping) in TABLE_7.items():
        modes = found.json["postures"][name]["modes"]
        np.testing.assert_allclose([m["frequency_hz"] for m in modes], frequency, atol=0.02)
        np.testing.assert_allclose([m["damping_percent"] for m in modes], damping, atol=0.05)
        assert all(0 < m["frequency_std_hz"] < 0.05 and 0 < m["damping_std_percent"] < 0.2 for m in modes)
        assert {
            f"{name}_{kind}" for kind in ("modes.unv", "shapes.png", "modes.rrd", "stabilisation.png", "frf.png")
        } <= {path.name for path in out.iterdir()}
    table = read_modal_table(out / "modes.yaml")
    assert len(table.postures["milling"].modes) == 4


def test_universal_files_give_the_same_modes(twin, recording: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    campaign = read_campaign(recording)
    write_uff(tmp_path / "measured.unv", campaign)
    one, other = (twin("modal", file, "--fmax", "30", "--json").json for file in (recording, tmp_path / "measured.unv"))
    for name in TABLE_7:
        frequencies = [[m["frequency_hz"] for m in found["postures"][name]["modes"]] for found in (one, other)]
        np.testing.assert_allclose(*frequencies, rtol=1e-5)


def broken(recording: Path, path: Path, change) -> Path:  # type: ignore[no-untyped-def]
    path.write_bytes(recording.read_bytes())
    with h5py.File(path, "r+") as file:
        change(file)
    return path


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda f: f["postures/milling/frf"].attrs.__setitem__("unit", "g/N"), "unit"),
        (lambda f: f["postures/milling/frf"].attrs.__setitem__("quantity", "compliance"), "quantity"),
        (lambda f: f["postures/milling/frf"].__setitem__((3, 0, 0), np.nan), "frf"),
        (lambda f: f["postures/milling/frequency"].__setitem__(5, 3.0), "frequency"),
        (lambda f: f["postures/milling/coherence"].__setitem__((2, 0, 0), 1.5), "coherence"),
        (lambda f: f.attrs.__setitem__("format", "frf-holiday"), "format"),
        (lambda f: f.__delitem__("postures/milling/frf"), "frf"),
    ],
)
def test_recordings_that_break_the_contract_get_one_line(
    twin, recording: Path, tmp_path: Path, change, line: str
) -> None:  # type: ignore[no-untyped-def]
    found = twin("modal", broken(recording, tmp_path / "bad.h5", change), "--out", tmp_path / "out")
    assert found.code == 2
    assert found.err.count("\n") == 1
    assert line in found.err
    assert not (tmp_path / "out").exists()
