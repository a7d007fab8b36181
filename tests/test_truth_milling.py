"""The truth code's cut in time against published spectral radii, and its poles against its own receptance."""

import numpy as np
import pytest

from tools.truth.effects import parse
from tools.truth.elastic import assemble
from tools.truth.milling import Cut, arc, cut_in_time, directions, growth, last_link, poles, tip_rows
from tools.truth.recording import draw_truth


def test_slot_of_insperger_and_stepan():
    w, zeta, mass = 2 * np.pi * 922, 0.011, 0.03993
    damped = w * np.sqrt(1 - zeta**2)
    pole, residue = -zeta * w + 1j * damped, np.array([1, 0, 0]) / np.sqrt(2j * damped * mass)
    depth = np.array([0.2, 0.5, 0.7, 1.0]) * 1e-3
    cut = Cut(
        np.zeros(3), np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), 2, arc(1.0, True), np.array([6e8, 2e8, 0]), 5000
    )
    found = []
    for steps in (100, 200):
        force = np.repeat(directions(cut, steps)[..., None], 4, 3)
        rate = growth(
            np.full((1, 4), pole), np.repeat(residue[None, :, None], 4, 2), force, depth, np.full(4, cut.period), 1.0
        )
        found.append(np.exp(rate * cut.period))
    limit = found[1] + (found[1] - found[0]) / 3  # second order in the step
    np.testing.assert_allclose(limit, [0.819742784, 1.073975587, 1.221556136, 1.406473525], rtol=2e-4)


@pytest.mark.parametrize("effect", ["structural_damping@joint1.z:loss_factor=0.03", "attached_resonator@link2"])
def test_poles_add_up_to_the_receptance(effect):
    truth = draw_truth(3, (parse(effect),), ())
    structure = assemble(truth.chain, np.deg2rad([10, 80, -100]), truth.effects)
    cut = Cut(
        np.array([1.8, -0.04, 0]),
        -last_link(structure)[:, 0],
        np.array([0, 1.0, 0]),
        2,
        arc(0.5, True),
        np.ones(3),
        3000,
    )
    rows = tip_rows(structure, cut)
    pole, residue = poles(structure, rows)
    s = 2j * np.pi * np.linspace(5, 60, 40)
    pair = np.einsum("ki,kj->kij", residue, residue)
    G = sum(
        u / (s[:, None, None] - p) + u.conj() / (s[:, None, None] - p.conj()) for u, p in zip(pair, pole, strict=True)
    )
    H = structure.receptance(s, rows, rows)
    assert np.linalg.norm(G - H) < 2e-3 * np.linalg.norm(H)


def slotted(count: int, **more) -> tuple[np.ndarray, np.ndarray, list[Cut]]:
    """The published tool, half immersed, ``count`` times."""
    w, zeta, mass = 2 * np.pi * 922, 0.011, 0.03993
    damped = w * np.sqrt(1 - zeta**2)
    pole, residue = -zeta * w + 1j * damped, np.array([1, 0, 0]) / np.sqrt(2j * damped * mass)
    cut = Cut(
        np.zeros(3), np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), 2, arc(0.5, False), np.array([6e8, 2e8, 0]), 7000.0,
        **more,
    )  # fmt: skip
    return np.full((1, count), pole), np.repeat(residue[None, :, None], count, 2), [cut] * count


@pytest.mark.parametrize("helix", [0.0, 0.6])
def test_a_cut_whose_teeth_may_leave_the_work_chatters_where_small_vibrations_grow(helix):
    depth = np.geomspace(2e-4, 3e-3, 7)
    pole, residue, cuts = slotted(len(depth), helix=helix, diameter=0.016)
    force = np.stack([directions(cuts[0], 60, b) for b in depth], axis=-1)
    rate = growth(pole, residue, force, depth, np.full(len(depth), cuts[0].period), 0.5)
    chatters = cut_in_time(pole, residue, cuts, depth, 40, seconds=0.7)
    clear = np.abs(rate) > 3.0  # 1/s: what 0.3 s after the ramp can show
    assert clear.sum() > 2
    assert 0 < (rate[clear] > 0).sum() < clear.sum()
    np.testing.assert_array_equal(chatters[clear], rate[clear] > 0)
