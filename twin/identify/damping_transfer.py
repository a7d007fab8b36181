"""What data hold of damping in a posture that was not recorded.

A damper fitted in some postures predicts the damping ratios of another. Where that posture was measured too, e =
ln(measured/predicted) is the error. Its sources are the posterior of the dampers (V), the measurement (σ²), and what no
constant damper says (τ²). The last comes from friction, seals and cables that move with the robot. τ maximises the
likelihood of e ~ N(0, V + σ² + τ²). It is known from m misses only. So it predicts with the tails of Student's t, m
degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import stdtrit

from twin.identify.elastic_compare import judge
from twin.identify.posterior import Posterior
from twin.model.linear import state_matrix
from twin.model.recorded import Recorded, without_limits
from twin.model.sensitivity import Observed, frf_slopes, observe_all, structures
from twin.physics import CATALOGUE
from twin.robot.description import Robot
from twin.robot.mechanism import assemble_all

DRAWS = 60
WIDEST = 3.0  # of τ, and of one mode's ln damping: a factor of twenty
KNOWN = 0.3  # deviation of ln damping to which an FRF must hold a mode that counts
GAIN = 0.1  # deviation of a channel's gain, beyond what was estimated with the described damping
EXACT = 1e-9  # added to χ², which may be nought
STEPS = 40  # of least squares, at most
UNKNOWN = 0.46, 12
"""τ and m where no posture tells: of the KR90's Table 7 (Huynh et al. 2020), each posture predicted from the two others
(tools/study_damping_transfer.py)."""


@dataclass(frozen=True)
class Miss:
    """A mode in a posture that was not fitted to: damping ratios, and relative deviations of both."""

    posture: str
    frequency_hz: float
    measured: float
    predicted: float
    measured_spread: float
    predicted_spread: float

    @property
    def ln_ratio(self) -> float:
        """ln measured over predicted."""
        return float(np.log(self.measured / self.predicted))

    @property
    def variance(self) -> float:
        """Of that, as far as measurement and posterior explain it."""
        return self.measured_spread**2 + self.predicted_spread**2


@dataclass(frozen=True)
class Transfer:
    """How well damping is predicted: τ, degrees of freedom, and the misses that say so (none: ``UNKNOWN``)."""

    scatter: float
    freedom: int
    misses: tuple[Miss, ...] = ()

    @property
    def factor90(self) -> float:
        """The factor within which a damping ratio lies with 90 % probability, beside what the posterior says."""
        return float(np.exp(self.scatter * stdtrit(self.freedom, 0.95)))

    def known_in(self, posterior: Posterior) -> Posterior:
        """The posterior with this beside it."""
        return replace(posterior, damping_scatter=self.scatter, damping_freedom=self.freedom)

    def data(self) -> dict[str, Any]:
        """For fit.json."""
        return {
            "scatter": self.scatter, "freedom": self.freedom, "factor90": self.factor90,
            "modes": [
                {"posture": m.posture, "frequency_hz": m.frequency_hz, "measured_percent": 100 * m.measured,
                 "predicted_percent": 100 * m.predicted, "predicted_spread": m.predicted_spread}
                for m in self.misses
            ],
        }  # fmt: skip

    def __str__(self) -> str:
        if not self.misses:
            return f"damping elsewhere: not tested; within a factor of {self.factor90:.2g}, as on the KR90 of Table 7"
        postures = ", ".join(dict.fromkeys(miss.posture for miss in self.misses))
        ratios = [miss.predicted / miss.measured for miss in self.misses]
        beside = f"within a factor of {self.factor90:.2g} (90 %), besides the uncertainty of the fitted dampers"
        if self.factor90 < 1.005:
            beside = "the uncertainty of the fitted dampers explains that"
        ends = f"{min(ratios):.3g} to {max(ratios):.3g}"
        return f"damping elsewhere: predicted at {ends} of what was measured in {postures}; {beside}"


def transfer(misses: Sequence[Miss] = ()) -> Transfer:
    """τ of greatest likelihood, from modes in postures that were not fitted to."""
    if not misses:
        return Transfer(*UNKNOWN)
    square, variance = np.array([m.ln_ratio**2 for m in misses]), np.array([m.variance for m in misses])

    def cost(tau: float) -> float:
        total = variance + tau**2
        return float(np.sum(np.log(total) + square / total))

    found = minimize_scalar(cost, bounds=(0.0, WIDEST), method="bounded")
    tau = float(found.x) if found.fun < cost(0.0) else 0.0
    return Transfer(tau, len(misses), tuple(misses))


def misses_of_frf(robot: Robot, posterior: Posterior, recordings: Sequence[Recorded]) -> list[Miss]:
    """Damping of the modes in recordings that were not fitted to, beside what a fitted robot predicts there.

    First, angles and gains of a recording are estimated. Then every mode of the model may have another damping and
    another frequency, and gains may change once more. Dampers may couple any two modes (C and K change by M φᵢ φⱼᵀ M).
    What fits the FRFs best says how far off the damping was. A mode counts where the FRFs hold it to ``KNOWN``. None
    does where a law of amplitude is in the robot: its damping is no number.
    """
    robot = without_limits(robot)
    if any(CATALOGUE[entry.effect].amplitude_law for entry in robot.physics):
        return []
    found: list[Miss] = []
    for r in recordings:
        if any(miss.posture == r.setup.name for miss in found):
            continue
        judged = judge(robot, [r])
        ((seen, _),) = observe_all(robot, [r.setup], judged.parameters, judged.values)
        w, ratio, off, doubt = _modal_misses(seen, r)
        band = (w / (2 * np.pi) > r.frequency[0]) & (w / (2 * np.pi) < r.frequency[-1])
        rows = np.flatnonzero(band & (doubt < KNOWN))
        if not len(rows):
            continue
        frequency = w[rows] / (2 * np.pi)
        spread = damping_doubt(posterior, robot, r.setup.q, r.setup.brakes or "off", frequency)
        found += [
            Miss(r.setup.name, float(f), float(ratio[k] * np.exp(off[k])), float(ratio[k]), float(doubt[k]), float(own))
            for k, f, own in zip(rows, frequency, spread, strict=True)
        ]
    return found


def _modal_misses(seen: Observed, r: Recorded) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Angular frequencies and damping ratios (nm,) of a model; how far ln damping is off in FRFs, and the deviation.

    Deviations are scaled by the misfit that is left.
    """
    square, phi = eigh(seen.K, seen.M)
    kept = square > 0
    w, phi = np.sqrt(square[kept]), phi[:, kept]
    ratio = np.einsum("ik,ij,jk->k", phi, seen.C, phi) / (2 * w)
    ratio = ratio + np.einsum("ik,ij,jk->k", phi, seen.loss, phi) / (2 * w**2)
    kept = ratio > 0
    w, ratio, phi = w[kept], ratio[kept], phi[:, kept]
    push = seen.M @ phi
    inside = np.flatnonzero((w > 2 * np.pi * r.frequency[0]) & (w < 2 * np.pi * r.frequency[-1]))
    first, second = (inside[k] for k in np.triu_indices(len(inside), 1))
    nm, pairs = len(w), len(first)
    size = np.sqrt(2 * ratio * w)  # of the damping matrix, mode by mode
    outer = np.einsum("ik,jk->kij", push, push)
    cross = np.einsum("ik,jk->kij", push[:, first] * size[first], push[:, second] * size[second])
    cross = cross + cross.swapaxes(1, 2)
    none = np.zeros_like(outer)
    used = np.isfinite(r.variance)
    weight = np.sqrt(1 / r.variance[used])
    # ln damping, ln frequency, coupling over the geometric mean of two modes' damping, ln gains
    count, coupled = 2 * nm + pairs + len(seen.gain), slice(2 * nm, 2 * nm + pairs)
    prior = np.concatenate([np.full(2 * nm, 1 / WIDEST), np.ones(pairs), np.full(len(seen.gain), 1 / GAIN)])
    damp, stiff = (size**2)[:, None, None] * outer, (w**2)[:, None, None] * outer

    def at(z: np.ndarray) -> np.ndarray:
        """Derivatives of the weighted residual, prior included, and in the last column itself: rotated, as a triangle.

        Least squares asks for products of these columns alone, which a rotation of the rows leaves as they are.
        """
        grown, tuned = np.exp(z[:nm])[:, None, None], np.exp(2 * z[nm : 2 * nm])[:, None, None]
        more = (damp * (grown - 1)).sum(axis=0) + (cross * z[coupled, None, None]).sum(axis=0)
        gain = seen.gain * np.exp(z[coupled.stop :])
        now = replace(seen, C=seen.C + more, K=seen.K + (stiff * (tuned - 1)).sum(axis=0), gain=gain)
        slope = {f.name: np.zeros((count, *getattr(seen, f.name).shape)) for f in fields(Observed)[:-1]}
        slope["C"][: coupled.stop] = np.concatenate([damp * grown, none, cross])
        slope["K"][nm : 2 * nm] = 2 * stiff * tuned
        slope["gain"][coupled.stop :] = np.diag(gain)
        rate = Observed.of(slope.values())
        H, slopes = frf_slopes(now, rate, r.s, r.power)
        rows = np.concatenate([slopes[:, used], (H - r.frf)[None, used]]) * weight
        rows = np.ascontiguousarray(rows).view(float)
        held = np.vstack([np.diag(prior), prior * z])
        square = rows @ rows.T + held @ held.T
        square[-1, -1] += EXACT
        return np.linalg.cholesky(square).T

    kept_at: dict[bytes, np.ndarray] = {}

    def known(z: np.ndarray) -> np.ndarray:
        if z.tobytes() not in kept_at:
            kept_at.clear()
            kept_at[z.tobytes()] = at(z)
        return kept_at[z.tobytes()]

    found = least_squares(
        lambda z: known(z)[:, -1], np.zeros(count), lambda z: known(z)[:, :-1], bounds=(-WIDEST, WIDEST), x_scale="jac",
        max_nfev=STEPS, ftol=1e-6, xtol=1e-6,
    )  # fmt: skip
    chi2 = float(found.fun @ found.fun - np.sum((prior * found.x) ** 2)) / (2 * used.sum())
    deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * max(1.0, chi2))
    return w, ratio, found.x[:nm], deviation[:nm]


def damping_doubt(
    posterior: Posterior, robot: Robot, q: np.ndarray, brakes: str, frequency_hz: np.ndarray
) -> np.ndarray:
    """Deviation (nm,) of ln damping ratio of modes at given frequencies, as far as the posterior knows it.

    Args:
        robot: the fitted one, without limits; ``q`` (n,) rad (m).
        frequency_hz: (nm,) of the fitted robot's modes; in each draw the nearest is taken.
    """
    values: list[list[float]] = []
    for drawn in posterior.robots(robot, DRAWS):
        (model,) = structures(assemble_all(drawn, [q], brakes="off" if brakes == "off" else "on"))
        pole = np.linalg.eigvals(state_matrix(model.M, model.C, model.K, model.loss, model.integral))
        pole = pole[pole.imag > 1e-6 * np.abs(pole)]
        f, ratio = np.abs(pole) / (2 * np.pi), -pole.real / np.abs(pole)
        values.append([ratio[int(np.argmin(np.abs(np.log(f / wanted))))] for wanted in frequency_hz])
    return np.asarray(np.log(np.array(values)).std(axis=0)).reshape(len(frequency_hz))
