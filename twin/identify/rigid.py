"""Rigid-body parameters from torque logs: least squares on rows of torque, a physically consistent set."""

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import ndtri

from twin.errors import InputError
from twin.measure.campaign import FloatArray
from twin.measure.motion_log import LEAST_MOTION, MotionLog, MotionRun, refuse_saturated, refuse_without_motion
from twin.measure.torque_unit import unit_note
from twin.model.base_parameters import BaseParameters, base_parameters, structural_base
from twin.model.linear import symmetric
from twin.model.possible import floors, nearest_possible
from twin.model.regressor import Regressor, inertial_vector
from twin.model.torque_base import with_whole_friction
from twin.model.torque_noise import MOST_TAKEN, ROUNDED
from twin.model.torque_rows import (
    PASSED,
    TOO_SHORT,
    Bands,
    Rows,
    Split,
    joint_run,
    lost_rotor_terms,
    relative_error,
    rows_of,
    split,
)
from twin.physics import CATALOGUE
from twin.physics.motion import gradual_sign
from twin.robot.description import Robot
from twin.robot.frames import inertia_six

SHORT_S = 40.0  # of motion in all: 4 Hz of it have 800 rows of a joint
LOW_PASSES = ((8.0, 10.0), (16.0, 20.0), (32.0, 40.0))  # Hz: low-passes tried on what is shorter


@dataclass(frozen=True)
class Estimate:
    """Base parameters by least squares.

    Attributes:
        base: what they are combinations of.
        value: (b,).
        covariance: (b, b), with the residuals' correlation in time, and the doubt how friction changes its sign.
        noise: (n,) standard deviation of the residual per joint, N·m (N).
        samples, effective: (n,) rows used, and as many independent ones as they are worth.
        identifiable: (b,) whether the low-pass lets the parameter through and the data holds it.
    """

    base: BaseParameters
    value: FloatArray
    covariance: FloatArray
    noise: FloatArray
    samples: np.ndarray
    effective: FloatArray
    identifiable: np.ndarray

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations (b,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def interval90(self) -> FloatArray:
        """Bounds (b, 2) that hold the truth nine times in ten."""
        return self.value[:, None] + float(ndtri(0.95)) * self.deviation[:, None] * np.array([-1.0, 1.0])


def least_squares(
    regressor: Regressor, rows: list[Rows], weighting: str = "joint", source: str = "motion log"
) -> Estimate:
    """Base parameters from the valid rows (paper, Eqs. 6 and 7).

    Args:
        regressor: whose columns the rows hold.
        rows: runs to fit.
        weighting: ``"joint"`` divides every joint's rows by its noise (found by iteration); ``"none"`` is ordinary
            least squares. Deviations are right for either: they come from the residual's own correlation in time
            (sandwich estimate), not from the number of rows. How dry friction changes its sign is not known. Estimates
            differ between a step and any gradual change; the difference counts as one standard deviation.
        source: the file named in errors.

    Raises:
        InputError: fewer rows than parameters.
    """
    base = structural_base(regressor)
    data = np.concatenate([r.matrix[r.valid] for r in rows])  # (m, n, p)
    torque = np.concatenate([r.torque[r.valid] for r in rows])
    m, n, _ = data.shape
    if m * n < 2 * len(base.kept):
        seconds = sum(r.valid.sum() / r.rate_hz for r in rows)
        raise InputError(source, "runs", f"{seconds:.2g} s to fit are too few for {len(base.kept)} parameters")
    # What this motion does not move apart stays together, whatever the robot could do.
    base = _merge(base, base_parameters(data[:, :, base.kept].reshape(m * n, -1), [base.columns[k] for k in base.kept]))
    A = data[:, :, base.kept]
    noise = np.ones(n)
    for _ in range(1 if weighting == "none" else 4):
        value = _weighted(A, torque, noise)
        residual = torque - A @ value
        if weighting != "none":
            noise = np.maximum(np.sqrt(np.mean(residual**2, axis=0)), 1e-9 * np.abs(torque).max(axis=0) + 1e-300)
    covariance, effective = _sandwich(rows, base, value, noise)
    turned = _weighted(*without_turning(rows, base.kept), noise) - value
    covariance = covariance + np.outer(turned, turned)
    deviation = np.sqrt(np.diag(covariance))
    passed = np.max([r.passed[base.kept] for r in rows], axis=0)
    shares = np.sqrt(np.mean(np.square(A), axis=0)) / np.maximum(np.abs(torque).max(axis=0), 1e-300)[:, None]
    strength = shares.max(axis=0)  # of a joint's torque per unit, on the joint that shows it most
    scale_of = np.maximum(np.abs(value), 0.1 / np.maximum(strength, 1e-300))
    identifiable = (passed > PASSED) & (deviation < scale_of)
    rms = np.sqrt(np.mean(residual**2, axis=0))
    return Estimate(base, value, covariance, rms, np.full(n, m), effective, identifiable)


def _weighted(A: FloatArray, torque: FloatArray, noise: FloatArray) -> FloatArray:
    """Least squares (b,) of A (m, n, b) on torque (m, n), every joint's rows divided by its noise (n,)."""
    weighted = (A / noise[None, :, None]).reshape(torque.size, -1)
    scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
    return np.linalg.lstsq(weighted / scale, (torque / noise).ravel(), rcond=None)[0] / scale


def without_turning(rows: list[Rows], kept: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Valid rows of the columns ``kept`` (m, n, b) and of torque (m, n), less what follows each joint's ``turning``.

    Least squares of them is that with the columns ``turning`` more (Frisch and Waugh, Econometrica 1, 1933): friction
    may then change its sign over any speed or travel, to first order.
    """
    turning = np.concatenate([r.turning[r.valid] for r in rows])
    there = np.concatenate(
        [np.concatenate([r.matrix[:, :, kept], r.torque[:, :, None]], axis=2)[r.valid] for r in rows]
    )
    for j in range(there.shape[1]):
        there[:, j] -= turning[:, j] @ (np.linalg.pinv(turning[:, j], rcond=1e-9) @ there[:, j])
    return there[:, :, :-1], there[:, :, -1]


def _merge(structural: BaseParameters, excited: BaseParameters) -> BaseParameters:
    return BaseParameters(
        structural.columns,
        structural.kept[excited.kept],
        excited.combine @ structural.combine,
        np.union1d(structural.none, structural.kept[excited.none]).astype(int),
    )


def _sandwich(
    rows: list[Rows], base: BaseParameters, value: FloatArray, noise: FloatArray, longest_s: float = 4.0
) -> tuple[FloatArray, FloatArray]:
    """Covariance (b, b) of weighted least squares under noise that is stationary and coloured, joint by joint.

    Residuals farther apart than ``longest_s`` are taken as independent.
    """
    b, n = len(value), len(noise)
    lags = max(1, int(longest_s * rows[0].rate_hz))
    lag = np.arange(lags + 1) / (lags + 1)
    parzen = np.where(lag < 0.5, 1 - 6 * lag**2 + 6 * lag**3, 2 * (1 - lag) ** 3)
    weighted = [np.where(r.valid[:, None, None], r.matrix[:, :, base.kept], 0.0) / noise[None, :, None] for r in rows]
    information = sum(np.einsum("mjb,mjc->bc", A, A) for A in weighted)
    scale = 1 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    root = scale[:, None] * np.linalg.cholesky(symmetric(inverse / np.outer(scale, scale)))
    spread = np.zeros((b, b))
    effective = np.zeros(n)
    for j in range(n):
        residual, leverage, pairs = np.zeros((3, lags + 1))
        spectra = []
        for r, A in zip(rows, weighted, strict=True):
            e = np.where(r.valid, r.torque[:, j] / noise[j] - A[:, j] @ value, 0.0)
            size = scipy.fft.next_fast_len(len(e) + lags + 1, real=True)
            columns = scipy.fft.rfft(A[:, j], size, axis=0)
            powers = np.stack([
                np.abs(scipy.fft.rfft(e, size)) ** 2,
                np.sum(np.abs(columns @ root) ** 2, axis=1),
                np.abs(scipy.fft.rfft(r.valid.astype(float), size)) ** 2,
            ])  # fmt: skip
            for total, correlation in zip(
                (residual, leverage, pairs), scipy.fft.irfft(powers, size)[:, : lags + 1], strict=True
            ):
                total += correlation
            spectra.append((columns, size))
        density = parzen / np.maximum(pairs, 1)
        for columns, size in spectra:
            # the fit has taken its share out of the residual, line by line: what the leverage says
            taken = np.clip(_density(leverage * density, size), 0.0, MOST_TAKEN)
            power = np.maximum(_density(residual * density, size), 0.0) / (1 - taken)
            lines = np.full(len(power), 2.0)
            lines[0] = 1.0
            if size % 2 == 0:
                lines[-1] = 1.0
            spread += np.real(np.einsum("k,kb,kc->bc", lines * power / size, columns.conj(), columns, optimize=True))
        effective[j] = min(pairs[0] * (lines @ power / size) / max(power[0], 1e-300), pairs[0])
    return inverse @ spread @ inverse, effective


def _density(series: FloatArray, size: int) -> FloatArray:
    """Power of each line of a transform of ``size`` samples, from one-sided autocorrelation."""
    circle = np.zeros(size)
    circle[: len(series)] = series
    circle[size - len(series) + 1 :] += series[:0:-1]
    return scipy.fft.rfft(circle).real


def consistent(regressor: Regressor, estimate: Estimate, margin: float = 1e-3) -> FloatArray:
    """All parameters (p,) of a robot that can exist, as near to the estimate and the description as both allow.

    Minimises (K x − π̂)ᵀ Σ⁻¹ (K x − π̂) + Σ z², z the departure from the description in its tolerances. The
    pseudo-inertia of a body and the inertia of a rotor stay above ``margin`` times the described one, and friction ≥ 0.
    That is a convex problem in the cone of positive semidefinite matrices (Wensing, Kim, Slotine 2018), solved by
    Clarabel.
    """
    columns, x0 = regressor.columns, regressor.described
    K = estimate.base.combine
    step = _prior_steps(regressor, estimate)
    prior = np.array([1.0 if column.group in ("link", "rotor") else 0.0 for column in columns])
    usable = estimate.identifiable
    root = _inverse_root(symmetric(estimate.covariance[np.ix_(usable, usable)]))
    G = root @ K[usable] @ step
    target = root @ (estimate.value[usable] - K[usable] @ x0)
    H = G.T @ G + np.diag(np.where(prior > 0, prior, 1e-6))
    linear = -G.T @ target
    x = x0 + step @ nearest_possible(regressor, H, linear, x0, step, margin)
    floor, least = floors(regressor, margin)
    return np.where(floor, np.maximum(x, least), x)


def _inverse_root(covariance: FloatArray, least: float = 1e-12) -> FloatArray:
    """R (n, n) with RᵀR = Σ⁻¹; correlations' eigenvalues are kept above ``least``, where rounding leaves less."""
    deviation = np.sqrt(np.diag(covariance))
    if not len(covariance):
        raise np.linalg.LinAlgError("no parameter is identifiable")
    value, vectors = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    return (vectors / np.sqrt(np.maximum(value, least * value[-1]))).T / deviation


def _prior_steps(regressor: Regressor, estimate: Estimate) -> FloatArray:
    """Columns of a matrix (p, p): the change of all parameters per standard deviation of one thing described."""
    robot, columns = regressor.robot, regressor.columns
    tolerance = robot.tolerances
    step = np.zeros((len(columns), len(columns)))
    for i, link in enumerate(robot.links):
        mass, com, inertia = link.inertial
        part = slice(10 * i, 10 * i + 10)
        here = inertial_vector(mass, com, inertia)
        h = 1e-6
        block = np.zeros((10, 10))
        block[:, 0] = (inertial_vector(mass * (1 + h), com, inertia) - here) / h * tolerance.mass
        for k in range(3):
            moved = [inertial_vector(mass, com + sign * h * np.eye(3)[k], inertia) for sign in (1, -1)]
            block[:, 1 + k] = (moved[0] - moved[1]) / (2 * h) * tolerance.com
        size = inertia_six(np.sqrt(np.outer(np.diag(inertia), np.diag(inertia))))
        block[4:, 4:] = np.diag(np.array(size) * tolerance.inertia)
        step[part, part] = block
    largest = {k: abs(v) + d for k, v, d in zip(estimate.base.kept, estimate.value, estimate.deviation, strict=True)}
    for k, column in enumerate(columns):
        if column.group == "rotor":
            number = k - 10 * robot.axis_count
            drive, assumed = robot.drives[number], float(np.expm1(robot.rotor_scatter(number)))
            unknown = max(link.inertial[2].max() for link in robot.links) / drive.gear_ratio**2
            step[k, k] = max(tolerance.inertia, assumed) * drive.rotor_inertia or unknown
        elif column.group != "link":
            step[k, k] = max(abs(column.value), largest.get(k, 0.0), 1e-3)
    return step


@dataclass(frozen=True)
class Identification:
    """What a motion log says about a robot.

    Attributes:
        regressor: columns, and the description that was given.
        estimate: base parameters by least squares.
        parameters: (p,) of the physically consistent set.
        robot: the description with these.
        split: what was fitted and what held out.
        bands: low-passes.
        notes: what was found and repaired.
    """

    regressor: Regressor
    estimate: Estimate
    parameters: FloatArray
    robot: Robot
    split: Split
    bands: Bands
    notes: list[str] = field(default_factory=list)

    def least_squares_parameters(self) -> FloatArray:
        """The estimate spread over the columns (p,): base parameters in the kept columns, nothing in the others."""
        x = np.zeros(len(self.regressor.columns))
        x[self.estimate.base.kept] = self.estimate.value
        return x


def identify(
    log: MotionLog,
    robot: Robot,
    *,
    bands: Bands | None = None,
    hold_out: list[str] | None = None,
    weighting: str = "joint",
    offsets: bool = True,
) -> Identification:
    """Identify the rigid-body side of a robot: inertias, rotors, friction, compensator.

    Args:
        log: runs as recorded (motor coordinates), with torque.
        robot: prior inertias, and the physics entries whose parameters are wanted.
        bands: low-passes; by default the paper's 3–4 Hz for torque and columns, of a log shorter than ``SHORT_S`` what
            :func:`predicting_best` says.
        hold_out: names of runs not to fit; chosen when ``None``.
        weighting: ``"joint"`` or ``"none"``.
        offsets: estimate a constant torque per joint, which belongs to the recording.

    Raises:
        InputError: no torque, too little of it, or torque that is cut off for more than 5 % of a run.
    """
    robot = with_whole_friction(robot)
    if bands is None and (found := predicting_best(log, robot, hold_out, weighting, offsets)):
        return found
    bands = bands or Bands()
    regressor, notes = Regressor(robot, offsets), list(log.notes)
    rows = _usable_rows(log, regressor, bands, notes)
    parts = split(rows, hold_out, bands, log.source)
    estimate = least_squares(regressor, parts.train, weighting, log.source)
    try:
        parameters = consistent(regressor, estimate)
    except (ArithmeticError, np.linalg.LinAlgError):
        try:  # a recording without noise, or hardly longer than its parameters need
            parameters = consistent(regressor, _rounded(estimate, parts.train))
        except (ArithmeticError, np.linalg.LinAlgError):
            message = "tell too little of the robot's parameters: record a longer motion of all axes (`twin excite`)"
            raise InputError(log.source, "runs", message) from None
    notes += filter(None, [other_unit(regressor, rows)])
    notes += _lost_terms(robot, log.runs[rows[0].name], bands)
    notes += _without_friction(robot, parts, parameters)
    found = Identification(
        regressor, estimate, parameters, regressor.robot_with(parameters), parts, bands, notes
    )  # fmt: skip
    notes += [*_standing_still(found), *_unlike_described(found), *_poorly_predicted(found)]
    return found


def predicting_best(
    log: MotionLog, robot: Robot, hold_out: list[str] | None = None, weighting: str = "joint", offsets: bool = True
) -> Identification | None:
    """What a log shorter than ``SHORT_S`` says, through the low-pass that serves it best.

    ``None`` of a longer one, or one whose sample rate is below 2.5 times the first of ``LOW_PASSES``. A few
    seconds below 4 Hz have fewer rows than a robot has parameters. A wider band has more, if the robot is rigid in it.
    Of the usual low-pass and ``LOW_PASSES``, that one is taken whose estimate best predicts the held-out torque below
    ``LOW_PASSES[0]``. A log that is too short for the usual one is too short.
    """
    seconds = sum(float(np.ptp(run.time)) for run in log.runs.values())
    rate = min((run.sample_rate_hz for run in log.runs.values()), default=0.0)
    if seconds >= SHORT_S or rate < 2.5 * LOW_PASSES[0][1]:
        return None
    judged, usual = Bands(fit=LOW_PASSES[0]), Bands()
    rows: list[Rows] = []
    best, least = None, np.inf
    for bands in (usual, *(Bands(fit=fit) for fit in LOW_PASSES if rate >= 2.5 * fit[1])):
        found = identify(log, robot, bands=bands, hold_out=hold_out, weighting=weighting, offsets=offsets)
        rows = rows or split(_usable_rows(log, found.regressor, judged, []), hold_out, judged, log.source).held_out
        missed = float(np.mean(relative_error(rows, found.parameters)[0] ** 2))
        if missed < least:
            best, least = found, missed
    if best is not None and best.bands != usual:
        low, high = best.bands.fit
        told = f"{seconds:.2g} s are short: the low-pass of {low:g}–{high:g} Hz predicts what was held out best"
        best.notes.insert(0, told)
    return best


def _rounded(estimate: Estimate, rows: list[Rows]) -> Estimate:
    """The estimate with the noise that a converter adds to torque, ``ROUNDED``, for a recording that has none."""
    data, torque = (np.concatenate([getattr(r, name)[r.valid] for r in rows]) for name in ("matrix", "torque"))
    noise = np.maximum(ROUNDED * np.sqrt(np.mean(torque**2, axis=0)), 1e-300)
    weighted = (data[:, :, estimate.base.kept] / noise[:, None]).reshape(-1, len(estimate.value))
    scale = np.linalg.norm(weighted, axis=0)
    inverse = np.linalg.inv((weighted / scale).T @ (weighted / scale))
    return replace(estimate, covariance=estimate.covariance + inverse / np.outer(scale, scale))


def _usable_rows(log: MotionLog, regressor: Regressor, bands: Bands, notes: list[str]) -> list[Rows]:
    """Every run that can be used, as rows; what was left out of it goes to the notes.

    Raises:
        InputError: as :func:`identify`.
    """
    rows = []
    refuse_without_motion(log, log.source)
    for name, run in log.runs.items():
        if run.torque is None:
            raise InputError(
                log.source,
                f"runs/{name}/torque",
                "missing; expected a recording: of a trajectory alone nothing can be identified",
            )
        if run.sample_rate_hz < 2.5 * bands.fit[1]:
            raise InputError(
                log.source, f"runs/{name}/sample_rate_hz",
                f"{run.sample_rate_hz:g} Hz is too slow for a low-pass to {bands.fit[1]:g} Hz; give --low-pass",
            )  # fmt: skip
        cut = refuse_saturated(run, log.source)
        for i in np.flatnonzero(cut.any(axis=0)):
            notes.append(
                f"runs/{name}: torque of joint{i + 1} is cut off at {np.abs(run.torque[cut[:, i], i]).max():.4g} for "
                f"{cut[:, i].sum() / run.sample_rate_hz:.2g} s; left out with the filter's memory around it"
            )
        made = rows_of(regressor, joint_run(regressor.robot, run), bands)
        if not made.valid.any():
            notes.append(f"runs/{name}: {TOO_SHORT.format(run.time[-1] - run.time[0])}; left out")
            continue
        rows.append(made)
    if not rows:
        raise InputError(log.source, "runs", TOO_SHORT.format(max(np.ptp(run.time) for run in log.runs.values())))
    return rows


def other_unit(regressor: Regressor, rows: list[Rows]) -> str | None:
    """Of rows a note where their torque is of another size than the robot as described needs; ``None`` where not."""
    described, recorded = (
        np.concatenate([torque[r.valid] for torque, r in zip(some, rows, strict=True)])
        for some in ([r.matrix @ regressor.described + r.known for r in rows], [r.torque + r.known for r in rows])
    )
    return unit_note(described, recorded)


def _without_friction(robot: Robot, parts: Split, parameters: FloatArray, most: float = 0.5) -> list[str]:
    """Where friction that the description lacks would take ``most`` of the residual's power, of runs held out."""
    rubbing = {e.site.partition(".")[0] for e in robot.physics if CATALOGUE[e.effect].role == "friction"}
    lacking, shares = [], []
    for j in range(robot.axis_count):
        columns, rest = [], []
        for rows in (parts.train, parts.held_out):
            speed = np.concatenate([r.velocity[r.valid, j] for r in rows])
            columns.append(np.column_stack([gradual_sign(speed), speed]))
            rest.append(np.concatenate([(r.torque - r.matrix @ parameters)[r.valid, j] for r in rows]))
        left = rest[1] - columns[1] @ np.linalg.lstsq(columns[0], rest[0], rcond=None)[0]
        share = 1 - float(left @ left) / max(float(rest[1] @ rest[1]), 1e-300)
        if share > most and f"joint{j + 1}" not in rubbing:
            lacking.append(f"joint{j + 1}")
            shares.append(share)
    if not lacking:
        return []
    return [
        f"{', '.join(lacking)}: the description has no friction; it would take {min(shares):.0%} to {max(shares):.0%} "
        "of the error's power on what was held out. `twin describe` writes it into a description, `twin diagnose` "
        "finds it"
    ]


def _unlike_described(found: Identification, times: float = 2.0, least: float = 0.02) -> list[str]:
    """Where the physically consistent set, near the description, misses ``times`` what least squares miss held out.

    Errors below ``least`` of a joint's torque, which nobody sees in an overlay, are left alone. Both are by eye.
    """
    rows = found.split.held_out
    (near, _), (free, _) = (relative_error(rows, x) for x in (found.parameters, found.least_squares_parameters()))
    worse = [j for j in range(found.regressor.robot.axis_count) if near[j] > max(times * free[j], least)]
    if not worse:
        return []
    told = ", ".join(f"joint{j + 1} {near[j]:.1%} against {free[j]:.1%}" for j in worse)
    return [
        f"the robot that is written misses what was held out by far more than free least squares do ({told}). The "
        "description keeps it there: something is missing from it, as a payload, or its tolerances are too narrow. "
        "`twin diagnose` finds what"
    ]


def _standing(parts: Split) -> NDArray[np.bool_]:
    """Joints (n,) that never move."""
    return np.all([np.ptp(rows.position, axis=0) < LEAST_MOTION for rows in (*parts.train, *parts.held_out)], axis=0)


def _standing_still(found: Identification) -> list[str]:
    """Joints that never move, in words."""
    still = [f"joint{j + 1}" for j in np.flatnonzero(_standing(found.split))]
    if not still:
        return []
    return [
        f"{', '.join(still)} stand{'s' if len(still) == 1 else ''} still throughout: this log shows no friction and no "
        "rotor there, and of the links only what the other axes move. `twin excite` plans a motion of all axes"
    ]


def _poorly_predicted(found: Identification, most: float = 0.2) -> list[str]:
    """Joints whose torque no set of parameters predicts: held out, least squares miss more than ``most`` of it.

    Identified robots of the literature miss 3 to 15 %.
    """
    free, _ = relative_error(found.split.held_out, found.least_squares_parameters())
    still = _standing(found.split)
    poor = [f"joint{j + 1} {missed:.0%}" for j, missed in enumerate(free) if missed > most and not still[j]]
    if not poor:
        return []
    return [
        f"what was held out is missed by {', '.join(poor)} of the torque, even by free least squares: the model lacks "
        "physics there, and the parameters make up for it. Do not rely on them. `twin diagnose` looks for what is "
        "missing"
    ]


def _lost_terms(robot: Robot, run: MotionRun, bands: Bands) -> list[str]:
    """Of a run as recorded, what the low-pass leaves of rotors' terms, in words."""
    return [
        f"{term}: not identifiable, the low-pass leaves {share:.0%} of its torque, a sine of twice the motor's angle"
        if share < PASSED
        else f"{term}: not modelled, though {share:.0%} of its torque passes, a sine of twice the motor's angle"
        for term, share in lost_rotor_terms(robot, joint_run(robot, run), bands).items()
    ]
