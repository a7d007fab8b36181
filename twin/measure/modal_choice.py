"""Which modes the data hold: candidates from the chart, those missing added, those not needed left out, deviations.

A mode is worth its parameters where the fit loses more without it than the best mode of pure noise would gain. That
gain is the largest singular value of a random matrix (Johnstone, Annals of Statistics 29, 2001). A pole beside a
stronger pole must explain what no small shift of the stronger one, channel by channel, could explain. References and
sensors of a real test never quite agree. Deviations count noise, and the scatter of the poles that channels, outputs
and references ask for.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.measure.campaign import SENSOR_FLOOR, BoolArray, ComplexArray, FloatArray, laplace
from twin.measure.modal_fit import FitData, ModalFit, Variance, channel_shifts, deviations, fit_modes
from twin.measure.stabilisation import Cluster

RECORD_PARTS = 200  # a record is integrated in
SHORTEST = 10.0  # decays within a record, of the shortest response that noise may feign
NOISE_LINES = (30, 100)  # fewest and most lines of a block that a variance is estimated from
FALSE_ALARM = 1e-3  # chance that noise alone passes for a mode, per band
SCAN_DAMPINGS = (0.001, 0.003, 0.01, 0.03, 0.08)
BEYOND = 1.3  # how far past the ends of the band, as a ratio, modes are looked for
FAR, OVERDAMPED = 2.0, 0.5  # ratio to the end of the band and damping ratio from which a pole is no mode
ROUNDS = 6  # of looking for missing modes at most
STRONG = 0.1  # of the best gain: weaker hits wait for the next round, as they may be its skirts
MOST_ADDED = 10  # in one round
SKIRT = 3  # bandwidths on either side of a hit in which no other is taken in the same round
QUICK = 6  # iterations of a fit that only decides
SHIFT = 1e-3  # relative deviation of a pole from channel to channel, up to which the test and not a mode is the cause
FEW_CHANNELS = 5  # up to which two modes may well look alike
PARTED = 3.0  # deviations that two poles must be apart
LEAST_SHARE = 0.01  # of the response at its own frequency, below which a resonance is no mode
TYPICAL = 0.3, 0.5  # quantiles of modes while others may still be missing, and at the end
VISIBLE = 2.5  # times the noise in some channel, below which no channel needs a mode
DOUBT = 3.0  # times the typical share that modes leave unexplained: what a pole beside one must explain
FEWEST_LINES = 4  # on which two poles can be told from one
SETTLED = 1e-4  # relative change of a pole below which it is the same
SERIES = 20.0  # times a shift, from which on two terms of its series are enough
SWEEPS = 3  # over the poles whose shifts are sought together
EXPLAINED = 0.9  # share of what a pole beside another explains, from which shifts explain it just as well
ALIKE = 0.97  # share of a shape that stronger poles beside it make up, above which it is no mode of its own
POOLED = 5  # degrees of freedom that the scatter of all modes counts for in that of one
BATCHES = (4, 8, 16)  # in which outputs may have been measured


@dataclass(frozen=True)
class Band:
    """Accelerance of one band with the references last, and the variance that weights it.

    Attributes:
        frf: (nf, no, ni), each channel aligned with the others (:meth:`aligned`).
        recorded: (nf, no, ni), as it came.
        loose: relative shift of poles from channel to channel, once it is known.
        moved: poles (nm,) and by how much each channel was moved (nm, no, ni), rad/s; ``None`` where none was.
        frequency: (nf,) Hz.
        variance: of a line.
        stated: (nf,) course of the variance that the recording states, or ``None``.
        floor: (no, ni) variance no residual is trusted below; infinite for dead channels.
        rate: of the exponential window, 1/s.
    """

    frf: ComplexArray
    recorded: ComplexArray
    frequency: FloatArray
    variance: Variance
    stated: FloatArray | None
    floor: FloatArray
    rate: float
    moved: tuple[ComplexArray, FloatArray] | None = None
    loose: float | None = None

    @classmethod
    def of(
        cls, frf: ComplexArray, frequency: FloatArray, variance: FloatArray | None, dead: BoolArray, rate: float
    ) -> "Band":
        """A band weighted by the stated variance (nf, no, ni), else by what neighbouring lines differ by."""
        rms2 = np.mean(np.abs(frf) ** 2, axis=0)
        floor = np.where(dead, np.inf, np.maximum(SENSOR_FLOOR**2 * rms2, 1e-300))
        if variance is not None:
            weights = Variance.of(np.maximum(variance, floor))
            return cls(frf, frf, frequency, weights, weights.course, floor, rate)
        rough = frf[:-2] - 2 * frf[1:-1] + frf[2:]
        band = cls(frf, frf, frequency, Variance(np.ones(frequency.size), floor), None, floor, rate)
        return replace(band, variance=band._levels(np.abs(rough[np.r_[0, 0 : len(rough), len(rough) - 1]]) ** 2 / 6, 0))

    @property
    def s(self) -> ComplexArray:
        """(nf,) Laplace points."""
        return laplace(self.frequency, self.rate)

    @property
    def step(self) -> float:
        """Distance of the lines, Hz."""
        return float((self.frequency[-1] - self.frequency[0]) / (self.frequency.size - 1))

    @cached_property
    def data(self) -> FitData:
        """What every fit of the band shares."""
        return FitData(self.frf, self.s, self.variance)

    @property
    def live(self) -> tuple[int, int]:
        """Outputs and references that say something."""
        weight = self.variance.weight > 0
        return max(int(weight.any(axis=1).sum()), 1), max(int(weight.any(axis=0).sum()), 1)

    def repetition(self, decay: FloatArray | float, power: int) -> FloatArray:
        """Lines that say the same, for what decays as t^power e^(−decay t), decay in 1/s.

        An exponential window w = e^(−σt) over the record T correlates the noise of neighbouring lines, and leaves most
        of it where the record is young. The number of lines is T ∫ k² w² / (∫ k² ∫ w²) with k = t^power e^(−(decay + σ)
        t).
        """
        record = 1 / self.step
        time = (np.arange(RECORD_PARTS) + 0.5) * record / RECORD_PARTS
        window = np.exp(-2 * self.rate * time)
        kernel = time ** (2 * power) * np.exp(-2 * (np.atleast_1d(decay)[:, None] + self.rate) * time)
        return np.asarray(np.mean(kernel * window, axis=1) / (np.mean(kernel, axis=1) * np.mean(window)))

    @cached_property
    def price(self) -> float:
        """Rise of chi2 that a mode must be worth where the variance is right.

        That is the most that noise gives to the best rank-one residue over all lines: 2 [(√no + √ni)² + t σ] times
        :meth:`repetition`. The scale σ and the tail exp(−4/3 t^1.5) are those of Tracy and Widom.
        """
        no, ni = (float(np.sqrt(n)) for n in self.live)
        t = (0.75 * np.log(self.frequency.size / FALSE_ALARM)) ** (2 / 3)
        return (
            2
            * ((no + ni) ** 2 + t * (no + ni) * (1 / no + 1 / ni) ** (1 / 3))
            * float(self.repetition(SHORTEST * self.step, 0)[0])
        )

    # --- variance ---------------------------------------------------------------------------------------------

    def _levels(self, power: FloatArray, modes: int) -> Variance:
        """Variance from the power (nf, no, ni) of complex residuals: a level per channel, one course over the band.

        Medians of blocks of lines, which a resonance left over cannot lift; the course is the median channel's.
        """
        lines = self.frequency.size
        power = power / (2 * np.log(2)) * lines / max(lines - modes / self.frf.shape[2] - 3, lines / 2)
        blocks = np.array_split(np.arange(lines), max(1, lines // int(np.clip(lines // 8, *NOISE_LINES))))
        level = np.stack([np.median(power[block], axis=0) for block in blocks])
        channel = np.median(level, axis=0)
        live = np.isfinite(self.floor) & (channel > 0)
        if not live.any():
            return Variance(np.ones(lines), self.floor)
        course = np.median(level[:, live] / channel[live], axis=1)
        over = np.interp(np.arange(lines), [float(block.mean()) for block in blocks], course)
        if self.stated is not None:
            over = np.maximum(over, self.stated * np.median(over / self.stated))
        return Variance(over, np.maximum(np.where(live, channel, np.inf), self.floor))

    def reweighted(self, fit: ModalFit) -> "Band":
        """The band with the variance that the residual of a fit shows."""
        power = np.abs(self.frf - fit.model.synthesise(self.s)) ** 2
        return replace(self, variance=self._levels(power, fit.model.poles.size))

    def fit(self, poles: ComplexArray, participation: ComplexArray, iterations: int = QUICK) -> ModalFit:
        """Refined modes."""
        return fit_modes(self.data, poles, participation, iterations)

    def residual(self, fit: ModalFit) -> ComplexArray:
        """(nf, no, ni) over the deviation of the real part."""
        return self.variance.whitened(self.frf - fit.model.synthesise(self.s))

    def misfit(self, fit: ModalFit) -> FloatArray:
        """(nm,) mean square of the residual where each mode is, over its variance, at least 1.

        Lines and channels count as they do in the mode's pole, for which White (1980) is the general case.
        """
        power = np.abs(self.residual(fit)) ** 2 / 2
        per_line = power.reshape(self.frequency.size, -1)
        s, factor = self.s[:, None], np.ones(fit.model.poles.size)
        if not factor.size:
            return factor
        kernel = np.abs(s**2 / (s - fit.model.poles) ** 2) ** 2 / self.variance.course[:, None]
        kernel /= kernel.sum(axis=0)
        channel = (np.abs(fit.model.residues) ** 2 * self.variance.weight).reshape(factor.size, -1)
        channel /= np.maximum(channel.sum(axis=1, keepdims=True), 1e-300)
        counted = 1 / np.sum(kernel**2, axis=0)
        own = np.einsum("fr,fr->r", kernel, per_line @ channel.T)
        return np.asarray(np.maximum(1.0, own * counted / np.maximum(counted - 2, counted / 3)))

    def energy(self, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """(nm,) chi2 of each mode on the lines within a bandwidth of it, and what is left there beyond noise."""
        power = np.sum(np.abs(self.residual(fit)) ** 2, axis=(1, 2)) - 2 * np.count_nonzero(self.variance.weight)
        reach = [self._reach(p) for p in fit.model.poles]
        near = np.abs(self.frequency[:, None] - fit.frequency) <= reach
        s = self.s[:, None]
        own = np.abs(s**2 / (s - fit.model.poles)) ** 2 / self.variance.course[:, None]
        size = np.sum(np.abs(fit.model.residues) ** 2 * self.variance.weight, axis=(1, 2))
        return np.sum(own * near, axis=0) * size, np.maximum(power @ near, 0.0)

    def visibility(self, fit: ModalFit) -> FloatArray:
        """(nm,) of a mode's own response at its nearest line over the noise there, in the channel that shows it best.

        Infinite outside the band, where poles stand for what reaches into it.
        """
        line = np.argmin(np.abs(self.frequency[:, None] - fit.frequency), axis=0)
        s = self.s[line]
        own = np.abs(s**2 / (s - fit.model.poles)) / np.sqrt(2 * self.variance.course[line])
        best = np.max(np.abs(fit.model.residues) * np.sqrt(self.variance.weight), axis=(1, 2))
        inside = (fit.frequency >= self.frequency[0]) & (fit.frequency <= self.frequency[-1])
        return np.asarray(np.where(inside, own * best, np.inf))

    def share(self, fit: ModalFit) -> FloatArray:
        """(nm,) RMS over the channels of a mode's own response at its nearest line over that of what was measured.

        A smooth background that the model lacks is fitted by many small resonances. Infinite outside the band.
        """
        line = np.argmin(np.abs(self.frequency[:, None] - fit.frequency), axis=0)
        s, live = self.s[line], self.variance.weight > 0
        own = np.abs(s**2 / (s - fit.model.poles)) * np.linalg.norm(fit.model.residues[:, live], axis=1)
        measured = np.linalg.norm(self.frf[line][:, live], axis=1)
        inside = (fit.frequency >= self.frequency[0]) & (fit.frequency <= self.frequency[-1])
        return np.asarray(np.where(inside, own / np.maximum(measured, 1e-300), np.inf))

    def error_around(self, fit: ModalFit, final: bool) -> "ErrorAround":
        """What the modes of this campaign typically leave unexplained, as a source of doubt about poles beside them."""
        energy, left = self.energy(fit)
        reach = np.array([self._reach(p) for p in fit.model.poles])
        share = float(np.quantile(left / np.maximum(energy, 1e-300), TYPICAL[final])) if energy.size else 0.0
        return ErrorAround(fit.frequency, reach, DOUBT * share * energy)

    # --- choice -----------------------------------------------------------------------------------------------

    def choose(self, candidates: list[Cluster]) -> tuple["Band", ModalFit]:
        """The modes the data hold, refined, and the band as it was weighted.

        First everything that noise cannot explain is taken in, round by round, each round weighted by what the last
        left over. Then what another pole explains as well is taken out.
        """
        candidates = [c for c in candidates if c.pole.real < 0]
        poles = np.array([c.pole for c in candidates], dtype=complex)
        participation = np.array([c.participation for c in candidates], dtype=complex).reshape(-1, self.frf.shape[2])
        fit = self._settled(self.fit(poles, participation, 0))
        band, fit = self.reweighted(fit)._searched(fit)
        for _ in range(2):
            band = band.reweighted(fit)
            fit = band.pruned(band.fit(fit.model.poles, fit.model.participation))
        if (loose := band.looseness(fit, True)) > 0:
            band, fit = replace(band, loose=loose)._second_look(fit)
        return band, band.fit(fit.model.poles, fit.model.participation, 30)

    def _second_look(self, fit: ModalFit) -> tuple["Band", ModalFit]:
        """With modes that show only once the channels are aligned."""
        band = self.aligned(fit)
        fit = band.fit(fit.model.poles, fit.model.participation)
        band = band.aligned(fit).reweighted(fit)
        fit = band.fit(fit.model.poles, fit.model.participation)
        found = band._missing(fit, Places())
        if found:
            fit = band._with(fit, found)
            band = band.aligned(fit)
            fit = band.fit(fit.model.poles, fit.model.participation)
            band = band.aligned(fit).reweighted(fit)
            fit = band.pruned(band.fit(fit.model.poles, fit.model.participation))
        return band, fit

    def _searched(self, fit: ModalFit) -> tuple["Band", ModalFit]:
        """With every mode that noise cannot explain, round by round, each weighted by what the last left over."""
        band, passed_over = self, Places()
        found: list[tuple[complex, ComplexArray]] = []
        for _ in range(ROUNDS):
            fit = band._settled(band.fit(fit.model.poles, fit.model.participation))
            fit = band.pruned(fit, passed_over)
            for pole, _ in found:  # what came to nothing is not tried again
                if np.all(np.abs(fit.model.poles - pole) > 2 * np.pi * band._reach(pole)):
                    passed_over.add(abs(pole) / (2 * np.pi), band._reach(pole))
            found = band._missing(fit, passed_over)
            if not found:
                break
            fit = band._with(fit, found)
            band = band.reweighted(fit)
        return band, fit

    def _with(self, fit: ModalFit, found: list[tuple[complex, ComplexArray]]) -> ModalFit:
        poles = np.append(fit.model.poles, [pole for pole, _ in found])
        participation = np.concatenate([fit.model.participation, [p for _, p in found]])
        return self._settled(self.fit(poles, participation))

    def _settled(self, fit: ModalFit) -> ModalFit:
        """Refined without modes whose loss nobody would notice in the noise."""
        while fit.model.poles.size:
            before = fit.model.poles.size
            while fit.model.poles.size:
                bad = self._implausible(fit)
                worth = np.where(bad, 0, fit.wald / self.price)
                n = int(np.argmin(worth))
                if worth[n] >= 1:
                    break
                fit = self._without(fit, bad if bad.any() else np.arange(worth.size) == n, 0)
            if fit.model.poles.size == before:
                return fit
            fit = self.fit(fit.model.poles, fit.model.participation)
        return fit

    def _implausible(self, fit: ModalFit) -> BoolArray:
        away = np.maximum(self.frequency[0] / fit.frequency, fit.frequency / self.frequency[-1])
        return np.asarray((away > FAR) | (fit.damping > OVERDAMPED))

    def pruned(self, fit: ModalFit, passed_over: "Places | None" = None) -> ModalFit:
        """Without halves of one mode; at the end also without what the misfit around it could be.

        Args:
            fit: the modes so far.
            passed_over: takes up where poles were left out while modes are still being looked for.
        """
        if not fit.model.poles.size:
            return fit
        final = passed_over is None
        cleared: list[complex] = [] if passed_over is None else passed_over.cleared
        if final:
            fit = self._without(fit, self._implausible(fit) | self._merged(fit))
        while fit.model.poles.size:
            drop = None
            if final:
                doubt = self.error_around(fit, True).beside(fit.frequency) + self.energy(fit)[1]
                worth = np.minimum(fit.wald / (self.price + doubt), self.visibility(fit) / VISIBLE)
                worth = np.minimum(worth, self.share(fit) / LEAST_SHARE)
                drop = int(np.argmin(worth)) if worth.min() < 1 else None
            if drop is None:
                drop = self._shadow(fit, final, cleared)
            if drop is None:
                return fit
            if passed_over is not None:
                passed_over.add(fit.frequency[drop], self._reach(fit.model.poles[drop]))
            fit = self._without(fit, np.arange(fit.wald.size) == drop)
        return fit

    def _without(self, fit: ModalFit, drop: BoolArray, iterations: int = QUICK) -> ModalFit:
        return self.fit(fit.model.poles[~drop], fit.model.participation[~drop], iterations)

    def _reach(self, pole: complex) -> float:
        """Half-width in Hz of what a pole dominates, a line at least."""
        return float(max(-2 * pole.real / (2 * np.pi), self.step))

    # --- poles beside poles -----------------------------------------------------------------------------------

    def looseness(self, fit: ModalFit, final: bool) -> float:
        """Relative shift of poles from channel to channel that the better modes of the campaign show."""
        if self.loose is not None:
            return self.loose
        if fit.model.poles.size < 4:
            return SHIFT if fit.model.poles.size else 0.0
        spread = np.sqrt(scatter(self._asked(fit), self.repetition(-fit.model.poles.real, 1))[2])
        spread /= np.abs(fit.model.poles)
        return float(min(3 * SHIFT, 3 * np.quantile(spread, TYPICAL[final])))

    def _asked(self, fit: ModalFit) -> ModalFit:
        """The fit with the whole shift that each channel asks for, what it was moved by included."""
        if self.moved is None:
            return fit
        own = np.argmin(np.abs(fit.model.poles[:, None] - self.moved[0]), axis=1)
        return replace(fit, shift=fit.shift + 1j * self.moved[1][own])

    def aligned(self, fit: ModalFit) -> "Band":
        """The band with each channel's poles moved to where all channels together have them.

        A sensor's mass, the room's warmth or a joint that settles shift a pole from channel to channel. What a strong
        mode leaves unexplained then hides weak ones beside it. Each shift is a random effect whose deviation the
        campaign itself shows (best linear unbiased prediction, Henderson, Biometrics 31, 1975), as long as chi2 falls.
        """
        loose = self.looseness(fit, True)
        if loose == 0:
            return replace(self, frf=self.recorded, moved=None)
        shift = np.zeros(fit.model.residues.shape)
        band = replace(self, frf=self.recorded, moved=None)
        if self.moved is not None:
            own = np.argmin(np.abs(fit.model.poles[:, None] - self.moved[0]), axis=1)
            near = np.abs(fit.model.poles - self.moved[0][own]) < loose * np.abs(fit.model.poles)
            shift = self.moved[1][own] * near[:, None, None]
            band = band._moved_by(fit, shift)
            fit = band.fit(fit.model.poles, fit.model.participation, 0)
        spread = loose * np.abs(fit.model.poles) / 3
        for _ in range(SWEEPS):
            shift = channel_shifts(band.data, fit, shift, spread)
            next_band = band._moved_by(fit, shift)
            next_fit = next_band.fit(fit.model.poles, fit.model.participation, 0)
            if next_fit.chi2 > fit.chi2:
                break
            band, fit = next_band, next_fit
        return band

    def _moved_by(self, fit: ModalFit, shift: FloatArray) -> "Band":
        """The band freed of shifts (nm, no, ni) of the poles in rad/s: two terms of a series, exact near each pole."""
        moved = 1j * shift.reshape(len(shift), -1)
        residues = fit.model.residues.reshape(moved.shape)
        s, poles = self.s[:, None], fit.model.poles
        s2, one, two = s**2, residues * moved, residues * moved**2
        change = (s2 / (s - poles) ** 2) @ one + (s2 / (s - poles) ** 3) @ two
        change += (s2 / (s - poles.conj()) ** 2) @ one.conj()
        for r in range(len(poles)):
            near = np.abs(self.s.imag - poles[r].imag) < SERIES * np.abs(moved[r]).max()
            gap = s[near] - poles[r]
            change[near] += s2[near] * two[r] * moved[r] / (gap**3 * (gap - moved[r]))
        return replace(self, frf=self.recorded - change.reshape(self.recorded.shape), moved=(poles, shift))

    def _shadow(self, fit: ModalFit, final: bool, cleared: list[complex]) -> int | None:
        """A mode that a stronger one beside it makes superfluous: by its shape, or no farther than channels differ.

        Args:
            fit: the modes.
            final: no more modes are looked for.
            cleared: poles that passed before; takes up those that pass now.
        """
        close, strength = self._beside(fit)
        if not close.any():
            return None
        loose = self.looseness(fit, final)
        reach = np.array([self._reach(p) for p in fit.model.poles])
        shape = fit.model.shape * np.sqrt(self.variance.weight.max(axis=1))
        for weak in np.argsort(strength):
            pole = complex(fit.model.poles[weak])
            if any(abs(pole - other) < SETTLED * abs(pole) for other in cleared):
                continue
            apart = np.abs(fit.model.poles - fit.model.poles[weak]) / (2 * np.pi)
            if self._combines(shape[weak], shape[close[weak] & (apart < reach / 4 + loose * fit.frequency)]):
                return int(weak)
            for strong in np.flatnonzero(close[weak]):
                if apart[strong] < loose * fit.frequency[strong]:
                    return int(weak)
            around = np.abs(fit.frequency - fit.frequency[weak]) < reach + 2 * loose * fit.frequency
            if loose > 0 and (around & close[weak]).any() and self._shifts_explain(fit, int(weak), loose):
                return int(weak)
            cleared.append(pole)
        return None

    def _combines(self, shape: ComplexArray, others: ComplexArray) -> bool:
        """Whether a shape (no,) is a combination of others (n, no), told only where outputs are plenty."""
        if not len(others) or self.live[0] <= len(others) + FEW_CHANNELS:
            return False
        basis = np.linalg.qr(others.T)[0]
        size = float(np.linalg.norm(shape))
        return bool(size == 0 or np.linalg.norm(basis.conj().T @ shape) ** 2 > ALIKE * size**2)

    def _beside(self, fit: ModalFit) -> tuple[BoolArray, FloatArray]:
        """(nm, nm) whether the second pole is a stronger one within a bandwidth of the first; (nm,) strength."""
        poles = fit.model.poles
        reach = np.array([self._reach(p) for p in poles])
        residues = fit.model.residues.reshape(poles.size, -1) * np.sqrt(self.variance.weight).ravel()
        strength = np.linalg.norm(residues, axis=1) / np.abs(poles.real)
        apart = np.abs(poles.imag[:, None] - poles.imag) / (2 * np.pi)
        return (apart < reach[:, None] + reach) & (strength > strength[:, None]), strength

    def _merged(self, fit: ModalFit) -> BoolArray:
        """(nm,) modes that deviations do not part from one beside them, of the two the less certain.

        Asked once, of the fullest model: what is left out of a model widens the deviations of all others.
        """
        poles, variance = fit.model.poles, np.einsum("raa->ra", self.covariance(fit))
        between = np.maximum(variance[:, None] + variance, 1e-300)
        difference = poles[:, None] - poles
        apart = np.sqrt(difference.real**2 / between[..., 0] + difference.imag**2 / between[..., 1])
        beside = self._beside(fit)[0]
        unclear = (apart < PARTED) & (beside | beside.T)
        dropped = np.zeros(poles.size, dtype=bool)
        for mode in np.argsort(-np.sum(variance, axis=1) / np.abs(poles) ** 2):
            dropped[mode] = bool((unclear[mode] & ~dropped).any())
        return dropped

    def _shifts_explain(self, fit: ModalFit, weak: int, loose: float) -> bool:
        """Whether the other poles, shifted by up to ``loose`` channel by channel, explain what the weak one does."""
        others = np.arange(fit.model.poles.size) != weak
        one = self.fit(fit.model.poles[others], fit.model.participation[others], 1)
        width = 2 * self._reach(fit.model.poles[weak]) + 3 * self.step
        lines = np.abs(self.frequency - fit.frequency[weak]) <= width
        if np.count_nonzero(lines) < FEWEST_LINES:
            return False
        near = np.abs(one.frequency - fit.frequency[weak]) <= width + np.array(
            [self._reach(p) for p in one.model.poles]
        )
        left = self._local(one, lines)
        before, both = (float(np.sum(np.abs(part) ** 2)) for part in (left, self._local(fit, lines)))
        allowance = np.count_nonzero(self.variance.weight) * np.count_nonzero(near) * max(fit.scale, 1)
        after = float(np.sum(np.abs(self._aligned(one, near, lines, left, loose)) ** 2))
        return bool(after + allowance < both + (1 - EXPLAINED) * (before - both))

    def _local(self, fit: ModalFit, lines: BoolArray) -> ComplexArray:
        """(lines, channels) the whitened residual on some lines."""
        left = self.frf[lines] - fit.model.synthesise(self.s[lines])
        part = left / np.sqrt(self.variance.course[lines])[:, None, None] * np.sqrt(self.variance.weight)
        return np.asarray(part.reshape(np.count_nonzero(lines), -1))

    def _aligned(
        self, fit: ModalFit, near: BoolArray, lines: BoolArray, left: ComplexArray, loose: float
    ) -> ComplexArray:
        """A residual (lines, channels) when each channel may shift each near pole up or down by ``loose`` at most.

        Gauss–Newton on the imaginary parts of the poles, channel by channel, the strongest mode first.
        """
        at = self.s[lines, None]
        weight = at**2 / np.sqrt(self.variance.course[lines, None])
        chosen = np.flatnonzero(near)
        shift = np.zeros((chosen.size, left.shape[1]))
        own = [(fit.model.residues[r] * np.sqrt(self.variance.weight)).ravel() for r in chosen]
        for _ in range(SWEEPS):
            for k, r in enumerate(chosen):
                limit = loose * abs(fit.model.poles[r])
                gap = at - fit.model.poles[r] - 1j * shift[k]
                slope = 1j * weight * own[k] / gap**2
                size = np.sum(np.abs(slope) ** 2, axis=0)
                step = np.sum((slope.conj() * left).real, axis=0) / np.where(size > 0, size, 1)
                moved = np.clip(shift[k] + step, -limit, limit)
                left = left + weight * own[k] * (1 / gap - 1 / (at - fit.model.poles[r] - 1j * moved))
                shift[k] = moved
        return left

    # --- missing modes ----------------------------------------------------------------------------------------

    def _missing(self, fit: ModalFit, passed_over: "Places") -> list[tuple[complex, ComplexArray]]:
        """Poles and participation factors of what stands out of the residual, far enough apart to be told so."""
        doubt = self.error_around(fit, False)
        hits = scan(self.residual(fit), self.s, self.frequency, self.variance.course)
        chosen: list[tuple[complex, ComplexArray]] = []
        strongest = 0.0
        taken, wide = Places(), np.array([self._reach(p) for p in fit.model.poles])
        for pole, participation, gain, around in hits:
            at, reach = abs(pole) / (2 * np.pi), SKIRT * self._reach(pole)
            if not passed_over.free(at, self._reach(pole)):  # nor are its skirts, which reach as far as its neighbour's
                beside = np.abs(fit.frequency - at) < wide + reach
                taken.add(at, SKIRT * float(np.max(wide[beside], initial=self._reach(pole))))
                continue
            if gain < max(self.price + around + doubt.at(np.array([at]))[0], STRONG * strongest):
                continue
            if not chosen:
                strongest = gain
            if at < self.frequency[0] or at > self.frequency[-1]:
                at, reach = float(np.clip(at, self.frequency[0], self.frequency[-1])), max(reach, SKIRT * self.step)
            if taken.free(at, reach):
                chosen.append((pole, participation))
                taken.add(at, reach)
            if len(chosen) == MOST_ADDED:
                break
        return chosen

    # --- deviations -------------------------------------------------------------------------------------------

    def deviations(self, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """(nm,) of frequency in Hz and of the damping ratio: noise, and scatter over channels and references."""
        return deviations(fit.model.poles, self.covariance(fit))

    def covariance(self, fit: ModalFit) -> FloatArray:
        """(nm, 2, 2) of Re λ and Im λ: noise, and scatter over channels, outputs and references."""
        same = self.repetition(-fit.model.poles.real, 1)
        noise = fit.covariance * (self.misfit(fit) * same * max(fit.scale, 1))[:, None, None]
        by_imag, by_real, _ = scatter(self._asked(fit), same * max(fit.scale, 1))
        noise[:, 1, 1] += by_imag
        noise[:, 0, 0] += by_real
        return noise


@dataclass(frozen=True)
class ErrorAround:
    """Chi2 that model error may hold around known modes; it falls off as the resonance does.

    Attributes:
        hertz, reach: (nm,) of the modes.
        chi2: (nm,) at each mode.
    """

    hertz: FloatArray
    reach: FloatArray
    chi2: FloatArray

    def at(self, hertz: FloatArray) -> FloatArray:
        """(n,) at other frequencies."""
        return np.asarray(np.sum(self._overlap(hertz) * self.chi2, axis=1))

    def beside(self, hertz: FloatArray) -> FloatArray:
        """(nm,) at each mode, from stronger ones alone."""
        stronger = self.chi2 > self.chi2[:, None]
        return np.asarray(np.sum(self._overlap(hertz) * self.chi2 * stronger, axis=1))

    def _overlap(self, hertz: FloatArray) -> FloatArray:
        return np.asarray((1 + ((hertz[:, None] - self.hertz) / self.reach) ** 2) ** -1.0)


@dataclass(frozen=True)
class Places:
    """Frequencies and half-widths, Hz, that are taken; ``cleared`` poles need no second test."""

    hertz: list[float] = field(default_factory=list)
    reach: list[float] = field(default_factory=list)
    cleared: list[complex] = field(default_factory=list)

    def add(self, hertz: float, reach: float) -> None:
        """Take one more."""
        self.hertz.append(hertz)
        self.reach.append(reach)

    def free(self, hertz: float, reach: float) -> bool:
        """Whether nothing within ``reach`` is taken."""
        return all(abs(hertz - at) > reach + wide for at, wide in zip(self.hertz, self.reach, strict=True))


def scan(
    residual: ComplexArray, s: ComplexArray, frequency: FloatArray, course: FloatArray
) -> list[tuple[complex, ComplexArray, float, float]]:
    """Modes that would explain most of a whitened residual, best first.

    A generalised likelihood ratio test on a grid of frequencies and dampings, with a rank-one residue.

    Returns:
        pole, participation factors (ni,), drop of chi2, chi2 that is left around it beyond noise.
    """
    nf, no, ni = residual.shape
    flat = residual.reshape(nf, -1)
    step = (frequency[-1] - frequency[0]) / (nf - 1)
    low, high = max(frequency[0] / BEYOND, step), frequency[-1] * BEYOND
    found = []
    for damping in SCAN_DAMPINGS:
        grid = [low]
        while grid[-1] < high:
            grid.append(grid[-1] + max(damping * grid[-1] / 2, step / 2))
        for some in np.array_split(np.array(grid), max(1, len(grid) // 32)):
            reach = 10 * (damping * some[-1] + step)  # a mode is seen on the lines around it
            lines = slice(*np.searchsorted(frequency, [some[0] - reach, some[-1] + reach]))
            if lines.stop - lines.start < 4:
                continue
            pole = 2 * np.pi * some * (-damping + 1j * np.sqrt(1 - damping**2))
            at = s[lines, None]
            kernel = at**2 / (at - pole) / np.sqrt(course[lines, None])
            size = np.sqrt(np.sum(np.abs(kernel) ** 2, axis=0))
            z = ((kernel / size).conj().T @ flat[lines]).reshape(some.size, no, ni)
            value, vector = np.linalg.eigh(z.conj().swapaxes(1, 2) @ z if ni <= no else z @ z.conj().swapaxes(1, 2))
            power = np.sum(np.abs(flat[lines]) ** 2, axis=1)
            for k in np.flatnonzero(value[:, -1] >= 0.999 * np.maximum.reduce(
                [value[:, -1], np.r_[0, value[:-1, -1]], np.r_[value[1:, -1], 0]]
            )):  # fmt: skip
                gain = float(value[k, -1])
                weight = np.abs(kernel[:, k]) ** 2 / size[k] ** 2
                own = weight > 0.1 * weight.max()
                rest = power[own].sum() - gain - 2 * no * ni * own.sum()
                u = vector[k, :, -1].conj() if ni <= no else (z[k].conj().T @ vector[k, :, -1]).conj()
                found.append((complex(pole[k]), u, gain, float(max(rest, 0))))
    return sorted(found, key=lambda hit: -hit[2])


def scatter(fit: ModalFit, noise: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What channels that ask for different poles add to the variance of a mode's pole, (rad/s)².

    A random-effects estimate (DerSimonian & Laird, Controlled Clinical Trials 7, 1986) over references, and over
    outputs or batches of outputs as they follow each other, whichever shows more. The two are crossed, so they add.
    Single channels count where they show more than both.

    Returns:
        of Im λ (nm,), of Re λ (nm,), and the variance of Im λ from channel to channel (nm,).
    """
    nm, no, ni = fit.shift.shape
    outputs, references = np.broadcast_to(np.arange(no)[:, None], (no, ni)), np.broadcast_to(np.arange(ni), (no, ni))
    batches = [outputs * n // no for n in BATCHES if 2 * n <= no]
    between = np.zeros(nm)

    def largest(*labels: NDArray[np.intp]) -> FloatArray:
        """(2, nm) of Im λ and Re λ."""
        most = np.zeros((2, nm))
        for label in labels:
            variance, tau2 = _scatter_over(fit, label, noise)
            np.maximum(most, variance, out=most)
            np.maximum(between, tau2, out=between)
        return most

    imag, real = np.maximum(largest(references) + largest(outputs, *batches), largest(outputs * ni + references))
    return imag, real, between


def _scatter_over(fit: ModalFit, label: NDArray[np.intp], noise: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Variance (2, nm) of Im λ and Re λ from groups of channels ``label`` (no, ni), and that of Im λ between them."""
    nm = fit.model.poles.size
    result, between = np.zeros((2, nm)), np.zeros(nm)
    member = (label.ravel() == np.unique(label)[:, None]).astype(float)
    if len(member) < 2 or not nm:
        return result, between
    w = fit.shift_weight
    weight = w.reshape(nm, -1) @ member.T
    mean = (w * fit.shift).reshape(nm, -1) @ member.T / np.where(weight > 0, weight, 1)
    total = np.maximum(weight.sum(axis=1), 1e-300)
    off = mean - (np.sum(weight * mean, axis=1) / total)[:, None]
    spare = total - np.sum(weight**2, axis=1) / total
    counted = np.maximum(np.count_nonzero(weight > 0, axis=1) - 1, 1)
    share = np.sum(weight**2, axis=1) / total**2
    for k, part in enumerate((off.imag, off.real)):
        q = np.sum(weight * part**2, axis=1)
        seen = q > noise * (counted + 3 * np.sqrt(2 * counted))  # three deviations of chi2: noise alone shows none
        tau2 = np.where(seen, q - counted * noise, 0) / np.where(spare > 0, spare, np.inf)
        result[k] = pooled(tau2 * share, total, np.abs(fit.model.poles), counted)
        if k == 0:
            between = tau2
    return result, between


def pooled(variance: FloatArray, weight: FloatArray, size: FloatArray, counted: FloatArray) -> FloatArray:
    """Variances (nm,) of poles of size (nm,), drawn towards what all modes show relative to their frequency.

    A variance known from few groups is itself uncertain: this is its posterior mean, that of a scaled inverse chi2.

    What all show is a median in which each counts by its ``weight``. It is raised from the median to the mean of chi2
    with ``counted`` degrees of freedom, from which each variance comes (Wilson & Hilferty, PNAS 17, 1931).
    """
    relative = variance / size**2
    rank = np.argsort(relative)
    gathered = np.cumsum((weight * size**2)[rank])
    middle = rank[np.searchsorted(gathered, 0.5 * gathered[-1])]
    others = relative[middle] / (1 - 2 / (9 * counted[middle])) ** 3
    return np.asarray((counted * relative + POOLED * others) / (counted + POOLED - 2) * size**2)
