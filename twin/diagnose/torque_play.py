"""Play between motor and link where a second encoder sees it: twist = load / k + ½ gap sgn(load) + what else is smooth.

The torque says little of a gap, the difference of two encoders all: it steps where the load through the gear changes
sign. Loads come from the fitted model, the gear's compliance and smooth departures from it are free.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from twin.diagnose.calibration import calibration
from twin.diagnose.torque_system import System
from twin.diagnose.verdict import Candidate, Missing
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.model.torque_laws import State, play_columns
from twin.model.torque_noise import prediction_filter
from twin.model.torque_signal import Run
from twin.physics import effect_of
from twin.robot.description import Entry, Robot

USUAL_GAP = 5e-4  # rad at the gear output (m): a few minutes of arc
CROSSED_OVER = (0.003, 0.01, 0.03, 0.06, 0.12)  # of a joint's RMS load: over which the gap is crossed


@dataclass(frozen=True)
class Play:
    """A gap at a joint.

    Attributes:
        joint: zero-based.
        gap, deviation: rad (m).
        gain: ln evidence over no gap.
        fall: of χ² on the rows used; ``held`` ½ of it on rows not used, ``None`` without such.
        visible: gap from which it would be named.
    """

    joint: int
    gap: float
    deviation: float
    gain: float
    fall: float
    held: float | None
    visible: float

    @property
    def site(self) -> str:
        """As in the vocabulary."""
        return f"joint{self.joint + 1}.z"

    @property
    def probability(self) -> float:
        """That there is a gap, were it this or nothing."""
        numbers = calibration()
        odds = self.gain / numbers["temperature"] + np.log((1 - numbers["none"]) / 60 / numbers["none"])
        return float(np.clip(1 / (1 + np.exp(-odds)), 0.0, 0.99))

    @property
    def seen(self) -> bool:
        """Whether it is named."""
        return self.gain > calibration()["first"] and (self.held is None or self.held > 0)


def plays(system: System, kept: Sequence[Run], kept_states: Sequence[State]) -> list[Play]:
    """The gap at every joint, from runs that have both encoders; none where no run does."""
    used = [(r, s) for r, s in zip(system.base.runs, system.state, strict=True) if r.twist is not None]
    aside = [(r, s) for r, s in zip(kept, kept_states, strict=True) if r.twist is not None]
    if not used:
        return []
    found = []
    for joint in range(used[0][0].torque.shape[1]):
        found.append(_widest(used, aside, joint))
    return found


def _widest(used: list[tuple[Run, State]], aside: list[tuple[Run, State]], joint: int) -> Play:
    """The gap at a joint, the load over which it is crossed found with it; its deviation is of both together."""

    def at(log_share: float) -> Play:
        return _play(used, aside, joint, float(np.exp(log_share)))

    grid = np.log(CROSSED_OVER)
    coarse = [at(x) for x in grid]
    k = int(np.argmax([play.gain for play in coarse]))
    if coarse[k].gain <= calibration()["first"]:
        return coarse[k]
    ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
    x = float(minimize_scalar(lambda x: -at(x).gain, bounds=ends, method="bounded", options={"xatol": 0.01}).x)
    step, inexact = 0.05, 0.005  # for differences; of a gap, what the law of its crossing is off by
    low, here, high = at(x - step), at(x), at(x + step)
    bend = max(2 * here.gain - low.gain - high.gain, 0.0) / step**2
    turn = (high.gap - low.gap) / (2 * step)
    parts = here.deviation, turn / np.sqrt(max(bend, 1.0)), inexact * here.gap
    return replace(here, deviation=float(np.linalg.norm(parts)))


def _play(used: list[tuple[Run, State]], aside: list[tuple[Run, State]], joint: int, share: float) -> Play:
    numbers = calibration()
    scale = float(np.sqrt(np.mean(np.concatenate([s.load[:, joint] for _, s in used]) ** 2))) + 1e-12
    X, g, y, valid = play_columns(used, joint, scale, share)
    rich = np.column_stack([X, g])[valid]
    rest = y - np.column_stack([X, g]) @ np.linalg.lstsq(rich, y[valid], rcond=1e-9)[0]
    e = np.where(valid, rest, 0.0)
    order = min(10, int(valid.sum()) // 20)  # of the noise's autoregression
    correlation = np.array([e[: len(e) - k] @ e[k:] for k in range(order + 1)]) / max(int(valid.sum()), 1)
    if not correlation[0] > 1e-24:
        return Play(joint, 0.0, np.inf, -np.inf, 0.0, None, np.inf)
    whitening = prediction_filter(correlation)
    white = _white(whitening, np.column_stack([X, g, y]), valid)
    basis = np.linalg.qr(white[:, :-2])[0]
    column, data = (white[:, k] - basis @ (basis.T @ white[:, k]) for k in (-2, -1))
    information = float(column @ column)
    pull = float(column @ data)
    gap = max(pull / (information + 1 / USUAL_GAP**2), 0.0)
    occam = 0.5 * np.log1p(information * USUAL_GAP**2) - np.log(2.0) + np.log(len(CROSSED_OVER))
    gain = 0.5 * gap * pull - occam
    held = None
    if aside:
        X2, g2, y2, valid2 = play_columns(aside, joint, scale, share)
        white2 = _white(whitening, np.column_stack([X2, g2, y2]), valid2)
        basis2 = np.linalg.qr(white2[:, :-2])[0]
        column2, data2 = (white2[:, k] - basis2 @ (basis2.T @ white2[:, k]) for k in (-2, -1))
        expected = 0.5 * gap * pull * len(white2) / max(len(white), 1)
        seen = float(gap * (column2 @ data2) - 0.5 * gap**2 * (column2 @ column2))
        if 0.5 * gap**2 * float(column2 @ column2) > 1.0:  # a load that keeps its sign there says nothing
            held = seen - numbers["held_out_share"] * min(expected, 0.5 * gap**2 * float(column2 @ column2))
    deviation = 1 / np.sqrt(information + 1 / USUAL_GAP**2)
    needed = max(numbers["first"], numbers["temperature"] * np.log(60.0)) + occam
    return Play(
        joint, gap, float(deviation), gain, gap * pull, held, float(np.sqrt(2 * needed / max(information, 1e-30)))
    )


def _white(whitening: FloatArray, columns: FloatArray, valid: np.ndarray) -> FloatArray:
    order = len(whitening) - 1
    bad = np.cumsum(np.concatenate([np.ones(order, int), ~valid]))
    keep = valid & (bad[order:] - bad[: len(bad) - order] == 0)
    return np.asarray(lfilter(whitening, [1.0], columns, axis=0)[keep])


def with_play(robot: Robot, play: Play) -> Robot:
    """The description with the gap in it."""
    entry = Entry.model_validate({"effect": effect_of("play").name, "site": play.site, "gap": play.gap})
    return robot.model_copy(update={"physics": [*robot.physics, entry]})


def missing_play(play: Play, robot: Robot) -> Missing:
    """A gap as an answer.

    Args:
        play: that is seen.
        robot: the description with it.
    """
    ends = [max(play.gap + side * NINETY * play.deviation, 0.0) for side in (-1, 1)]
    first = Candidate(
        effect_of("play").name, play.site, play.gain, robot,
        {"gap": {"value": play.gap, "unit": "rad", "interval90": ends}},
    )  # fmt: skip
    evidence = (
        f"The difference between the motor's and the link's encoder of joint{play.joint + 1} jumps by {play.gap:.2g} "
        f"rad where the load on the gear changes sign. With the gap in the model, χ² of it falls by {play.fall:.0f}."
    )
    return Missing(first, play.probability, (), evidence)
