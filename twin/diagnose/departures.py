"""How far a fit takes the numbers of a description from what they are described as."""

import numpy as np

from twin.diagnose.refit import Fitted

STRAINED = 3.5  # prior deviations


def far_off(fit: Fitted) -> list[tuple[int, float, float]]:
    """Described numbers that a fit takes much further than their description allows, as :func:`departures`."""
    return [one for one in departures(fit) if one[2] > STRAINED]


def departures(fit: Fitted) -> list[tuple[int, float, float]]:
    """How far a fit takes every number of the description, farthest first.

    Index, change (of a logarithm where the number has one) and standard deviations. Answers are left out, all but
    angles of postures.
    """
    found = []
    answered = dict(fit.hypothesis.scale)
    base = list(zip(fit.parameters, fit.values, strict=True))[: len(fit.z) - len(fit.hypothesis.own)]
    for k, (p, value) in enumerate(base):
        if p.kind == "sag" or (p.name in answered and p.kind != "posture"):
            continue
        change = float(np.log(value / p.mean)) if p.log else float(value - p.mean)
        found.append((k, change, abs(change) / p.deviation * answered.get(p.name, 1.0)))
    return sorted(found, key=lambda one: -one[2])
