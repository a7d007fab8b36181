"""``twin modal --operational``: modes of a structure that runs, from its responses alone."""

import builtins
from pathlib import Path

import h5py
import numpy as np
import pytest
import pyuff
from scipy.signal import lfilter

from twin.measure.modal_table import read_modal_table
from twin.measure.shapes import mac

FREQUENCY, DAMPING = np.array([5.2, 9.1, 9.6, 17.0]), np.array([0.01, 0.015, 0.01, 0.02])
RATE, SECONDS, SENSORS = 64.0, 400, 6


def running(
    frequency: np.ndarray, damping: np.ndarray, rate: float, seconds: int, sensors: int, fading: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (nm, nr) and responses (nr, nt) without noise: each mode a recursion of one complex pole.

    Forces are white, or fade with frequency as those of wind where ``fading`` is near one.
    """
    rng = np.random.default_rng(3)
    shapes = rng.normal(size=(frequency.size, sensors))
    count, before = int(rate * seconds), 4000
    force = shapes @ lfilter([1], [1, -fading], rng.normal(size=(sensors, count + before)))
    pole = 2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2))
    modal = [np.imag(lfilter([1], [1, -np.exp(p / rate)], f))[before:] for p, f in zip(pole, force, strict=True)]
    return shapes, shapes.T @ np.array(modal)


def noisy(y: np.ndarray, share: float) -> np.ndarray:
    return y + share * y.std(axis=1, keepdims=True) * np.random.default_rng(4).normal(size=y.shape)


def responses() -> tuple[np.ndarray, np.ndarray]:
    shapes, y = running(FREQUENCY, DAMPING, RATE, SECONDS, SENSORS)
    return shapes, noisy(y, 0.02)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("running") / "running.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "frf-campaign", "version": 1})
        group = file.create_group("response")
        group["label"], group["body"] = [f"{n}Z+" for n in range(1, SENSORS + 1)], ["base"] * SENSORS
        group["position"] = np.column_stack([np.arange(SENSORS), np.arange(SENSORS) % 2, np.zeros(SENSORS)])
        group["direction"] = np.tile([0.0, 0.0, 1.0], (SENSORS, 1))
        running = file.create_group("postures/bridge/running")
        running["response"] = responses()[1]
        running.attrs["sample_rate_hz"] = RATE
    return path


def test_modes_of_a_running_structure_and_all_that_the_command_writes(twin, recording: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """All modes, no other, within four of their deviations; shapes are those of the truth."""
    pytest.importorskip("pyoma2")
    found = twin("modal", "--operational", recording, "--max-order", "24", "--json", "--out", tmp_path / "out")
    assert found.code == 0, found.err
    modes = found.json["postures"]["bridge"]["modes"]
    f, z, f_std, z_std = (
        np.array([m[k] for m in modes])
        for k in ("frequency_hz", "damping_percent", "frequency_std_hz", "damping_std_percent")
    )
    assert f.size == FREQUENCY.size
    assert np.all(np.abs(f - FREQUENCY) < 4 * f_std)
    assert np.all(np.abs(z - 100 * DAMPING) < 4 * z_std)
    assert np.all(f_std < 0.005 * f)
    table = read_modal_table(tmp_path / "out" / "modes.yaml").postures["bridge"].modes
    shapes = np.array([[mode.shape[f"{n}Z+"] for n in range(1, SENSORS + 1)] for mode in table])
    assert np.diag(mac(shapes, responses()[0].astype(complex))).min() > 0.98
    names = {path.name for path in (tmp_path / "out").iterdir()}
    kinds = ("modes.rrd", "modes.unv", "stabilisation.png", "indicators.png", "frf.png", "automac.png", "shapes.png")
    assert {"modal.html", "modes.yaml", "modal.json", *(f"bridge_{kind}" for kind in kinds)} <= names


def test_strong_low_modes_do_not_hide_weak_high_ones() -> None:
    """A record that shows five octaves, the lowest mode a thousand times as strong as the highest."""
    pytest.importorskip("pyoma2")
    from twin.measure.operational import Running, identify_running

    frequency, damping = np.array([1.5, 2.6, 9.0, 14.0, 31.0, 33.0, 58.0]), np.full(7, 0.01)
    shapes, y = running(frequency, damping, 300.0, 120, 8, fading=0.99)
    found = identify_running("mast", Running(np.zeros(0), noisy(y, 1e-4), 300.0), tuple("abcdefgh"), fmax=100.0)
    f = np.array([m.frequency_hz for m in found.modes])
    assert f.size == frequency.size, f
    assert np.all(np.abs(f - frequency) < 4 * np.array([m.frequency_std_hz for m in found.modes]))
    drawn = np.array([m.response_shape for m in found.modes])
    assert np.diag(mac(drawn, shapes.astype(complex))).min() > 0.95
    assert np.median(found.frac) > 0.99
    assert found.missed_hz is None


def test_universal_files_of_time_responses_say_the_same(tmp_path: Path, recording: Path) -> None:
    from twin.measure.operational import read_running

    y = responses()[1]
    path = tmp_path / "running.uff"
    file = pyuff.UFF(str(path))
    for n, record in enumerate(y, 1):
        file.write_sets(
            pyuff.prepare_58(
                func_type=1, rsp_node=n, rsp_dir=3, ref_node=0, ref_dir=0, x=np.arange(record.size) / RATE, data=record,
                id1="posture=bridge", binary=1, abscissa_spec_data_type=17, ordinate_spec_data_type=12,
                orddenom_spec_data_type=0, z_axis_axis_units_lab="NONE", abscissa_axis_units_lab="s",
                ordinate_axis_units_lab="m/s^2", orddenom_axis_units_lab="NONE",
            ),
            mode="add",
        )  # fmt: skip
    campaign, records = read_running(path)
    other, same = read_running(recording)
    assert campaign.response.label == other.response.label
    assert records["bridge"].sample_rate_hz == pytest.approx(RATE)
    np.testing.assert_allclose(records["bridge"].response, same["bridge"].response, rtol=1e-6)


def test_a_short_record_a_hammer_test_and_a_missing_package_are_one_line(  # type: ignore[no-untyped-def]
    twin, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    short = tmp_path / "short.h5"
    short.write_bytes(recording.read_bytes())
    with h5py.File(short, "r+") as file:
        y = file["postures/bridge/running/response"][:, :500]
        del file["postures/bridge/running/response"]
        file["postures/bridge/running/response"] = y
    found = twin("modal", "--operational", short)
    assert found.code == 2
    assert "running/response" in found.err
    assert "s or more" in found.err
    found = twin("modal", recording)
    assert found.code == 2
    assert "excitation" in found.err
    real = builtins.__import__

    def without(name: str, *rest: object, **more: object) -> object:
        if name.startswith("pyoma2"):
            raise ImportError(name)
        return real(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    found = twin("modal", "--operational", recording)
    assert found.code == 2
    assert "twin[operational]" in found.err
