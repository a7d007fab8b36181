"""What was found in a log, one step of the search each, and the rows with it and without it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.decide import Decision
from twin.diagnose.hypotheses import Hypothesis
from twin.diagnose.refit import Fitted
from twin.diagnose.torque_fit import base_fit, eliminated, evaluate, fitted, refine
from twin.diagnose.torque_suspects import Suspect
from twin.diagnose.torque_system import System, Trial, extended, own_values, relinearised, with_wider, without
from twin.identify.uncertainty import NINETY
from twin.measure.campaign import FloatArray
from twin.physics import effect_named
from twin.physics.effect import Effect

REFITTED = 3  # steps of all numbers beside what is judged or left out: all were refined before


@dataclass
class Step:
    """One thing looked for with all found before it in the model.

    Attributes:
        system: the base model then; ``base`` its fit.
        decision: who explains what it misses.
        trials: of the ranked hypotheses, by key; a number of the base model has none.
        held: rise of the ln predictive density of the rows kept aside, with the first of the ranked.
        accepted: it goes into the model.
        grown: its slip has as many elements as the rows bear.
    """

    system: System
    base: Fitted
    decision: Decision
    trials: dict[str, Trial]
    held: float = 0.0
    accepted: bool = False
    grown: bool = False

    @property
    def first(self) -> Fitted:
        """The most probable."""
        return self.decision.ranked[0]

    @property
    def trial(self) -> Trial | None:
        """Of the first, ``None`` where it is a number of the base model."""
        return self.trials.get(self.key)

    @property
    def effect(self) -> Effect:
        """What the first is."""
        return effect_named(self.first.hypothesis.effect)

    @property
    def key(self) -> str:
        """``EFFECT@SITE`` of the first."""
        return self.first.hypothesis.key

    @property
    def joints(self) -> tuple[int, ...]:
        """Zero-based, on which the first acts; none where it is a number of the base model."""
        return self.trial.column.joints if self.trial else ()

    @property
    def misfit(self) -> float:
        """χ² per datum that the first leaves on the joints it acts on: above one, where no law here is exact."""
        if self.trial is None:
            return self.first.misfit
        system, rest = self.system, what_is_left(self.system, self.trial)
        energy = sum(float(np.sum(rest[system.rows(j)] ** 2)) for j in self.joints)
        return energy / (system.count * float(system.level[list(self.joints)].sum()))

    @property
    def gain(self) -> float:
        """Evidence of the first over the model before it."""
        return self.first.evidence() - self.base.evidence()

    @property
    def borne(self) -> float:
        """The same with the description's tolerances as wide as they turn out beside the first.

        Birge's ratio, applied to priors. Numbers may stay far from their description, whatever is missing: the
        tolerances are then too narrow. An effect that makes up for numbers held back, or relieves their tension, then
        counts less by this factor.
        """
        strained = too_narrow(self.system, self.first)
        if not strained.scale:
            return self.gain
        wide = with_wider(self.system, strained)
        if self.trial is None:
            fit = base_fit(with_wider(wide, self.first.hypothesis), self.first.hypothesis)
        else:
            fit = fitted(wide, refine(wide, evaluate(wide, self.trial.suspect, self.trial.u), REFITTED))
        return fit.evidence() - base_fit(wide).evidence()


def too_narrow(system: System, fit: Fitted) -> Hypothesis:
    """The description's tolerances as wide as a fit of a system shows them to be, where they are far too narrow."""
    described = np.arange(system.base.spread.shape[1])
    held = float(np.sum(1 - np.diag(np.linalg.inv(fit.information))[described]))
    tension = float(np.sum(fit.z[described] ** 2)) / max(held, 1.0)
    far = calibration()["far"] ** 2
    names = [system.parameters.names[k] for k in described] if tension > far else []
    return Hypothesis("parameter", "description", scale=tuple((name, float(np.sqrt(tension))) for name in names))


def what_is_left(system: System, trial: Trial) -> FloatArray:
    """What a trial leaves of the rows, the base model's numbers following."""
    return np.asarray(system.y - system.full(trial.column)[:, 0] - system.A.times(eliminated(system, trial)))


def accepted(system: System, *steps: Step) -> System:
    """The model with the first answers of steps in it, all fitted together."""
    for step in steps:
        system = with_step(system, step)
    return relinearised(system)


def with_step(system: System, step: Step) -> System:
    """The model with a step's first answer."""
    if step.trial is not None:
        system = extended(system, step.trial)
    return with_wider(system, freed_by(system, step))


def left_out(system: System, *steps: Step, iterations: int = 8) -> System:
    """The model without what steps brought into it, all else fitted again from where it is."""
    for step in steps:
        if step.trial is not None:
            system = without(system, step.trial.suspect)
        freed = freed_by(system, step)
        system = with_wider(system, replace(freed, scale=tuple((name, 1 / factor) for name, factor in freed.scale)))
    return relinearised(system, iterations)


def freed_by(system: System, step: Step, unlike_others: float = 20.0) -> Hypothesis:
    """Numbers of the base model that a step's first answer frees; a joint whose friction slips is like no other.

    How it turns round may be ``unlike_others`` times as far from the other joints' as a joint's without slip.
    """
    hypothesis = step.first.hypothesis
    if not step.effect.memory:
        return Hypothesis("parameter", hypothesis.site, scale=hypothesis.scale)
    own = tuple(f"ordinary_presliding@joint{j + 1}." for j in step.joints)
    numbers = tuple((n, unlike_others) for n in system.base.parameters.names if n.startswith(own))
    return Hypothesis("parameter", hypothesis.site, scale=numbers)


def possible(system: System, step: Step) -> bool:
    """Whether the numbers of something found may be what they can be, beside all else in the model.

    A payload that is nearly a point has moments of inertia about zero, of either sign. Each of the three may come out
    beyond its 90 % interval by chance. So its mass decides within that, and a moment only if it is ``far`` below zero.
    """
    if step.trial is None:
        return True
    suspect = step.trial.suspect
    values, doubt = own_rows(system, suspect)
    width = np.full(len(values), NINETY)
    if suspect.effect.part == "mass":
        width[1:] = calibration()["far"]
    return bool((values + width * doubt >= 0)[suspect.nonnegative].all())


def own_rows(system: System, suspect: Suspect) -> tuple[FloatArray, FloatArray]:
    """The numbers (m,) of something found, beside all else in the model, and their deviations; of a scale, no doubt."""
    own, at = suspect.hypothesis.own, system.own(suspect)
    doubt = np.sqrt(np.diag(np.linalg.inv(system.information))[at])
    return own_values(own, system.z[at]), doubt * [0.0 if p.log else p.deviation for p in own]


def with_entries(system: System, other: System, found: Sequence[Suspect]) -> System:
    """A system with what was found in another one, fitted again from where it is there."""
    for suspect in found:
        system = extended(system, evaluate(system, suspect, other.z[other.own(suspect)]))
    return relinearised(system)
