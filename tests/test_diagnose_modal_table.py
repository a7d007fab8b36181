"""Modal tables: joint 1 about x is what one hinge per axis lacks first; a table of one posture names nothing."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.truth.chain import POSTURES_DEG
from tools.truth.chain import kr90 as true_kr90
from tools.truth.elastic import assemble
from twin.diagnose.modal_table import (
    Fits,
    LeftOut,
    diagnose_table,
    fitted,
    left_out,
    mechanical_suspects,
    predicts,
)
from twin.diagnose.refit import NONE
from twin.errors import InputError
from twin.identify.elastic_modal import modal_postures
from twin.measure.modal_table import ModalTable, TableMode, TablePosture
from twin.model.parameters import free_parameters
from twin.model.recorded import without_limits
from twin.robot.description import Robot

MEASURED = Path(__file__).with_name("data") / "table7_measured.yaml"


def true_table() -> ModalTable:
    """The four lowest modes of the three-hinge robot in the paper's postures, by the truth code."""
    postures = {}
    for name, q in POSTURES_DEG.items():
        frequency, damping, _ = assemble(true_kr90(), np.deg2rad(q)).modes()
        modes = tuple(TableMode(float(f), float(100 * z)) for f, z in zip(frequency[:4], damping[:4], strict=True))
        postures[name] = TablePosture(np.array(q, float), modes)
    return ModalTable(postures)


def test_suspects_are_what_moves_modes(kr90: Robot) -> None:
    """Every hinge that a one-hinge model lacks is looked at; the measurement chain, which moves no mode, is not."""
    suspects = mechanical_suspects(without_limits(kr90.without(["transverse_compliance"])))
    hinges = [h.site for h in suspects if h.effect == "transverse_compliance"]
    assert sorted(hinges) == ["joint1.x", "joint1.y", "joint2.x", "joint2.y", "joint3.x", "joint3.y"]
    assert not {h.effect for h in suspects} & {"sensor_gain", "time_delay", "hammer_misalignment"}


def test_each_posture_is_left_out_in_turn(kr90: Robot) -> None:
    """A robot that is the truth predicts every posture of its own table from the others."""
    robot = without_limits(kr90)
    postures = modal_postures(true_table(), robot)
    free = free_parameters(robot).only("spring", "entry", "link")
    [out] = left_out(
        Fits(robot, free, postures, seed=0, processes=1), [fitted(robot, NONE, free, postures, 0, starts=1)]
    )
    assert set(out.by_posture) == set(POSTURES_DEG)
    assert out.pooled < 0.005


@pytest.mark.slow
def test_joint_1_about_x_is_what_one_hinge_per_axis_lacks_first(kr90: Robot) -> None:
    """Three-hinge truth, one-hinge model: the hinge about joint 1's x axis is named from twelve modes alone, and
    'upright' and 'rigid' are each predicted from the other two postures with less than a tenth of the error."""
    finding = diagnose_table(true_table(), kr90.without(["transverse_compliance"]))
    assert finding.word == "named"
    assert (finding.missing[0].first.effect, finding.missing[0].first.site) == ("transverse_compliance", "joint1.x")
    held = {stage: finding.error[stage]["held_out"] for stage in ("before", "after")}
    assert held["after"] < 0.1 * held["before"]
    row = r"left out ([\d.]+)% \(milling ([\d.]+)%, upright ([\d.]+)%, rigid ([\d.]+)%"
    told = re.findall(row, "\n".join(finding.warnings))
    assert any(all(float(percent) < 5 for percent in errors) for errors in told)


def test_prediction_and_not_agreement_makes_a_name() -> None:
    """Half the error on postures left out, and none worse: what chance does not reach."""
    plain = LeftOut({"a": 0.1, "b": 0.1}, 0.1)
    assert predicts(LeftOut({"a": 0.04, "b": 0.05}, 0.045), plain)
    assert not predicts(LeftOut({"a": 0.08, "b": 0.06}, 0.07), plain)
    assert not predicts(LeftOut({"a": 0.001, "b": 0.12}, 0.045), plain)
    assert not predicts(LeftOut({}, float("nan")), plain)


def test_springless_robot_and_empty_tables_are_refused(kr90: Robot) -> None:
    table = true_table()
    with pytest.raises(InputError, match="no posture with modes"):
        diagnose_table(replace(table, postures={}), kr90)
    rigid = kr90.model_copy(
        update={"axes": [a.model_copy(update={"stiffness": None}) for a in kr90.axes], "physics": []}
    )
    with pytest.raises(InputError, match="nothing can vibrate"):
        diagnose_table(table, rigid)
