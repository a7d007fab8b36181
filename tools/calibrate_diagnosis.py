"""The temperature of the hammer-test diagnosis from development cases: stated probabilities made to mean what they say.

    python tools/study_diagnose_hammer.py --out out/study --split development
    python tools/calibrate_diagnosis.py out/study/development

Temperature scaling (Guo et al., ICML 2017): the logarithms of the probabilities of one answer (first, alternatives,
none, other) are divided by the factor under which the right ones are most probable. Prints the number for
twin/diagnose/calibration.yaml, and the calibration error before and after. Cases outside the vocabulary are left out:
their right answer is "other", which a temperature cannot make.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from tools.study_diagnose_hammer import SAME, calibration_error, results
from tools.trials.cases import OUTSIDE
from twin.diagnose.decide import calibration

LEAST = 1e-6  # a probability is never believed to be smaller


def stated(result: dict[str, Any]) -> tuple[np.ndarray, int]:
    """Probabilities (n,) of the first answer's alternatives, none and other; index of the right one."""
    true = [tuple(thing) for thing in result["things"]]
    answers: dict[Any, float] = {"none": result["none"], "other": result["other"]}
    for found in result["effects"][:1]:
        answers[found["effect"], found["site"]] = found["probability"]
        answers |= {(a["effect"], a["site"]): a["probability"] for a in found["alternatives"]}
    right = "none" if not true else "other"
    for thing in true:
        right = next((key for key in (thing, SAME.get(thing)) if key in answers), right)
    return np.maximum(list(answers.values()), LEAST), list(answers).index(right)


def scaled(probability: np.ndarray, factor: float) -> np.ndarray:
    weights = np.exp(np.log(probability) / factor)
    return weights / weights.sum()


def error(answers: list[tuple[np.ndarray, int]], factor: float) -> float:
    tops = [(scaled(p, factor), right) for p, right in answers]
    return calibration_error([{"probability": p.max(), "right": p.argmax() == right} for p, right in tops])


def main() -> None:
    folder = Path(sys.argv[1])
    known = [r for r in results(folder) if "problem" not in r]
    known = [r for r in known if not any(kind in OUTSIDE["hammer"] for kind, _ in r["things"])]
    answers = [stated(r) for r in known]
    factors = np.geomspace(0.3, 10, 60)
    losses = [-np.mean([np.log(scaled(p, f)[right]) for p, right in answers]) for f in factors]
    best = float(factors[int(np.argmin(losses))])
    print(f"{len(answers)} cases; temperature: {calibration()['temperature'] * best:.2f}")
    print(f"calibration error {error(answers, 1.0):.3f} → {error(answers, best):.3f}")


if __name__ == "__main__":
    main()
