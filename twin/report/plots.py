"""Curves of a page that a reader can zoom: FRFs by posture and channel, torque by run and joint."""

from collections.abc import Mapping, Sequence

import numpy as np

from twin.report.figures import UNITS
from twin.report.html import Panel, Plot

MOST_CHANNELS = 9  # of one posture: a page of a large campaign stays a page


def frf_panels(
    name: str,
    frequency_hz: np.ndarray,
    frfs: Mapping[str, np.ndarray],
    response_labels: Sequence[str],
    excitation_labels: Sequence[str],
) -> dict[str, Panel]:
    """Amplitudes of the channels in which the first FRF is strongest.

    Args:
        name: of the posture.
        frequency_hz: (nf,).
        frfs: curve → (nf, nr, ne) complex, SI; the measured one first.
        response_labels, excitation_labels: (nr,) and (ne,).
    """
    energy = np.sum(np.abs(next(iter(frfs.values()))) ** 2, axis=0)
    strongest = np.argsort(energy, axis=None)[::-1][:MOST_CHANNELS]
    pairs = [divmod(int(k), len(excitation_labels)) for k in strongest]
    return {
        f"{name}: {response_labels[r]}/{excitation_labels[e]}": Panel(
            frequency_hz, {curve: np.abs(H[:, r, e]) for curve, H in frfs.items()}
        )
        for r, e in pairs
    }


def frf_plot(panels: Mapping[str, Panel], quantity: str = "accelerance", unit: str = "") -> Plot:
    """FRFs of some postures, whose quantity names the unit, or spectra, whose ``unit`` is given."""
    what = "FRFs" if quantity in UNITS else "Spectra"
    caption = f"{what}: the strongest {MOST_CHANNELS} channels of each posture at most."
    return Plot(caption, "frequency, Hz", f"{quantity}, {UNITS.get(quantity, unit)}", panels, log=True)


def torque_panels(
    name: str, time: np.ndarray, curves: Mapping[str, np.ndarray], units: Sequence[str], valid: np.ndarray | None = None
) -> dict[str, Panel]:
    """Recorded and predicted torque of every joint.

    Args:
        name: of the run.
        time: (nt,) s.
        curves: curve → (nt, n); the recorded one first.
        units: (n,) of torque.
        valid: (nt,) what counts; the rest is not drawn.
    """
    shown = np.ones(len(time), bool) if valid is None else np.asarray(valid)
    return {
        f"{name}: joint{i + 1}, {unit}": Panel(
            time, {curve: np.where(shown, torque[:, i], np.nan) for curve, torque in curves.items()}
        )
        for i, unit in enumerate(units)
    }


def torque_plot(panels: Mapping[str, Panel], units: Sequence[str]) -> Plot:
    """Torques of some runs, in the joints' units; a panel names its own."""
    label = f"torque, {' or '.join(dict.fromkeys(units))}"
    return Plot("Torque, recorded and predicted.", "time, s", label, panels)
