"""Where a mismatch lives, without naming it: posture × band × channel, and joint by joint."""

from dataclasses import dataclass

import numpy as np

from twin.diagnose.objective import Objective, Sample
from twin.diagnose.refit import Fitted
from twin.measure.campaign import FloatArray

BANDS = 8


@dataclass(frozen=True)
class Mismatch:
    """Energy of the weighted residual over its number of data.

    Attributes:
        postures: (np,) names.
        edges_hz: (nb + 1,) of the bands.
        channels: (nc,) pairs, as ``21Z+/4Y+``.
        energy: (np, nb, nc) Σ |residual|²/σ².
        sites: site → expected fall of the cost if its stiffness and damping were free in every posture, or in every
            band (whichever brings more): a complex stiffness that knows no law.
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
    residual, J = objective.jacobian(fit.z)
    first = sample.recordings[0]
    edges = np.geomspace(max(first.frequency[0], 1e-3), first.frequency[-1] * 1.0001, BANDS + 1)
    labels = first.setup
    channels = tuple(f"{r}/{e}" for r in labels.response.label for e in labels.excitation.label)
    energy = np.zeros((len(sample.recordings), BANDS, len(channels)))
    at, cells = 0, []
    for k, r in enumerate(sample.recordings):
        size = r.frf.size
        part = residual[2 * at : 2 * (at + size)].view(complex).reshape(len(r.s), -1)
        at += size
        band = np.clip(np.searchsorted(edges, r.frequency, side="right") - 1, 0, BANDS - 1)
        cells.append(np.repeat(np.stack([np.full(len(band), k), band]), 2 * size // len(band), axis=1))
        for b in range(BANDS):
            energy[k, b] = np.sum(np.abs(part[band == b]) ** 2, axis=0)
    inverse = np.linalg.inv(J @ J.T + np.eye(len(J)))
    pull = J @ residual
    sites: dict[str, float] = {}
    for site in dict.fromkeys(p.site for p in fit.parameters if p.kind == "spring"):
        rows = [k for k, p in enumerate(fit.parameters) if p.kind == "spring" and p.site == site]
        gains = []
        for cell in np.concatenate(cells, axis=1):  # the posture, then the band, of every datum
            S = np.array([J[row] * (cell == part) for part in np.unique(cell) for row in rows])
            across = J @ S.T
            information = S @ S.T - across.T @ inverse @ across + np.eye(len(S))
            gradient = S @ residual - across.T @ inverse @ pull
            gains.append(float(0.5 * gradient @ np.linalg.solve(information, gradient)))
        sites[site] = max(gains)
    names = tuple(r.group for r in sample.recordings)
    return Mismatch(names, edges, channels, energy, dict(sorted(sites.items(), key=lambda item: -item[1])))
