"""What runs that were kept aside say of a model, and how much a free function of a joint's state would explain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from twin.diagnose.calibration import calibration
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import base_fit
from twin.diagnose.torque_step import REFITTED, Step
from twin.diagnose.torque_system import System, Trial, extended, linearised, refer, relinearised, with_wider
from twin.measure.campaign import FloatArray
from twin.model.torque_base import Base, base_of
from twin.model.torque_laws import USUAL_SHARE, smooth_columns
from twin.model.torque_noise import span_of
from twin.model.torque_signal import Run
from twin.model.torque_whitened import Columns
from twin.parallel import spread
from twin.physics import effect_named

UNSEEN = 0.01  # of the squares of an error: a rise that nobody sees in an overlay, half a percent of its RMS


def free_gains(system: System, processes: int = 1, judge: "Judge | None" = None) -> FloatArray:
    """Evidence (n,) gained by a free smooth function of each joint's position and velocity.

    It counts for nothing where it does not predict the rows kept aside: it has fitted the noise.
    """
    _ = system.residual  # once, for all processes
    free = list(spread(lambda j: free_function(system, j), len(system.whitening), processes))
    least = calibration()["first"]
    return np.array([
        0.0 if judge is not None and f.gain > least and not judge.bears_out(system, f) else f.gain for f in free
    ])  # fmt: skip


def vibration(system: System, joint: int) -> float:
    """ln evidence gained by the vibration at a joint, of a fixed frequency, that explains most of what a model misses.

    Its amplitude and phase are each run's own. For white residuals the periodogram is what a sine of that frequency
    takes off ½ χ². Amplitude and phase together cost ln N (Schwarz, Annals of Statistics 6, 1978).
    """
    rest, at = system.residual[system.rows(joint)], 0
    longest = scipy.fft.next_fast_len(2 * max(len(mask) for mask in system.masks))
    gain = np.zeros(longest // 2 + 1)
    for mask in system.masks:
        count = int(mask.sum())
        signal = np.zeros(len(mask))
        signal[mask] = rest[at : at + count]
        at += count
        power = np.abs(scipy.fft.rfft(signal, longest)) ** 2 / max(count, 1)
        gain += np.maximum(power - np.log(max(count, 1)), 0.0)
    return float(gain[1:].max())


@dataclass(frozen=True)
class FreeFunction:
    """A smooth function of a joint's position and velocity, fitted beside the base model.

    Attributes:
        joint: zero-based; ``gain`` ln evidence over the base model.
        span: middle and half of the joint's range, and its largest speed, in rad and rad/s (m, m/s).
        coefficients: (b,) of :func:`smooth_columns`, N·m (N).
        moved: (z,) what it changes the base model's numbers by.
    """

    joint: int
    gain: float
    span: tuple[float, float, float]
    coefficients: FloatArray
    moved: FloatArray


def free_function(system: System, joint: int) -> FreeFunction:
    """The smooth function of a joint's position and velocity that explains most of what a model misses."""
    runs, span = system.base.runs, span_of(system.base.runs, joint)
    scale = USUAL_SHARE * np.sqrt(np.mean(np.concatenate([r.torque[r.valid, joint] for r in runs]) ** 2))
    rows = system.whitened(joint, [scale * smooth_columns(run, joint, *span) for run in runs])
    whitened = Columns((joint,), rows)
    information, pull = system.projected(whitened)
    inside = information + np.eye(len(pull))
    c = np.linalg.solve(inside, pull)
    gain = float(0.5 * pull @ c - 0.5 * np.linalg.slogdet(inside)[1])
    moved = -np.asarray(system.inverse @ (system.across(whitened).T @ c))
    return FreeFunction(joint, gain, span, scale * c, moved)


@dataclass(frozen=True)
class Told:
    """What rows kept aside say of one thing more in a model.

    Attributes:
        rise: of the ln predictive density, over Birge's ratio; ``enough`` to believe it.
        falls: the error of the joints it acts on falls; of what relieves numbers of the description, it does not rise.
    """

    rise: float
    enough: bool
    falls: bool


class Judge:
    """Rows kept aside, whitened as those used; the offsets of their runs are their own.

    A fit is judged by how likely it made them (the posterior predictive): what it does not know of its numbers is no
    merit and no fault.
    """

    def __init__(self, system: System, kept: Sequence[Run]) -> None:
        self.base: Base = base_of(system.base.regressor, kept, system.base.sliding)
        self.system = System(self.base, system.whitening, self.base.parameters, level=system.level, noise=system.noise)
        refer(self.system, np.zeros(len(self.base.parameters)))
        self.system.assemble()
        self.before: tuple[System, tuple[FloatArray, float]] | None = None

    def _align(self, system: System) -> None:
        """Friction is in doubt where and when it is in the system that is judged."""
        if not np.array_equal(self.system.turning, system.turning) or self.system.late != system.late:
            self.system = replace(self.system, turning=system.turning, late=system.late)
            self.system.assemble()

    def rest(self, system: System, fit: Fitted) -> tuple[FloatArray, float]:
        """Whitened residual (N,) of a fit of a system's numbers, its own offsets estimated, and ln predictive density.

        Without what is common to all models.
        """
        residual, _, density = self._on_kept(system, fit)
        return residual, density

    def bears_out(self, system: System, free: FreeFunction) -> bool:
        """Whether a free function, as it was fitted to the rows used, lowers the misfit of those kept aside enough."""
        fit, joint = base_fit(system), free.joint
        torque = [smooth_columns(run, joint, *free.span) @ free.coefficients[:, None] for run in self.base.runs]
        beside = self.system.full(Columns((joint,), self.system.whitened(joint, torque)))[:, 0]
        before = self.rest(system, fit)[0]
        after = self._on_kept(system, replace(fit, z=fit.z + free.moved), beside)[0]
        fall = 0.5 * float(before @ before - after @ after)
        return fall > calibration()["held_out_share"] * free.gain * self.system.count / max(system.count, 1)

    def misfit(self, system: System, fit: Fitted) -> float:
        """χ² per datum of the rows kept aside, what the fit does not know of its numbers beside their noise."""
        return self._on_kept(system, fit)[1] / (self.system.count * float(self.system.level.sum()))

    def left(self, plain: System, base: Fitted, system: System, fit: Fitted) -> float:
        """Share of the squares of a base model's error beyond noise that a fit leaves."""
        noise = self.system.count * float(self.system.level.sum())
        before, after = (float(np.sum(self.rest(*one)[0] ** 2)) - noise for one in ((plain, base), (system, fit)))
        return max(after, 0.0) / max(before, after, 1e-300)

    def _on_kept(
        self, system: System, fit: Fitted, beside: FloatArray | float = 0.0
    ) -> tuple[FloatArray, float, float]:
        """Residual as in :meth:`rest`, χ² under the posterior predictive, and its ln density.

        ``beside`` (N,) is whitened torque that acts beside the model.
        """
        self._align(system)
        shared, width = self.base.lasting, len(self.base.parameters)
        own = len(fit.z) - len(system.base.parameters)
        lasting = np.r_[:shared, len(fit.z) - own : len(fit.z)]
        here = replace(
            self.system, found=system.found, parameters=system.parameters, widened=system.widened,
        )  # fmt: skip
        z = np.concatenate([fit.z[:shared], np.zeros(width - shared), fit.z[len(fit.z) - own :]])
        prior, covariance, doubt = (
            np.eye(len(z)),
            np.linalg.inv(fit.information)[np.ix_(lasting, lasting)],
            np.ones(len(z)),
        )
        at = np.r_[:shared, width : len(z)]
        prior[np.ix_(at, at)] = np.linalg.inv(covariance)
        doubt[at] = np.sqrt(np.diag(covariance))
        here, _ = linearised(here, z, doubt)
        residual = here.y - here.A.times(z) - beside
        posterior = prior + here.A.gram
        pull = here.A.transposed(residual)
        energy = float(residual @ residual - pull @ np.linalg.solve(posterior, pull))
        density = -0.5 * (energy + np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(prior)[1])
        offsets = np.arange(shared, width)
        moved = np.zeros(len(z))
        moved[offsets] = np.linalg.solve(posterior[np.ix_(offsets, offsets)], pull[offsets])
        return residual - here.A.times(moved), energy, float(density)

    def gain(self, system: System, fit: Fitted, trial: Trial | None) -> tuple[float, bool]:
        """Rise of the ln predictive density over Birge's ratio, and whether it is enough to believe the fit."""
        wide, settled = with_wider(system, fit.hypothesis) if fit.hypothesis.scale else system, fit
        if trial is not None:
            wide = extended(system, trial)
        if trial is not None and (system.found or trial.suspect.effect.refers):
            wide = relinearised(wide, REFITTED)  # what was found before, or the torques it is made of, beside the new
            settled = base_fit(wide)
        if self.before is None or self.before[0] is not system:  # several are put to one model
            self.before = system, self.rest(system, base_fit(system))
        base, ages = base_fit(system), effect_named(fit.hypothesis.effect).ages
        gained, joints = fit.evidence() - base.evidence(), self._of(trial)
        told = self._compared((system, base), (wide, settled), self.before[1], gained, joints, ages)
        return told.rise, told.enough

    def keeps(self, without: System, system: System, step: Step) -> "Told":
        """What the rows kept aside say of something found, all else that was found in both models."""
        one, other = base_fit(without), base_fit(system)
        gained, before = other.evidence() - one.evidence(), self.rest(without, one)
        joints, ages = self._of(step.trial), step.effect.ages
        return self._compared((without, one), (system, other), before, gained, joints, ages)

    def _of(self, trial: Trial | None) -> tuple[int, ...]:
        """Joints that an effect acts on; all of them for a number of the description."""
        return trial.column.joints if trial is not None else tuple(range(len(self.system.whitening)))

    def _compared(
        self, one: tuple[System, Fitted], other: tuple[System, Fitted], told: tuple[FloatArray, float], gained: float,
        joints: tuple[int, ...], ages: bool,
    ) -> "Told":  # fmt: skip
        """Of a model and another with one thing more, ``told`` residual and density of the first, evidence gained."""
        base, settled = one[1], other[1]
        (before, density), (after, reached) = told, self.rest(*other)
        data = self.system.count * float(self.system.level.sum())
        rise, scale = reached - density, max(1.0, float(after @ after) / data)
        own = [sum(float(np.sum(rest[self.system.rows(j)] ** 2)) for j in joints) for rest in (before, after)]
        trained = 0.5 * (base.misfit * base.data - settled.misfit * settled.data)
        expected = trained * self.system.count / max(one[0].count, 1)
        if ages:
            expected = min(expected, 0.5 * float(np.sum((before - after) ** 2)))
        # What only relieves the tension of numbers against their priors cannot show here: it must do no harm.
        numbers, power = calibration(), 0.5 * own[0]
        if trained < numbers["mostly"] * gained:
            harmless = rise > -numbers["tie"] * scale - UNSEEN * power
            return Told(rise / scale, bool(harmless), own[1] <= (1 + UNSEEN) * own[0])
        least = max(numbers["held_out_share"] * expected, numbers["least_held_out_fall"] * power)
        larger = after @ after > (1 + UNSEEN) * (before @ before)  # doubt of other numbers excuses no larger error
        return Told(rise / scale, bool(rise > least and not larger), own[1] < own[0])

    def moves(self, system: System, fit: Fitted, trial: Trial, joint: int) -> bool:
        """Whether a joint's residual on the rows kept aside falls as anybody can see, with a law fitted beside all."""
        rows = self.system.rows(joint)
        before = float(np.sum(self.rest(system, base_fit(system))[0][rows] ** 2))
        after = float(np.sum(self.rest(extended(system, trial), fit)[0][rows] ** 2))
        return after < (1 - calibration()["moves"]) ** 2 * before

    def density(self, system: System, fit: Fitted) -> float:
        """ln predictive density of a fit of all numbers of a system."""
        return self.rest(system, fit)[1]
