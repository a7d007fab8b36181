"""The result of a diagnosis: what is missing, how sure, how much better the model becomes. It prints itself."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from twin.diagnose.decide import Decision, calibration
from twin.diagnose.refit import Fitted
from twin.identify.uncertainty import NINETY
from twin.robot.description import Robot

Kind = Literal["adequate", "named", "ambiguous", "located", "unexplained"]


@dataclass
class Verdict:
    """``twin diagnose``'s answer; ``data()`` is the content of diagnosis.json.

    Attributes:
        kind: the verdict's word.
        robot: the description with what was found, or the base model refitted.
        decision: who was left, with probabilities.
        error: ``as_given``, ``before``, ``after`` → ``train``, ``held_out``; ``noise_floor``.
        location: where the base model misses.
        smallest_visible: per effect and site, the size this recording would have shown.
        checks: triage, one line each.
    """

    kind: Kind
    robot: Robot
    decision: Decision
    base: Fitted
    error: dict[str, Any]
    held_out: list[str]
    location: list[dict[str, Any]] = field(default_factory=list)
    smallest_visible: list[dict[str, Any]] = field(default_factory=list)
    next_test: dict[str, Any] | None = None
    checks: list[str] = field(default_factory=list)
    model: dict[str, str | None] = field(default_factory=lambda: {"robot": None, "mjcf": None})
    origin: dict[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """Plain data in the format ``twin-diagnosis``."""
        return {
            "format": "twin-diagnosis", "version": 1, "verdict": self.kind, "effects": self._effects(),
            "probabilities": {"none": self.decision.none, "other": self.decision.other},
            "location": self.location, "error": self.error, "smallest_visible": self.smallest_visible,
            "next_test": self.next_test, "model": self.model, "held_out": self.held_out, "triage": self.checks,
            "provenance": self.origin,
        }  # fmt: skip

    def _effects(self) -> list[dict[str, Any]]:
        if self.kind not in ("named", "ambiguous") or not self.decision.ranked:
            return []
        first, probability = self.decision.ranked[0], self.decision.probability
        others = [
            {"effect": fit.hypothesis.effect, "site": fit.hypothesis.site, "probability": p}
            for fit, p in list(zip(self.decision.ranked, probability, strict=True))[1:]
        ]
        return [
            {
                "effect": first.hypothesis.effect, "site": first.hypothesis.site, "probability": probability[0],
                "alternatives": others, "parameters": estimates(first), "evidence": self._evidence(first),
            }
        ]  # fmt: skip

    def _evidence(self, first: Fitted) -> str:
        before, after = self.error["before"], self.error["after"]
        where = self.location[0] if self.location else None
        spot = (
            " The base model misses most in {} at {:.1f}–{:.1f} Hz.".format(where["posture"], *where["band_hz"])
            if where
            else ""
        )
        held = ""
        if before["held_out"] is not None:
            falls = f"{before['held_out']:.2%} → {after['held_out']:.2%}"
            held = f", on {', '.join(self.held_out)}, which was not used, {falls}"
        return (
            f"With it the error on the recordings used falls {before['train']:.2%} → {after['train']:.2%}{held} "
            f"(noise {self.error['noise_floor']:.2%}).{spot}"
        )

    def __str__(self) -> str:
        word = {
            "adequate": "adequate: nothing is missing that these recordings could show",
            "named": "named", "ambiguous": "ambiguous: these recordings cannot tell the following apart",
            "located": "located, without a name",
            "unexplained": "unexplained: a mismatch beyond noise that no known effect explains",
        }  # fmt: skip
        lines = [word[self.kind]]
        for effect in self._effects():
            lines.append(f"  {effect['effect']} at {effect['site']}   probability {effect['probability']:.2f}")
            for name, item in effect["parameters"].items():
                values = item["value"] if isinstance(item["value"], list) else [item["value"]]
                ranges = item["interval90"] if isinstance(item["value"], list) else [item["interval90"]]
                for value, (low, high) in zip(values, ranges, strict=True):
                    lines.append(f"      {name} {value:.4g} {item['unit']}   90 %: {low:.4g} … {high:.4g}")
            for other in effect["alternatives"]:
                if other["probability"] >= calibration()["alternative"]:
                    lines.append(f"  or {other['effect']} at {other['site']}   probability {other['probability']:.2f}")
            lines.append(f"  {effect['evidence']}")
        lines.append(f"  nothing missing {self.decision.none:.2f}, something else {self.decision.other:.2f}")
        for name in ("as_given", "before", "after"):
            item = self.error[name]
            held = "" if item["held_out"] is None else f", held out {item['held_out']:.2%}"
            lines.append(f"  error {name.replace('_', ' '):9s} {item['train']:.2%}{held}")
        lines.append(
            f"  noise floor {self.error['noise_floor']:.2%}; held out: {', '.join(self.held_out) or 'nothing'}"
        )
        if self.next_test:
            lines.append(f"  next test: {self.next_test['description']}")
        lines += [f"  check: {check}" for check in self.checks]
        if self.model["robot"]:
            lines.append(f"  wrote {self.model['robot']}, {self.model['mjcf']}")
        return "\n".join(lines)


def judge(decision: Decision) -> Kind:
    """The word for a decision."""
    top = decision.probability[0] if decision.probability else 0.0
    if decision.none >= max(top, decision.other):
        return "adequate"
    if decision.other > top:
        return "unexplained"
    return "ambiguous" if decision.rivals or decision.none >= calibration()["alternative"] else "named"


def estimates(fit: Fitted) -> dict[str, Any]:
    """Value, unit and 90 % interval of a hypothesis' own parameters; a list's numbers in one list."""
    root = fit.parameters.root
    covariance = root @ np.linalg.inv(fit.information) @ root.T * max(1.0, fit.misfit)
    x = root @ fit.z
    found: dict[str, Any] = {}
    indices = fit.own
    if not indices and fit.hypothesis.effect == "parameter":
        indices = [fit.parameters.names.index(fit.hypothesis.scale[0][0])]
    for k in indices:
        parameter = fit.parameters[k]
        deviation = float(np.sqrt(covariance[k, k]))
        ends = [float(parameter.value(x[k] + side * NINETY * deviation)) for side in (-1, 1)]
        name = parameter.name.rpartition(".")[2]
        found[name] = {"value": float(fit.values[k]), "unit": parameter.unit, "interval90": ends}
    for name in [name for name in found if name.endswith("[0]")]:
        stem = name[:-3]
        items = [found.pop(f"{stem}[{k}]") for k in range(3) if f"{stem}[{k}]" in found]
        found[stem] = {
            "value": [i["value"] for i in items], "unit": items[0]["unit"],
            "interval90": [i["interval90"] for i in items],
        }  # fmt: skip
    return found
