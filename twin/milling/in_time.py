"""The same cut stepped in MuJoCo: regenerative force at the tip, every nonlinear joint of the robot, loss of contact.

The tip's motion and the force on it go through the Jacobian of the posture: deflections are below a millimetre. A tooth
cuts what earlier teeth have left. At each angle the surface is remembered, so that a tooth that jumps out of the work
leaves its chip to the next. Force and motion are taken at the middle of a step. The steps divide the tooth period, so
that the delay is exact. The tool's own modes and structural damping beyond viscous are not stepped.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from twin.milling import forces
from twin.milling.cut import Cut
from twin.milling.tool_point import LABELS, with_tool
from twin.model.hammer import FASTEST, stepping_model
from twin.model.linear import linearise, mass_matrix
from twin.model.modes import modes, state_matrix_poles
from twin.robot.description import Robot
from twin.robot.mechanism import assemble

STEPS = 48  # of a tooth period, at least
SLICES = 12  # of a helix
DECAYS = 3.0  # times the slowest decay that a cut is stepped
LONGEST_S, SHORTEST_S = 12.0, 1.0
LASTING = 0.2  # of ln amplitude over the last half: a vibration that amplitudes bound and that decays less goes on
QUIET = 1e-4  # of the feed per tooth: below it nothing vibrates


@dataclass(frozen=True)
class CutInTime:
    """What a cut did.

    Attributes:
        depth_m, spindle_rpm: of the cut.
        time: (nt,) s; ``motion`` (nt, 3) m of the tip and ``force`` (nt, 3) N on it, cut frame.
        change_m: (np,) RMS change of the motion from turn to turn of the spindle, by turn.
        growth: rate of that change over the last half, 1/s.
        chatter: whether it grows, or goes on where something bounds it: teeth out of the work, a nonlinear joint.
    """

    depth_m: float
    spindle_rpm: float
    time: np.ndarray
    motion: np.ndarray
    force: np.ndarray
    change_m: np.ndarray
    growth: float
    chatter: bool


class CutStepper:
    """A robot with its tool, compiled once, that cuts at a speed and any depth.

    Args:
        robot: with its physics, nonlinear entries too.
        q: (n,) posture, rad (m).
        cut: tool, coefficients, immersion.
        spindle_rpm: speed.
    """

    def __init__(self, robot: Robot, q: np.ndarray, brakes: str, cut: Cut, spindle_rpm: float) -> None:
        mechanism = assemble(with_tool(robot, cut), q, brakes="off" if brakes == "off" else "on")
        linear = linearise(mechanism)
        self.robot, self.cut, self.spindle_rpm = robot, cut, float(spindle_rpm)
        period = float(cut.tooth_period(spindle_rpm))
        fastest = float(np.abs(state_matrix_poles(linear)).max(initial=1.0))
        self.steps = max(STEPS, int(np.ceil(period * fastest / FASTEST)))
        self.model = stepping_model(mechanism, period / self.steps)
        curved = any(any(joint.stiffness[1:]) or any(joint.damping[1:]) for joint in mechanism.joints)
        gaps = any(joint.dead_zone for joint in mechanism.joints)
        self.nonlinear = curved or gaps or any(tendon.springyield for tendon in mechanism.tendons)
        body, jacobian = linear.points[LABELS[0]]
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        turn = data.xmat[self.model.body(body).id].reshape(3, 3)
        number = self.model.body(f"link{robot.axis_count}").id
        axis = data.xmat[number].reshape(3, 3) @ cut.tool.axis(robot)
        self.jacobian = cut.frame(axis) @ turn @ jacobian
        pole = modes(linear).pole
        slowest = float(-pole.real.max()) if len(pole) else 1.0
        self.seconds = float(np.clip(DECAYS / slowest, SHORTEST_S, LONGEST_S))

    def run(self, depth_m: float, seconds: float | None = None, kick_n_s: float = 0.0) -> CutInTime:
        """Cut from rest at a depth, m.

        Args:
            seconds: how long; by default ``DECAYS`` times the slowest decay of the robot.
            kick_n_s: blow along the feed before the cut begins, N·s: a disturbance of its own.
        """
        model, cut, steps = self.model, self.cut, self.steps
        turn_steps = steps * cut.tool.teeth
        turns = max(8, int(np.ceil((seconds or self.seconds) / (model.opt.timestep * turn_steps))))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        rest = data.qpos.copy()
        if kick_n_s:
            data.qvel[:] = np.linalg.solve(mass_matrix(model, data), self.jacobian[0] * kick_n_s)
        teeth = _Teeth(cut, steps, depth_m, steps * model.opt.timestep)
        motion, force = np.empty((turns * turn_steps, 3)), np.empty((turns * turn_steps, 3))
        half, J = 0.5 * model.opt.timestep, self.jacobian
        farthest = 0.1 * cut.tool.diameter_m  # from its place: no chatter need be followed beyond
        for k in range(len(motion)):
            motion[k] = J @ (data.qpos - rest + half * data.qvel)
            if not np.abs(motion[k]).max() < farthest:
                return self._judged(depth_m, motion[:k], force[:k], turn_steps, away=True, out=teeth.out)
            force[k] = teeth.push(k, motion[k], J @ data.qvel)
            data.qfrc_applied[:] = force[k] @ J
            mujoco.mj_step(model, data)
        return self._judged(depth_m, motion, force, turn_steps, away=False, out=teeth.out)

    def _judged(
        self, depth_m: float, motion: np.ndarray, force: np.ndarray, turn_steps: int, away: bool, out: int
    ) -> CutInTime:
        step = self.model.opt.timestep
        by_turn = motion[: len(motion) // turn_steps * turn_steps].reshape(-1, turn_steps, 3)
        change = np.sqrt((np.diff(by_turn, axis=0) ** 2).sum(axis=2).mean(axis=1))
        late = np.log(np.maximum(change[len(change) // 2 :], 1e-300))
        growth = np.inf
        if len(late) > 2:
            growth = float(np.polyfit(np.arange(len(late)) * turn_steps * step, late, 1)[0])
        bounded = self.nonlinear or out > len(motion) - len(motion) // 8
        lasts = bounded and growth * len(late) * turn_steps * step > -LASTING
        quiet = len(change) > 0 and change[-1] < QUIET * self.cut.feed_per_tooth_m
        return CutInTime(
            depth_m, self.spindle_rpm, (np.arange(len(motion)) + 0.5) * step, motion, force, change, growth,
            bool(away or (not quiet and (growth > 0 or lasts))),
        )  # fmt: skip

    def limit(self, low_m: float, high_m: float, rounds: int = 6, kick_n_s: float = 0.0) -> float:
        """Depth (m) at which chatter begins when cutting starts from rest or with a blow, by bisection of its log.

        ``low_m`` where chatter is there already, ``high_m`` where there is none.
        """
        if self.run(low_m, kick_n_s=kick_n_s).chatter:
            return low_m
        if not self.run(high_m, kick_n_s=kick_n_s).chatter:
            return high_m
        for _ in range(rounds):
            middle = float(np.sqrt(low_m * high_m))
            chatters = self.run(middle, kick_n_s=kick_n_s).chatter
            low_m, high_m = (low_m, middle) if chatters else (middle, high_m)
        return float(np.sqrt(low_m * high_m))


class _Teeth:
    """The force of teeth that cut what earlier teeth have left, step by step.

    Attributes:
        out: last step at which a tooth that should cut was out of the work.
    """

    def __init__(self, cut: Cut, steps: int, depth_m: float, period_s: float) -> None:
        width, self.teeth, self.steps = forces.lag(cut, depth_m), cut.tool.teeth, steps
        slices = 1 if width < 1e-9 else SLICES
        phase = (np.arange(steps) + 0.5) / steps
        lags = width * (np.arange(slices) + 0.5) / slices
        angle = forces.tooth_angles(cut, phase)[:, None, :] - lags[:, None]
        angle = np.where(angle < cut.arc[0], angle + 2 * np.pi, angle)
        sharp = 0.5 * 2 * np.pi / self.teeth / steps  # entry and exit are averaged over a step
        share = np.clip((angle - cut.arc[0]) / (2 * sharp) + 0.5, 0, 1) * np.clip(
            (cut.arc[1] - angle) / (2 * sharp) + 0.5, 0, 1
        )
        direction, chip = forces.directions(angle)
        piece = depth_m / slices * share[..., None, None] * direction
        self.shear, self.edge = piece @ cut.coefficients.shear, piece @ cut.coefficients.edge
        self.flank = piece @ cut.flank(period_s)
        self.chip = chip[..., :2]
        self.feed = cut.feed_per_tooth_m * np.sin(angle)
        self.inside = np.asarray(share > 0)
        self.surface = np.zeros(angle.shape)
        self.offset = cut.tool.runout_m * np.cos(2 * np.pi * np.arange(self.teeth) / self.teeth)
        self.out = -1

    def push(self, k: int, motion: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Force (3,) N at step k for a tip at ``motion`` (3,) m with ``velocity`` (3,) m/s, cut frame."""
        number, i = divmod(k, self.steps)
        if not self.inside[i].any():
            return np.zeros(3)
        # tooth slot l holds the tooth that came l periods before
        reach = self.chip[i] @ motion[:2] + self.offset[(number - np.arange(self.teeth)) % self.teeth]
        thick = reach - self.surface[i] + self.feed[i]
        cuts = (thick > 0) & self.inside[i]
        if (self.inside[i] & ~cuts).any():
            self.out = k
        self.surface[i] = np.where(cuts, reach, self.surface[i] - self.feed[i])
        weight = np.where(cuts, thick, 0.0)[..., None] * self.shear[i] + cuts[..., None] * self.edge[i]
        weight += (cuts * (self.chip[i] @ velocity[:2]))[..., None] * self.flank[i]
        return np.asarray(weight.sum(axis=(0, 1)))
