"""What a fit knows and does not know of a robot: ``posterior.h5`` beside its ``robot.yaml``, and draws from it.

The file holds the optimum, the prior and the data's information of every free number. So whatever follows from a model
(modes in an unseen posture, a depth of cut) can be given with its interval:

    /            attrs  format="twin-posterior", version=1
    name (n,)    as ``twin.model.parameters`` names them: ``joint1.z.stiffness``, ``link3.mass`` …
    log (n,)     value = mean · eˣ, else mean + x;   mean (n,), covariance (n, n) of x: the prior
    z (n,)       the optimum, x = L z, L Lᵀ = covariance;   information (n, n) of the data in z

A mass or a damper enters M or C linearly, a spring in series by its compliance: the likelihood is normal in those, the
prior in logarithms.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.measure.hdf5 import created, opened
from twin.model.parameters import Kind, Parameter, Parameters
from twin.physics import CATALOGUE
from twin.robot.description import Robot

FILE = "posterior.h5"
LINEAR = 0.05  # deviation of a logarithm below which its curvature is a thousandth of the density
WALK_STEPS = 4000  # of the walk
OPTIMAL = 2.38  # over √k, step of a random walk in posterior deviations (Roberts, Gelman and Gilks 1997)
OF_THE_ROBOT: tuple[Kind, ...] = ("spring", "entry", "link")


@dataclass(frozen=True)
class Posterior:
    """Free numbers (n) of a fit, their optimum ``z`` (n,) and the data's ``information`` (n, n) in z, noise scaled.

    ``damping_scatter``: deviation of ln damping in a posture that was not recorded, beyond that of the numbers, and its
    degrees of freedom (:mod:`twin.identify.damping_transfer`).
    """

    parameters: Parameters
    z: np.ndarray
    information: np.ndarray
    damping_scatter: float = 0.0
    damping_freedom: int = 100

    @classmethod
    def of(cls, fit: Any) -> "Posterior":
        """Of a :class:`twin.identify.elastic.Fit` or a :class:`twin.diagnose.refit.Fitted`, noise scaled."""
        known = getattr(fit.parameters, "written", fit.parameters)  # names through which values enter a robot
        n = len(fit.z)
        data = fit.fisher if hasattr(fit, "fisher") else fit.information - np.eye(n)
        scale = fit.scale if hasattr(fit, "fisher") else max(1.0, fit.misfit)
        return cls(known, np.asarray(fit.z), np.asarray(data) / scale)

    def draw(self, count: int, seed: int = 0) -> np.ndarray:
        """Values (count, n) in the parameters' units; the same for the same seed.

        Numbers whose logarithm the data hold to ``LINEAR`` are normal given the others. The few that are not are walked
        (Metropolis) through their exact marginal density, every draw on a chain of its own from the optimum.
        """
        rng, n, root = np.random.default_rng(seed), len(self.z), self.parameters.root
        precision = self.information + np.eye(n)
        spread = np.sqrt(np.diag(root @ np.linalg.inv(precision) @ root.T))
        bent = np.array([p.log for p in self.parameters], bool) & (spread > LINEAR)
        alone = root - np.diag(np.diag(root))
        bent &= ~(alone.any(axis=0) | alone.any(axis=1))
        few, rest = np.flatnonzero(bent), np.flatnonzero(~bent)
        across = self.information[np.ix_(rest, few)]
        follow = np.linalg.solve(precision[np.ix_(rest, rest)], across)  # of the rest, per unit of the few
        held = self.information[np.ix_(few, few)] - across.T @ follow
        size, axes = np.linalg.eigh(0.5 * (held + held.T))
        w, z = self._walk(
            rng, count, few, (axes * np.maximum(size, 0.0)) @ axes.T
        )  # where sizes are in doubt, below zero
        factor = np.linalg.cholesky(precision[np.ix_(rest, rest)])
        out = np.tile(self.z, (count, 1))
        out[:, few] = z
        out[:, rest] += -w @ follow.T + np.linalg.solve(factor.T, rng.normal(size=(len(rest), count))).T
        return np.array([self.parameters.values(row) for row in out])

    def _walk(
        self, rng: np.random.Generator, count: int, few: np.ndarray, held: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Some logarithmic numbers (count, k): values' relative change in prior deviations, and z.

        ``held`` (k, k) is what the data say of them, the others integrated out: quadratic in values, or in compliances,
        while the prior is normal in logarithms.
        """
        at, scale, k = self.z[few], np.diag(self.parameters.root)[few], len(few)
        turn = np.array([self.parameters[i].linear_power for i in few])
        if not k:
            return np.zeros((count, 0)), np.zeros((count, 0))

        # what the data pull: no farther than to twice the fitted value, where noise scaled up says hardly anything else
        slope = turn * np.minimum(turn * at, np.diag(held) / scale)

        def seen(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            w = turn * np.expm1(np.minimum(turn * (z - at) * scale, 50.0)) / scale
            return w, 0.5 * np.sum((w @ held - 2 * slope) * w + z**2, axis=1)

        joint = np.linalg.inv(np.linalg.cholesky(held + np.eye(k))).T
        z = np.tile(at, (count, 1))
        w, energy = seen(z)
        for number in range(WALK_STEPS):
            step = rng.normal(size=(count, k))
            if number % 2:  # one at a time, as far as its prior goes
                step *= rng.exponential(size=(count, 1)) * (np.arange(k) == rng.integers(k, size=(count, 1)))
            else:
                step = rng.exponential(size=(count, 1)) * OPTIMAL / np.sqrt(k) * step @ joint.T
            tried, after = seen(z + step)
            accept = np.log(rng.random(count)) < energy - after
            z[accept] += step[accept]
            w[accept], energy[accept] = tried[accept], after[accept]
        return w, z

    def robots(self, robot: Robot, count: int, seed: int = 0) -> list[Robot]:
        """The fitted robot with its own numbers drawn anew, ``count`` times; what belongs to recordings is left out."""
        keep = [k for k, p in enumerate(self.parameters) if p.kind in OF_THE_ROBOT]
        own = self.parameters.select(keep)
        return [own.apply(robot, row[keep]) for row in self.draw(count, seed)]


def save_posterior(path: str | Path, posterior: Posterior) -> None:
    """Write ``posterior.h5``, whole or not at all."""
    items = posterior.parameters.items
    with created(path) as file:
        file.attrs.update(format="twin-posterior", version=1)
        for field in ("name", "unit", "kind", "source"):
            file[field] = [str(getattr(p, field)) for p in items]
        file["log"] = np.array([p.log for p in items], bool)
        file["mean"] = np.array([p.mean for p in items], float)
        file["covariance"] = posterior.parameters.covariance
        file["z"] = posterior.z
        file["information"] = posterior.information
        file.attrs["damping_scatter"] = posterior.damping_scatter
        file.attrs["damping_freedom"] = posterior.damping_freedom


def load_posterior(path: str | Path) -> Posterior:
    """Read ``posterior.h5``.

    Raises:
        InputError: not such a file.
    """
    with opened(Path(path), "not a posterior that twin fit or twin diagnose wrote") as file:
        if file.attrs.get("format") != "twin-posterior":
            raise InputError(path, "format", "expected twin-posterior, as twin fit and twin diagnose write it")
        covariance = file["covariance"][()]
        words = {field: file[field].asstr()[()] for field in ("name", "unit", "kind", "source")}
        scatter = float(file.attrs.get("damping_scatter", 0.0)), int(file.attrs.get("damping_freedom", 100))
        log, mean, z, information = (file[field][()] for field in ("log", "mean", "z", "information"))
    deviation = np.sqrt(np.diag(covariance))
    items = [
        Parameter(name, unit, kind, bool(log[k]), float(mean[k]), float(deviation[k]), source)
        for k, (name, unit, kind, source) in enumerate(zip(*words.values(), strict=True))
    ]
    return Posterior(Parameters(tuple(items), covariance), z, information, *scatter)


def posterior_beside(robot: Robot) -> Posterior | None:
    """The posterior that was written beside a robot's file, ``None`` where there is none."""
    path = robot.path.with_name(FILE) if robot.path else None
    return load_posterior(path) if path is not None and path.is_file() else None


def without_entries(posterior: Posterior, robot: Robot) -> Posterior:
    """The posterior without numbers of entries that the robot does not have (``--without``): they have no effect."""
    keys = {f"{entry.effect}@{entry.site}" for entry in robot.physics}
    sprung = {entry.site for entry in robot.physics if CATALOGUE[entry.effect].hinge}
    keep = [k for k, p in enumerate(posterior.parameters) if _present(p, keys, sprung)]
    if len(keep) == len(posterior.z):
        return posterior
    parameters = posterior.parameters.select(keep)
    x = posterior.parameters.root @ posterior.z
    z = np.linalg.solve(parameters.root, x[keep])
    return replace(posterior, parameters=parameters, z=z, information=posterior.information[np.ix_(keep, keep)])


def _present(parameter: Parameter, keys: set[str], sprung: set[str]) -> bool:
    if "@" in parameter.name:
        return parameter.name.partition("].")[0].rpartition(".")[0] in keys or any(
            parameter.name.startswith(f"{key}.") for key in keys
        )
    if parameter.kind == "spring" and not parameter.site.endswith(".z"):
        return parameter.site in sprung
    return True
