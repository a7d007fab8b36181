"""The robot that numbers of a log's model describe: bodies that can exist, entries as they are written, presliding."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from twin.measure.campaign import FloatArray
from twin.model.linear import symmetric
from twin.model.possible import nearest_possible, possible
from twin.model.torque_base import PRESLIDING, PRESLIDING_TRAVELS, dry_level
from twin.model.torque_numbers import corrected, numbers_of
from twin.model.torque_whitened import Whitened
from twin.physics import CATALOGUE, effect_of
from twin.physics.effect import axis_of
from twin.robot.description import Entry, Robot

INWARDS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # shares of the way to the described robot, whose links are bodies


def robot_of(rows: Whitened, z: FloatArray, entries: Sequence[Entry] = ()) -> Robot:
    """The description at the nearest to z that can exist, with entries."""
    base, z = rows.base, that_can_exist(rows, z)
    values = base.values(rows.plain(z))
    columns = base.regressor.columns
    values, changes = values[: len(columns)], values[len(columns) :]
    floor = [column.nonnegative and column.group != "link" for column in columns]
    fitted = base.regressor.robot_with(np.where(floor, np.maximum(values, 0.0), values))
    numbers = numbers_of(base.regressor.robot)
    told = {rows.parameters.names[k] for k in rows.widened}
    fitted = corrected(fitted, numbers, [p.mean + x for p, x in zip(numbers, changes, strict=True)], told)
    added = [_rounded(entry, fitted) for entry in entries]
    return fitted.model_copy(update={"physics": [*fitted.physics, *added]})


def with_presliding(rows: Whitened, z: FloatArray, added: Sequence[Entry], robot: Robot, slight: float = 1e-3) -> Robot:
    """The description at z with the fit's ordinary ``presliding``, which its Coulomb friction gives up.

    After a reversal a bristle of travel t has turned round by 1 − exp(−x/t). An element of yield torque Y and stiffness
    K has turned by min(K x/(2 Y), 1). Elements of all travels together turn as the fitted bristles do: a least-squares
    fit on a logarithmic grid, none below zero (Masing's rule; Iwan, J. Appl. Mech. 33, 1966). An element of less than a
    ``slight`` share of dry friction is left out. ``added`` are entries that the model has beside the description's.
    """
    base = rows.base
    travels, first = base.presliding[0].shape[2], base.spread.shape[1]
    z = rows.plain(z)
    alone = first + travels + base.regressor.robot.axis_count * base.ripple[0].shape[2]
    found = [entry for entry in added if entry.site.startswith("joint")]
    dry_name, slip_name = effect_of("dry").name, effect_of("slip").name
    physics = list(robot.physics)
    for j in np.flatnonzero(base.sliding).tolist():
        site = f"joint{j + 1}"
        dry = next((k for k, e in enumerate(physics) if (e.effect, e.site) == (dry_name, site)), None)
        if dry is None:
            continue
        own = z[alone + j * travels : alone + (j + 1) * travels]
        moved = np.concatenate([r.motion.velocity[:, j] for r in base.runs])
        here = [e for e in found if axis_of(e.site) == j]
        level = base.sliding[j] - sum(CATALOGUE[e.effect].part_of_dry(e.values, moved) for e in here)
        share = max(level, 0.0) * (PRESLIDING * z[first : first + travels] + base.apart[j] * own)
        ends, torque = _slip_elements(PRESLIDING_TRAVELS[base.regressor.robot.axes[j].type], share)
        coulomb = dry_level(physics[dry])
        turned = (CATALOGUE[e.effect].shared_dry(robot.values(e)) for e in physics)
        free = max(coulomb - sum(shared for drive, shared in turned if drive == site), 0.0)  # else it turns with two
        torque *= min(1.0, free / max(float(torque.sum()), 1e-300))
        some = torque > slight * coulomb
        if not some.any():
            continue
        level_name = CATALOGUE[dry_name].parameters[0].name
        left = {level_name: max(coulomb - float(torque[some].sum()), 0.0)}
        physics[dry] = Entry.model_validate({"effect": dry_name, "site": site, **left})
        slip = {"yield_torque": torque[some].tolist(), "stiffness": (2 * torque / ends)[some].tolist()}
        at = next((k for k, e in enumerate(physics) if (e.effect, e.site) == (slip_name, site)), len(physics))
        if at < len(physics):
            slip = {name: [*physics[at].values[name], *items] for name, items in slip.items()}
        physics[at : at + 1] = [Entry.model_validate({"effect": slip_name, "site": site, **slip})]
    return robot.model_copy(update={"physics": physics})


def _slip_elements(travels: FloatArray, share: FloatArray, count: int = 10) -> tuple[FloatArray, FloatArray]:
    """Travels of elements, rad (m), and their yield torques: together they turn round as bristles of ``share`` do."""
    x = np.geomspace(travels[0] / 10, 10 * travels[-1], 80)
    ends = np.geomspace(travels[0] / 3, 5 * travels[-1], count)
    torque, _ = nnls(np.minimum(x[:, None] / ends, 1), (1 - np.exp(-x[:, None] / travels)) @ share)
    return ends, torque


def that_can_exist(rows: Whitened, z: FloatArray) -> FloatArray:
    """The nearest to z (n,), as the fit measures it, whose links are bodies and whose friction is not below zero.

    What the data do not hold gives way; what was found stays as it is.
    """
    base, size, shared = rows.base, len(rows.base.parameters), rows.base.spread.shape[1]
    regressor = base.regressor
    values = base.values(rows.plain(z))[: len(regressor.columns)]
    links = values[: 10 * regressor.robot.axis_count].reshape(-1, 10)
    others = [v for v, column in zip(values, regressor.columns, strict=True) if column.nonnegative]
    if min(others, default=0.0) >= 0 and all(possible(link) for link in links):
        return z
    step = base.spread[: len(values)] * rows.plain(np.ones(len(z)))[:shared]
    A = rows.information[:size, :size]
    follow = np.linalg.solve(A[shared:, shared:], A[shared:, :shared])
    H = A[:shared, :shared] - A[shared:, :shared].T @ follow  # of the links, all else where it fits best
    described = -z[:shared]
    try:
        d = nearest_possible(regressor, symmetric(H), np.zeros(shared), values, step)
    except ArithmeticError:
        d = described
    for share in (0.0, *INWARDS, 1.0):  # the solver's last digits may leave a link just outside
        inside = (1 - share) * d + share * described
        out = z.copy()
        out[:shared] += inside
        out[shared:size] -= follow @ inside
        links = base.values(rows.plain(out))[: links.size].reshape(links.shape)
        if all(possible(link) for link in links):
            break
    return out


def _rounded(entry: Entry, robot: Robot) -> Entry:
    """An entry whose numbers are in the range that its effect allows.

    What slip that holds more at rest than friction is in motion takes back of dry friction is a law without a name.
    """
    values, effect = dict(entry.model_extra or {}), CATALOGUE[entry.effect]
    if effect.part == "dry" and (level := dry_level(entry)) < 0:
        law = {"formula": f"c1*sign(v{axis_of(entry.site) + 1})", "coefficients": [level]}
        return Entry.model_validate({"effect": effect_of("law").name, "site": entry.site, **law})
    for parameter in effect.parameters:
        if parameter.nonnegative and parameter.name in values and not parameter.word:
            given = values[parameter.name]
            values[parameter.name] = [max(x, 0.0) for x in given] if isinstance(given, list) else max(given, 0.0)
    return Entry(effect=entry.effect, site=entry.site, **effect.nearest(robot, entry.site, values))
