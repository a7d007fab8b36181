"""``twin modal`` on structures that are no robots: plates, rings and frames of independent truth code."""

from pathlib import Path

import numpy as np
import pytest

from tools.study_modal import one
from tools.truth.structures import draw
from twin.measure.campaign import Campaign, Channels, PostureFRF, laplace, write_campaign
from twin.measure.modal_fit import FitData, Variance, _linear, _normal_equations, fit_modes, normalised
from twin.measure.uff import read_uff, write_uff
from twin.measure.wireframe import wireframe


@pytest.mark.parametrize("seed", [1, 24, 33, 400])
def test_every_mode_of_a_structure_is_found_and_no_other(seed: int) -> None:
    """Pairs 0.3 % apart, channels that differ, a bad channel; ``tools/study_modal.py`` draws many more."""
    found = one(seed)
    assert not found["missed"]
    assert not found["false"]
    assert found["found"] >= 10


def fitted(seed: int = 24) -> tuple[FitData, np.ndarray, np.ndarray]:
    """A test, poles a little off the truth, and participation factors."""
    test = draw(seed)
    inside = test.mode_frequency < test.frequency[-1]
    channel = np.median(test.noise**2, axis=0) / 2
    data = FitData(test.frf, laplace(test.frequency, test.rate), Variance(np.ones(test.frequency.size), channel))
    participation = np.array([np.linalg.svd(r)[2][0] for r in test.residues[inside]])
    return data, test.poles[inside] * (1 + 1e-3), normalised(participation)


def test_the_gradient_of_the_fit_is_that_of_its_chi2() -> None:
    """Central differences over Im λ of every mode."""
    data, poles, participation = fitted()
    gradient = _normal_equations(data, _linear(data, poles, participation), participation)[1]
    for k, pole in enumerate(poles):
        sides = []
        for step in (1e-6j, -1e-6j):
            moved = poles.copy()
            moved[k] = pole + step * abs(pole)
            sides.append(_linear(data, moved, participation).chi2)
        slope = (sides[1] - sides[0]) / (4e-6 * abs(pole))  # half of −dχ²/dIm λ
        assert gradient[poles.size + k] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(gradient).max())


def test_chi2_is_what_the_synthesised_frfs_leave() -> None:
    data, poles, participation = fitted()
    test = draw(24)
    fit = fit_modes(data, poles, participation, 5)
    left = (test.frf - fit.model.synthesise(data.s)) * np.sqrt(data.weight)
    assert fit.chi2 == pytest.approx(float(np.sum(np.abs(left) ** 2)), rel=1e-6)


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A test of a plate that knows nothing of a robot."""
    test, path = draw(24), tmp_path_factory.mktemp("plate") / "plate.h5"
    axes = np.eye(3)[test.axis]
    label = tuple(f"{n}{'XYZ'[a]}+" for n, a in enumerate(test.axis, 1))
    response = Channels(label, ("base",) * len(label), test.position, axes)
    at = [int(e) for e in test.excited]
    excitation = Channels(tuple(label[e] for e in at), ("base",) * len(at), test.position[at], axes[at])
    posture = PostureFRF(
        "plate", np.zeros(0), None, test.frequency, test.frf, "accelerance", test.coherence, test.averages
    )
    write_campaign(path, Campaign(response, excitation, {"plate": posture}))
    return path


def test_what_is_no_robot_is_drawn_as_a_wire_frame(twin, plate: Path, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """No axis positions, no robot: modes, shapes as a picture and as an animation; nothing about a robot is said."""
    found = twin("modal", plate, "--json", "--out", tmp_path / "out")
    assert found.code == 0, found.err
    assert len(found.json["postures"]["plate"]["modes"]) >= 10
    assert found.json["postures"]["plate"]["q_deg"] == []
    assert found.json["notes"] == []
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"plate_shapes.png", "plate_modes.rrd", "plate_indicators.png", "modes.yaml"} <= names


@pytest.mark.parametrize("command", ["fit", "view"])
def test_other_commands_say_that_axis_positions_are_missing(twin, plate: Path, tmp_path: Path, command: str) -> None:  # type: ignore[no-untyped-def]
    found = twin(command, plate, "--out", tmp_path / "out.rrd" if command == "view" else tmp_path / "out")
    assert found.code == 2
    assert found.err.count("\n") == 1
    assert "axis positions" in found.err


def test_universal_files_need_no_axis_positions_and_bring_their_lines(plate: Path, tmp_path: Path) -> None:
    """Nodes of data set 15, trace lines of data set 82; node 0 lifts the pen."""
    from twin.measure.campaign import read_campaign

    write_uff(tmp_path / "plate.unv", read_campaign(plate))
    block = f"{-1:6d}\n{82:6d}\n{1:10d}{5:10d}{0:10d}\nNONE\n" + "".join(f"{n:10d}" for n in (1, 2, 0, 3, 4))
    with (tmp_path / "plate.unv").open("a") as file:
        file.write(f"{block}\n{-1:6d}\n")
    read = read_uff(tmp_path / "plate.unv")
    assert read.lines == ((1, 2), (3, 4))
    frame = wireframe(read.response, np.ones((1, len(read.response.label)), dtype=complex), read.lines)
    assert not isinstance(frame, str)
    np.testing.assert_array_equal(frame.lines, [[0, 1], [2, 3]])
    np.testing.assert_allclose(np.linalg.norm(frame.motion, axis=2).max(axis=1), 1)


def test_points_without_lines_are_joined_to_one_piece() -> None:
    """A grid of 4 × 3 points gets its 17 lines and no diagonal."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
    position = np.column_stack([x.ravel(), y.ravel(), np.zeros(12)])
    label = tuple(f"{n}Z+" for n in range(1, 13))
    channels = Channels(label, ("base",) * 12, position, np.tile([0.0, 0, 1], (12, 1)))
    frame = wireframe(channels, np.ones((1, 12), dtype=complex))
    assert not isinstance(frame, str)
    assert len(frame.lines) == 17
    assert np.linalg.norm(position[frame.lines[:, 0]] - position[frame.lines[:, 1]], axis=1).max() == 1
    still = wireframe(Channels(label, ("base",) * 12, position * 0, channels.direction), np.ones((1, 12)) + 0j)
    assert still == "the recording does not say where its points are (data sets 15 or 2411, or response/position)"
