"""Figures and table of a modal test show what was identified, no more and no less."""

from pathlib import Path

import numpy as np

from twin.measure.campaign import PostureFRF
from twin.measure.modal import ModalResult, identify_modes
from twin.measure.modal_table import ModalTable, read_modal_table, write_modal_table
from twin.report.modal_figures import drawn, mac_figure, stabilisation_figure

LABELS = (("21X+", "21Y+", "21Z+", "4Y-"), ("21X+",))


def result(name: str, shift: float = 1.0) -> ModalResult:
    rng = np.random.default_rng(0)
    frequency, f, phi = np.arange(1, 121) * 0.25, np.array([10.0, 19.0]) * shift, rng.normal(size=(4, 2))
    s, w = 2j * np.pi * frequency[:, None], 2 * np.pi * f
    frf = np.einsum("or,ir,fr->foi", phi, phi[:1], s**2 / (s**2 + 0.02 * w * s + w**2))
    return identify_modes(
        PostureFRF(name, np.array([0.0, 70.0, -100.0]), None, frequency, frf, "accelerance"), labels=LABELS
    )


def test_the_chart_marks_every_pole_in_the_band_with_its_symbol() -> None:
    one = result("milling")
    figure = stabilisation_figure(one)
    drawn = sum(line.get_xdata().size for line in figure.axes[1].lines)
    low, high = one.frequency[[0, -1]]
    there = sum(((p.frequency >= low) & (p.frequency <= high)).sum() for chart in one.charts for p in chart.poles)
    assert drawn == there > 0
    assert {mark for chart in one.charts for marks in chart.symbols for mark in marks} <= set("ofdvs")


def test_the_auto_mac_has_ones_on_its_diagonal() -> None:
    one = result("milling")
    (image,) = mac_figure(one.shapes, ["a", "b"]).axes[0].images
    np.testing.assert_allclose(np.diag(np.asarray(image.get_array())), 1)


def test_every_posture_gets_its_figures() -> None:
    figures = drawn({"milling": result("milling"), "upright": result("upright", 1.1)})
    assert set(figures) == {
        "milling_stabilisation.png",
        "milling_frf.png",
        "milling_indicators.png",
        "upright_indicators.png",
        "milling_automac.png",
        "upright_stabilisation.png",
        "upright_frf.png",
        "upright_automac.png",
        "milling_upright_mac.png",
    }


def test_the_table_of_a_result_holds_frequencies_dampings_and_shapes(tmp_path: Path) -> None:
    one = result("milling")
    write_modal_table(tmp_path / "modes.yaml", ModalTable.of({"milling": one}, "kr90"))
    (first, second) = read_modal_table(tmp_path / "modes.yaml").postures["milling"].modes
    np.testing.assert_allclose([first.frequency_hz, second.frequency_hz], [10.0, 19.0], rtol=1e-6)
    np.testing.assert_allclose([first.damping_percent, second.damping_percent], 1.0, rtol=1e-4)
    assert list(first.shape) == list(LABELS[0])
    assert max(abs(v) for v in first.shape.values()) == 1
