"""Where a mismatch lives, without naming it: posture × band × channel, and joint by joint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnose.refit import Fitted
from twin.identify.objective import Objective, Sample, factors
from twin.measure.campaign import FloatArray
from twin.model.held_law import UnderLaw, receptances
from twin.model.sensitivity import observe_all
from twin.parallel import spread

MAP_BANDS = 8
SCALES = (0.3, 0.1, 0.03, 0.01, 0.003)
"""Of a stiffness: by how much a law may change it."""


@dataclass(frozen=True)
class Mismatch:
    """Energy of the weighted residual over its number of data.

    Attributes:
        postures: (np,) names.
        edges_hz: (nb + 1,) of the bands.
        channels: (nc,) pairs, as ``21Z+/4Y+``.
        energy: (np, nb, nc) Σ |residual|²/σ².
        sites: site → what :func:`free_laws` would gain there; 0 where it gains nothing.
    """

    postures: tuple[str, ...]
    edges_hz: FloatArray
    channels: tuple[str, ...]
    energy: FloatArray
    sites: dict[str, float]

    def spots(self, count: int = 5) -> list[dict[str, object]]:
        """Where most of it is: posture, band, the channels that hold most of that, and the share of all."""
        total = self.energy.sum()
        by_band = self.energy.sum(axis=2)
        found: list[dict[str, object]] = []
        for flat in np.argsort(-by_band, axis=None)[:count]:
            p, b = np.unravel_index(flat, by_band.shape)
            channels = np.argsort(-self.energy[p, b])[:3]
            found.append(
                {
                    "posture": self.postures[p],
                    "run": None,
                    "band_hz": [float(self.edges_hz[b]), float(self.edges_hz[b + 1])],
                    "channels": [self.channels[c] for c in channels],
                    "share": float(by_band[p, b] / total) if total > 0 else 0.0,
                }
            )
        return found


def mismatch(fit: Fitted, sample: Sample) -> Mismatch:
    """Where a fitted model misses a recording."""
    objective = Objective(fit.robot, fit.parameters, sample)
    residual = objective.residual(fit.z)
    first = sample.recordings[0]
    edges = np.geomspace(max(first.frequency[0], 1e-3), first.frequency[-1] * 1.0001, MAP_BANDS + 1)
    labels = first.setup
    channels = tuple(f"{r}/{e}" for r in labels.response.label for e in labels.excitation.label)
    energy = np.zeros((len(sample.recordings), MAP_BANDS, len(channels)))
    at = 0
    for k, r in enumerate(sample.recordings):
        size = r.frf.size
        part = residual[2 * at : 2 * (at + size)].view(complex).reshape(len(r.s), -1)
        at += size
        band = np.clip(np.searchsorted(edges, r.frequency, side="right") - 1, 0, MAP_BANDS - 1)
        for b in range(MAP_BANDS):
            energy[k, b] = np.sum(np.abs(part[band == b]) ** 2, axis=0)
    names = tuple(r.group for r in sample.recordings)
    nothing = np.log(3.0)  # what three laws gain together that the recordings say nothing of
    sites = {site: max(gain - nothing, 0.0) for site, gain in free_laws(fit, sample).items()}
    return Mismatch(names, edges, channels, energy, sites)


def free_laws(fit: Fitted, sample: Sample, aside: FloatArray | None = None, processes: int = 1) -> dict[str, float]:
    """What ln evidence would gain if a spring had a law without a name, site by site, most first.

    Three laws are tried, each as likely as an effect that has a name. One is a stiffness of its own in every posture.
    One is a stiffness that is complex and bends over frequency. One is a damper of order one half, as rubber and grease
    are (Bagley and Torvik, J. Rheol. 27, 201, 1983). The gain is to first order about the fit, and everything that is
    free there makes room. A share x of the stiffness has the prior N(0, s²), all scales s of ``SCALES`` alike. Columns
    ``aside`` (m, data), of prior deviation one, make room too. Sites are spread over ``processes``.
    """
    objective = Objective(fit.robot, fit.parameters, sample)
    residual, J = objective.jacobian(fit.z)
    Q, rho = _left(residual, fit.z, J if aside is None else np.vstack([J, aside]))
    by_z = np.linalg.inv(fit.parameters.transform(fit.values).T)
    springs = [k for k, p in enumerate(fit.parameters) if p.kind == "spring" and p.quantity == "stiffness"]
    slopes = fit.values[springs, None] * (by_z[springs] @ J)
    springs, slopes = [k for k, slope in zip(springs, slopes, strict=True) if slope.any()], slopes[slopes.any(axis=1)]
    ends = np.cumsum([0, *(2 * w.size for w in objective.weight)])
    n = len(sample.recordings)
    laws = slice(0, n), slice(n, n + 4), slice(n + 4, n + 5)  # posture by posture, complex and bending, order one half

    def gain(number: int) -> float:
        columns = np.zeros((n + 5, len(slopes[number])))
        for p, r in enumerate(sample.recordings):
            own = slice(ends[p], ends[p + 1])
            octaves = np.repeat(np.log(r.frequency / np.sqrt(r.frequency[0] * r.frequency[-1])), r.frf[0].size)
            law = np.array([1j + 0 * octaves, octaves, 1j * octaves, octaves**2, np.sqrt(1j * np.exp(octaves))])
            columns[p, own] = slopes[number, own]
            columns[n:, own] = (law * slopes[number, own].view(complex)).view(float)
        return float(np.logaddexp.reduce([_mean(logs) for logs in _evidences(Q, rho, columns, laws)]))

    gains = list(spread(gain, len(springs), processes))
    found = {fit.parameters[k].site: own for k, own in zip(springs, gains, strict=True)}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def free_blows(fit: Fitted, sample: Sample, site: str) -> tuple[float, FloatArray]:
    """What ln evidence would gain if the law held at a joint were another one, and its columns (m, data).

    Beside that law every blow has a complex stiffness of its own there. The gain is to first order about the fit, and
    everything that is free makes room. Shares of the joint's stiffness have the prior of :func:`free_laws`. The columns
    have prior deviation one.
    """
    objective = Objective(fit.robot, fit.parameters, sample)
    residual, J = objective.jacobian(fit.z)
    Q, rho = _left(residual, fit.z, J)
    columns, at = [], 0
    models = observe_all(fit.robot, [r.setup for r in sample.recordings], fit.parameters, fit.values)
    for r, w, (seen, model) in zip(sample.recordings, objective.weight, models, strict=True):
        assert isinstance(r, UnderLaw)
        index = model.coordinates.index(site)
        joint = receptances(seen, index, r.s, r.power)
        turned = joint.into - joint.own[:, None] * joint.reaction(r.kappa, r.rest)
        turned /= 1 + r.kappa * joint.own[:, None]
        moved = -model.strain[index] * joint.out[:, :, None] * turned[:, None, :] * w
        loss = r.s / np.sqrt(r.frequency[0] * r.frequency[-1]) / (2 * np.pi)
        for blow in range(w.shape[2]):
            for law in (np.ones_like(r.s), loss):
                column = np.zeros(w.shape, complex)
                column[:, :, blow] = law[:, None] * moved[:, :, blow]
                columns.append(np.zeros(J.shape[1]))
                columns[-1][at : at + 2 * w.size] = column.reshape(-1).view(float)
        at += 2 * w.size
    found = np.array(columns)
    (logs,) = _evidences(Q, rho, found)
    return max(_mean(logs), 0.0), SCALES[int(np.argmax(logs))] * found


def _left(residual: FloatArray, z: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis (data + m, m) of what columns (m, data), the fit's own first, can do within their prior,
    and what is left of a residual."""
    Q, _ = factors(columns)
    rho = np.concatenate([residual, -z, np.zeros(len(columns) - len(z))])
    return Q, rho - Q @ (Q.T @ rho)


def _mean(logs: Sequence[float]) -> float:
    """ln evidence of what is one of several, each as likely."""
    return float(np.logaddexp.reduce(logs) - np.log(len(logs)))


def _evidences(
    Q: FloatArray, rho: FloatArray, columns: FloatArray, laws: Sequence[slice] = (slice(None),)
) -> list[list[float]]:
    """ln evidence that columns (m, data) gain, law by law, for each of ``SCALES``.

    ρ (data + n,) is what is left of the residual. Columns of all laws meet Q together: it is long.
    """
    data = columns.shape[1]
    inside = columns @ Q[:data]
    every, pulls = columns @ columns.T - inside @ inside.T, columns @ rho[:data]
    found: list[list[float]] = []
    for law in laws:
        information, pull = every[law, law], pulls[law]
        logs: list[float] = []
        for scale in SCALES:
            posterior = scale**2 * information + np.eye(len(pull))
            gained = 0.5 * scale**2 * pull @ np.linalg.solve(posterior, pull)
            logs.append(float(gained - 0.5 * np.linalg.slogdet(posterior)[1]))
        found.append(logs)
    return found
