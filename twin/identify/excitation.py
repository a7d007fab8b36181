"""Excitation trajectories: Fourier series that make the regressor well conditioned within the robot's limits.

Swevers, Ganseman, Tükel, De Schutter, Van Brussel, IEEE T-RA 13 (1997); paper, Eqs. 8–12.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy.optimize import minimize

from twin.errors import InputError
from twin.model.base_parameters import structural_base
from twin.model.regressor import Regressor, flange_path, link_regressor
from twin.parallel import cores, spread
from twin.physics.motion import Motion
from twin.robot.description import Robot

Criterion = Literal["condition", "d-optimal"]

FINE_S = 1e-3  # grid of the last check
MORE_STARTS = 4  # times the planned starts that are tried at most, where too few lead to a trajectory


@dataclass(frozen=True)
class Settings:
    """How the optimiser works.

    Attributes:
        rows: instants per period in the criterion.
        guards: instants per period at which it holds limits; more are added where a solution leaves them.
        sharpness: exponents of the smooth stand-in for the condition number: to search, and at the end.
        draws: random motions per trajectory.
        starts: of these, from which local searches start.
        clear: of each limit's range (m of the workspace), which these keep.
        chains: ends of these that go on.
        hops: local searches of each from around its best so far; the criterion has many local minima.
        hop: size of such a step in mean sizes of the variables.
        rounds: of added guards, at most.
        margin: of each limit's range (m of the workspace), kept at the guards; grows by as much every round.
        tolerance: by which the optimiser may miss a guard; less than the margin.
        converged: change of the criterion at which a local search ends.
    """

    rows: int = 50
    guards: int = 48
    sharpness: tuple[float, float] = (12.0, 60.0)
    draws: int = 60
    starts: int = 5
    clear: float = 1e-2
    chains: int = 2
    hops: int = 15
    hop: tuple[float, float] = (0.1, 0.4)
    rounds: int = 10
    margin: float = 1e-4
    tolerance: float = 3e-5
    converged: float = 1e-5


@dataclass(frozen=True)
class Fourier:
    """A trajectory of n axes with H harmonics (Eqs. 8–10).

    Attributes:
        sine, cosine: a_l and b_l (n, H), rad/s (m/s).
        centre: q₀ (n,) rad (m).
        base_hz: ω_f / 2π.
    """

    sine: np.ndarray
    cosine: np.ndarray
    centre: np.ndarray
    base_hz: float = 0.1

    @property
    def period_s(self) -> float:
        """Length of one period, s."""
        return 1 / self.base_hz

    def motion(self, time: np.ndarray) -> Motion:
        """Positions, velocities and accelerations at instants (nt,) s."""
        position, speed, rate = _bases(time, self.sine.shape[1], self.base_hz)
        stacked = np.concatenate([self.sine, self.cosine], axis=1).T  # (2H, n)
        return Motion(time, position @ stacked + self.centre, speed @ stacked, rate @ stacked)

    def extremes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Exact lowest and highest position, velocity and acceleration over all time, each (n, 2).

        A trigonometric polynomial is stationary where a polynomial of degree 2H in e^{iωt} has a root on the unit
        circle; nothing is sampled.
        """
        H = self.sine.shape[1]
        w = 2 * np.pi * self.base_hz * np.arange(1, H + 1)
        out = np.empty((3, len(self.sine), 2))
        for i, (a, b) in enumerate(zip(self.sine, self.cosine, strict=True)):
            # x(t) = c₀ + Re Σ z_l e^{iω l t}: velocity first, its integral and derivative from it
            velocity = a - 1j * b
            for k, z in enumerate((velocity / (1j * w), velocity, velocity * 1j * w)):
                slope = z * 1j * w
                polynomial = np.concatenate([slope[::-1], [0], np.conj(slope)])
                roots = np.roots(polynomial) if np.abs(polynomial).max() > 0 else np.ones(1)
                phases = np.angle(roots)  # a root off the circle is no extreme, but no value there exceeds one
                values = np.real(np.exp(1j * np.outer(phases, np.arange(1, H + 1))) @ z)
                out[k, i] = values.min(), values.max()
        out[0] += self.centre[:, None]
        return out[0], out[1], out[2]


@dataclass(frozen=True)
class Limits:
    """Position, velocity and acceleration (n, 2), and the flange's box (3, 2) m, infinite where there is none."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    workspace: np.ndarray

    @classmethod
    def of(cls, robot: Robot) -> "Limits":
        """The limits of a description.

        Raises:
            InputError: an axis without position and velocity limits.
        """
        position, velocity, acceleration = [], [], []
        for i, axis in enumerate(robot.axes):
            if axis.limits is None or axis.limits.position is None or axis.limits.velocity is None:
                raise InputError(robot.name, f"axes[{i}].limits", "needs position and velocity to plan a trajectory")
            position.append(axis.limits.position)
            velocity.append((-axis.limits.velocity, axis.limits.velocity))
            largest = axis.limits.acceleration or np.inf
            acceleration.append((-largest, largest))
        box = robot.workspace
        workspace = [box.x, box.y, box.z] if box else [(-np.inf, np.inf)] * 3
        return cls(*(np.array(x, float) for x in (position, velocity, acceleration, workspace)))

    @property
    def of_joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity and acceleration (n, 2)."""
        return self.position, self.velocity, self.acceleration


@dataclass(frozen=True)
class Excitation:
    """A trajectory that holds its limits at every time, and its figure of merit.

    Attributes:
        fourier: the trajectory.
        condition: condition number of the inertial base columns, unscaled, over one period.
        log_det: log determinant of their information matrix per sample.
    """

    fourier: Fourier
    condition: float
    log_det: float


def _bases(time: np.ndarray, harmonics: int, base_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (nt, 2H) per unit of a_1 … a_H, b_1 … b_H."""
    w = 2 * np.pi * base_hz * np.arange(1, harmonics + 1)
    s, c = np.sin(np.outer(time, w)), np.cos(np.outer(time, w))
    return np.hstack([s / w, -c / w]), np.hstack([c, s]), np.hstack([-s * w, c * w])


def violation(robot: Robot, fourier: Fourier, limits: Limits | None = None) -> float:
    """By how much a trajectory leaves its limits at the worst moment, ≤ 0 if never; rad, m and their rates.

    Joint limits from exact extremes. The flange is looked at every millisecond, and between by the bound h²/8 max|ẍ|,
    its acceleration bounded by the joints' rates and its largest distance from an axis.
    """
    limits = limits or Limits.of(robot)
    worst = -room_in_workspace(robot, fourier, limits)
    for found, allowed in zip(fourier.extremes(), limits.of_joints, strict=True):
        worst = max(worst, float(np.max(allowed[:, 0] - found[:, 0])), float(np.max(found[:, 1] - allowed[:, 1])))
    return worst


def used(fourier: Fourier, limits: Limits) -> list[float]:
    """How much of the joints' limits of position, velocity and acceleration a trajectory uses; 1 is at a limit.

    Counted from the middle of what is allowed; 0 where nothing is limited.
    """
    shares = []
    for found, allowed in zip(fourier.extremes(), limits.of_joints, strict=True):
        limited = np.isfinite(allowed).all(axis=1)
        middle, half = allowed[limited].mean(axis=1), 0.5 * np.diff(allowed[limited], axis=1)
        shares.append(float(np.max(np.abs(found[limited] - middle[:, None]) / half, initial=0.0)))
    return shares


def room_in_workspace(robot: Robot, fourier: Fourier, limits: Limits) -> float:
    """The flange's least distance from the walls of the stated workspace, m; negative outside, infinite without any."""
    if not np.isfinite(limits.workspace).any():
        return np.inf
    time = np.arange(0, fourier.period_s, FINE_S)
    motion = fourier.motion(time)
    path = flange_path(robot, motion.position)
    reach = sum(abs(axis.a) + abs(axis.d) for axis in robot.axes) + float(np.linalg.norm(robot.flange.position))
    turning = np.array([axis.type == "revolute" for axis in robot.axes])
    travel, rates, gains = (np.abs(x).max(axis=1) for x in fourier.extremes())
    slide, slide_rate = rates[~turning].sum(), gains[~turning].sum()
    reach += float(travel[~turning].sum())
    spin, spin_rate = rates[turning].sum(), gains[turning].sum()
    slack = FINE_S**2 / 8 * (reach * (spin_rate + spin**2) + slide_rate + 2 * spin * slide)
    low, high = limits.workspace.T
    return min(float(np.min(path.min(axis=0) - low)), float(np.min(high - path.max(axis=0)))) - slack


class Problem:
    """The optimisation of one robot: variables z (one vector), criterion and constraints with their gradients.

    Args:
        robot: with position and velocity limits.
        harmonics, base_hz: of the series.
        rest: start and end every period at rest: Σ a_l = 0 and Σ l b_l = 0.
        criterion: ``"condition"`` number, or ``"d-optimal"`` (log determinant of the covariance).
    """

    def __init__(
        self, robot: Robot, harmonics: int, base_hz: float, rest: bool, criterion: Criterion,
        settings: Settings | None = None,
    ) -> None:  # fmt: skip
        self.robot, self.base_hz, self.criterion = robot, base_hz, criterion
        self.limits = Limits.of(robot)
        self.settings = settings or Settings()
        self.margin, self.sharpness = self.settings.margin, self.settings.sharpness[0]
        n = robot.axis_count
        bare = robot.model_copy(
            update={
                "physics": [],
                "drives": [drive.model_copy(update=dict(rotor_inertia=0.0)) for drive in robot.drives],
            }
        )
        base = structural_base(Regressor(bare))
        self.kept = base.kept[base.kept < 10 * n]
        if not len(self.kept):
            raise InputError(
                robot.name, "links", "no torque tells of them; are drives and couplings as they should be?"
            )
        period = 1 / base_hz
        instants, guards = self.settings.rows, self.settings.guards
        self.bases = _bases(np.arange(instants) * period / instants, harmonics, base_hz)
        self.instants = (np.arange(guards) + 0.25) * period / guards
        free = np.eye(2 * harmonics)
        if rest:
            rows = np.zeros((2, 2 * harmonics))
            rows[0, :harmonics], rows[1, harmonics:] = 1, np.arange(1, harmonics + 1)
            free = np.linalg.svd(rows)[2][2:].T
        self.free = free  # (2H, f): series coefficients from free ones
        self.f = free.shape[1]
        self.speed = self.limits.velocity[:, 1]
        span = np.diff(self.limits.position, axis=1)[:, 0]
        self.span, self.middle = span, self.limits.position.mean(axis=1)

    @property
    def guards(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The bases at the guard instants."""
        return _bases(self.instants, len(self.free) // 2, self.base_hz)

    def unpack(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (2H, n) and centres (n,) of variables (n (f + 1),), which are of order one."""
        z = z.reshape(self.robot.axis_count, self.f + 1)
        return self.free @ (z[:, :-1] * self.speed[:, None]).T, self.middle + z[:, -1] * self.span

    def fourier(self, z: np.ndarray) -> Fourier:
        """The trajectory of one set of variables."""
        coefficients, centre = self.unpack(z)
        H = len(coefficients) // 2
        return Fourier(coefficients[:H].T.copy(), coefficients[H:].T.copy(), centre.copy(), self.base_hz)

    def columns(self, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """The inertial base columns (nt, n, b) in states (nt, n)."""
        motion = Motion(np.zeros(len(position)), position, velocity, acceleration)
        return link_regressor(self.robot, motion)[:, :, self.kept]

    def value_and_gradient(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """The criterion of variables (…,), and its gradient.

        The criterion is the log condition number, smoothed, or minus half the log determinant per parameter. A row of
        the regressor depends on its own instant's state alone. So one variation of each coordinate at all instants
        together gives the gradient with respect to the motion. The chain rule does the rest.
        """
        coefficients, centre = self.unpack(z)
        states = np.stack([B @ coefficients for B in self.bases])  # (3, nt, n)
        states[0] += centre
        n, h, instants = len(centre), 1e-6, self.settings.rows
        varied = np.repeat(states[:, None], 3 * n + 1, axis=1)  # (3, 3n + 1, nt, n)
        for k in range(3 * n):
            varied[k // n, k + 1, :, k % n] += h
        Y = self.columns(*varied.reshape(3, -1, n)).reshape(3 * n + 1, instants, n, -1)
        slopes = (Y[1:] - Y[0]) / h
        rows = Y[0].reshape(instants * n, -1)
        squares, vectors = np.linalg.eigh(rows.T @ rows / instants)
        squares = np.maximum(squares, 1e-12)
        if self.criterion == "condition":
            # the largest over the smallest, as p-norms: smooth where singular values meet, which they do at the optimum
            p = self.sharpness
            high, low = (squares / squares[-1]) ** p, (squares[0] / squares) ** p
            value = 0.5 * (np.log(squares[-1] / squares[0]) + np.log(high.sum() * low.sum()) / p)
            share = 0.5 * (high / high.sum() - low / low.sum()) / squares
        else:
            value = -0.5 * np.mean(np.log(squares))
            share = -0.5 / (squares * len(squares))
        weight = (2 / instants * (rows @ vectors * share) @ vectors.T).reshape(instants, n, -1)
        by_state = np.einsum("ktjb,tjb->kt", slopes, weight).reshape(3, n, instants)
        by_series = sum(B.T @ g.T for B, g in zip(self.bases, by_state, strict=True))  # (2H, n)
        gradient = np.column_stack(
            [(self.free.T @ by_series).T * self.speed[:, None], by_state[0].sum(axis=1) * self.span]
        )
        return float(value), gradient.ravel()

    def linear_constraints(self) -> tuple[np.ndarray, np.ndarray]:
        """C, c of C z + c ≥ 0: joint positions, velocities and accelerations at the guard instants."""
        n, f = self.robot.axis_count, self.f
        rows, constants = [], []
        for k, (B, limit) in enumerate(
            zip(self.guards, (self.limits.position, self.limits.velocity, self.limits.acceleration), strict=True)
        ):
            unit = B @ self.free
            for i in range(n):
                # |q̈| ≤ H ω_f max |q̇| (Bernstein): slow series need no guard of their acceleration
                if k == 2 and len(self.free) // 2 * 2 * np.pi * self.base_hz * self.speed[i] < limit[i, 1]:
                    continue
                low, high = limit[i] + self.margin * (limit[i, 1] - limit[i, 0]) * np.array([1, -1])
                scale = limit[i, 1] - limit[i, 0]
                row = np.zeros((len(unit), n, f + 1))
                row[:, i, :-1] = unit * self.speed[i]
                row[:, i, -1] = self.span[i] if k == 0 else 0.0
                start = self.middle[i] if k == 0 else 0.0
                row = row.reshape(len(unit), -1) / scale
                rows += [row, -row]
                constants += [np.full(len(unit), (start - low) / scale), np.full(len(unit), (high - start) / scale)]
        return np.concatenate(rows), np.concatenate(constants)

    def workspace(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances (w,) ≥ 0 m of the flange from the walls at the guard instants, and their Jacobian (w, …)."""
        coefficients, centre = self.unpack(z)
        basis = self.guards[0]
        q = basis @ coefficients + centre
        n, h = len(centre), 1e-6
        varied = np.repeat(q[None], n + 1, axis=0)
        for i in range(n):
            varied[i + 1, :, i] += h
        path = flange_path(self.robot, varied.reshape(-1, n)).reshape(n + 1, -1, 3)
        slopes = (path[1:] - path[0]) / h  # (n, m, 3)
        unit = np.concatenate([basis @ self.free, np.ones((len(basis), 1))], axis=1)
        scale = np.concatenate([np.repeat(self.speed[:, None], self.f, axis=1), self.span[:, None]], axis=1)
        jacobian = np.einsum("imd,mf,if->dmif", slopes, unit, scale).reshape(3, len(q), -1)
        room, gradient = [np.zeros(0)], [np.zeros((0, z.size))]
        for k, (low, high) in enumerate(self.limits.workspace):
            for wall, side in ((low, 1), (high, -1)):
                if np.isfinite(wall):
                    room.append(side * (path[0, :, k] - wall) - self.margin)
                    gradient.append(side * jacobian[k])
        return np.concatenate(room), np.concatenate(gradient)

    def within(self, z: np.ndarray) -> bool:
        """Whether variables hold the limits at the guards."""
        C, c = self.linear_constraints()
        return bool(min((C @ z + c).min(), self.workspace(z)[0].min(initial=0.0)) > -self.settings.tolerance)

    def starts(self, rng: np.random.Generator) -> list[np.ndarray]:
        """Random variables within the limits at the guards, the best of many draws.

        A large motion brought within the limits ends better than a small one that grows. Only where none can be brought
        in are smaller ones drawn.
        """
        found: list[tuple[float, np.ndarray]] = []
        draws = self.settings.draws
        for k in range(2 * draws):
            if k >= draws and found:
                break
            z = self.brought_in(self.draw(rng, min(1.0, 2 - k / draws)))
            if self.within(z):
                found.append((self.value_and_gradient(z)[0], z))
        return [z for _, z in sorted(found, key=lambda pair: pair[0])[: self.settings.starts]]

    def draw(self, rng: np.random.Generator, fill: float) -> np.ndarray:
        """Random series of which every axis fills its own limits to the share ``fill``; the flange may be anywhere."""
        C, c = self.linear_constraints()
        n, H = self.robot.axis_count, len(self.free) // 2
        z = np.zeros((n, self.f + 1))
        fade = np.tile(np.arange(1, H + 1) ** -rng.uniform(0, 1.5), 2)[:, None]
        z[:, :-1] = rng.normal(size=(n, 2 * H)) @ (fade * self.free)
        z[:, -1] = rng.uniform(-0.2, 0.2, n)
        still = np.where(np.arange(self.f + 1) < self.f, 0.0, z)
        rest = C @ still.ravel() + c
        for i in range(n):
            change = C @ np.where((np.arange(n) == i)[:, None], z - still, 0.0).ravel()
            closing = change < -1e-12
            z[i, :-1] *= fill * np.min(rest[closing] / -change[closing], initial=1 / fill)
        return z.ravel()

    def brought_in(self, z: np.ndarray) -> np.ndarray:
        """Variables near ``z`` (…,) with as little as can be outside the limits at the guards, by least squares."""
        C, c = self.linear_constraints()
        clear = self.settings.clear

        def outside(z: np.ndarray) -> tuple[float, np.ndarray]:
            room, slope = self.workspace(z)
            below, past = np.minimum(C @ z + c - clear, 0), np.minimum(room - clear, 0)
            return float(below @ below + past @ past), 2 * (below @ C + past @ slope)

        return np.asarray(minimize(outside, z, jac=True, method="L-BFGS-B", options={"maxiter": 60}).x)

    def guard(self, fourier: Fourier) -> None:
        """Hold limits also where a trajectory leaves them most, limit by limit."""
        time = np.arange(0, fourier.period_s, 10 * FINE_S)
        motion = fourier.motion(time)
        series = [motion.position, motion.velocity, motion.acceleration, flange_path(self.robot, motion.position)]
        limits = [self.limits.position, self.limits.velocity, self.limits.acceleration, self.limits.workspace]
        found = [self.instants]
        for values, limit in zip(series, limits, strict=True):
            for excess in (values - limit[:, 1], limit[:, 0] - values):
                around = np.maximum(np.roll(excess, 1, axis=0), np.roll(excess, -1, axis=0))
                top = (excess > -1e-3) & (excess >= around)
                found.append(time[top.any(axis=1)])
        self.instants = np.unique(np.round(np.concatenate(found), 3))

    def solve(self, z: np.ndarray, iterations: int) -> tuple[float, np.ndarray]:
        """Sequential quadratic programming from variables (…,), which may be outside the limits.

        Returns:
            The lowest value it saw within the limits at the guards, and where; infinite if there was none.
        """
        C, c = self.linear_constraints()
        best, lowest = z, np.inf

        def criterion(z: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal best, lowest
            value, gradient = self.value_and_gradient(z)
            if value < lowest and self.within(z):
                best, lowest = z.copy(), value
            return value, gradient

        constraints: list[dict[str, Any]] = [{"type": "ineq", "fun": lambda z: C @ z + c, "jac": lambda z: C}]
        if self.workspace(z)[0].size:
            room = {"fun": lambda z: self.workspace(z)[0], "jac": lambda z: self.workspace(z)[1]}
            constraints.append({"type": "ineq", **room})
        minimize(
            criterion, z, jac=True, method="SLSQP", constraints=constraints,
            options={"maxiter": iterations, "ftol": self.settings.converged},
        )  # fmt: skip
        return lowest, best


def _one(job: tuple[Robot, int, float, bool, Criterion, int, int, Settings]) -> Excitation | None:
    """A trajectory from one seed: local searches, then guards where it leaves a limit, until it does so nowhere."""
    robot, harmonics, base_hz, rest, criterion, seed, iterations, settings = job
    problem = Problem(robot, harmonics, base_hz, rest, criterion, settings)
    rng = np.random.default_rng(seed)
    found = sorted((problem.solve(z, iterations) for z in problem.starts(rng)), key=lambda pair: pair[0])[
        : settings.chains
    ]
    if not found:
        return None
    for k, (lowest, best) in enumerate(found):
        for _ in range(settings.hops):
            size = np.exp(rng.uniform(*np.log(settings.hop))) * np.abs(best).mean()
            hop = problem.solve(best + size * rng.normal(size=best.shape), iterations)
            lowest, best = min((lowest, best), hop, key=lambda pair: pair[0])
        found[k] = lowest, best
    _, best = min(found, key=lambda pair: pair[0])
    for _ in range(settings.rounds):
        fourier = problem.fourier(best)
        if violation(robot, fourier, problem.limits) <= 0:
            return judge(robot, fourier, problem.kept)
        problem.guard(fourier)
        problem.margin, problem.sharpness = problem.margin + settings.margin, settings.sharpness[1]
        _, best = problem.solve(best, iterations)
    return None


def judge(robot: Robot, fourier: Fourier, kept: np.ndarray) -> Excitation:
    """Figures of merit of a trajectory, over columns ``kept`` of the links' regressor, at 500 instants."""
    time = np.arange(500) * fourier.period_s / 500
    Y = link_regressor(robot, fourier.motion(time))[:, :, kept].reshape(-1, len(kept))
    values = np.linalg.svd(Y, compute_uv=False)
    return Excitation(fourier, float(values[0] / values[-1]), float(2 * np.log(values / np.sqrt(500)).sum()))


def excite(
    robot: Robot,
    count: int = 6,
    *,
    harmonics: int = 5,
    base_hz: float = 0.1,
    rest: bool = False,
    criterion: Criterion = "condition",
    seed: int = 0,
    starts: int | None = None,
    iterations: int = 50,
    workers: int | None = None,
    settings: Settings | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Excitation]:
    """Different optimised trajectories of a robot, the best first, none of which leaves a limit at any time.

    Args:
        robot: with limits, and a workspace where there is one.
        count: how many.
        harmonics, base_hz: of the series (the paper: five of 0.1 Hz).
        rest: start and end at rest.
        criterion: ``"condition"`` or ``"d-optimal"``.
        seed: of the random starts.
        starts: how many are searched for; the best ``count`` are returned. One more than ``count`` by default. Where
            too few of them lead to a trajectory, further ones are tried.
        iterations: of the optimiser, at most.
        workers: processes; by default as many as serve.
        settings: of the search.
        progress: called with the number of starts finished.

    Raises:
        InputError: no limits, or no trajectory within them.
    """
    settings = settings or Settings()
    first = starts or count + 1

    def search(before: int, number: int) -> Excitation | None:
        start = 1000 * seed + before + number
        return _one((robot, harmonics, base_hz, rest, criterion, start, iterations, settings))

    good: list[Excitation] = []
    tried, planned = 0, first
    while planned:
        for result in spread(partial(search, tried), planned, workers or cores()):
            good += [result] if result is not None else []
            if progress and tried < first:
                progress(1)
            tried += 1
        planned = min(count - len(good), MORE_STARTS * first - tried) if len(good) < count else 0
    if len(good) < count:
        raise InputError(robot.name, "workspace", f"only {len(good)} of {tried} starts led to a trajectory within it")
    key = (lambda e: e.condition) if criterion == "condition" else (lambda e: -e.log_det)
    return sorted(good, key=key)[:count]
