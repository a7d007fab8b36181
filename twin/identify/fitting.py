"""A fit and what it is worth: what is held out, errors, modes beside measured ones, what to doubt."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from twin.errors import InputError
from twin.identify.damping_transfer import Miss, Transfer, damping_doubt, misses_of_frf, transfer
from twin.identify.descent import ASTRAY
from twin.identify.elastic import Fit, fit_frf, with_nodes
from twin.identify.elastic_compare import Comparison, comparison, expected_error, judge
from twin.identify.elastic_modal import (
    ModalObjective,
    ModalPosture,
    PairedMode,
    fit_modes,
    frequency_error,
    modal_postures,
    predict_modes,
)
from twin.identify.objective import Sample
from twin.identify.posterior import Posterior
from twin.identify.press import blows_of, press
from twin.identify.uncertainty import (
    LARGE_DRIFT,
    Combination,
    Estimate,
    combinations,
    correlation,
    estimates,
    profile,
)
from twin.measure.campaign import Campaign, Channels, ComplexArray, FloatArray, dead_channels
from twin.measure.modal import identify_modes
from twin.measure.modal_table import ModalTable
from twin.measure.shapes import mac
from twin.model.linear import linearise
from twin.model.modes import Modes, modes
from twin.model.parameters import SATURATED, Parameters, free_parameters, require_springs
from twin.model.recorded import Recorded, base_name, believed, noise_stated, placed, without_limits
from twin.model.sensitivity import Structure, structure
from twin.parallel import Progress
from twin.robot.description import Robot, parse_robot
from twin.robot.mechanism import assemble

LOW_COHERENCE = 0.6  # of the channels' median, below which a band is named
LARGE_MISFIT = 2.0  # χ² per datum
BEYOND_NOISE = 3.0  # deviations of a perfect model's χ² per datum
SATURATED_TOLD = 8  # numbers that a warning lists; more are counted
CLOSE_RIVAL = 3.0  # cost above the best of another minimum that is still to be reckoned with
LARGE_CORRELATION = 0.95
PROFILED = 4  # parameters whose profile is drawn


@dataclass
class Fitting:
    """A fit and what it is worth.

    Attributes:
        source: the recording or modal table.
        robot: the fitted description.
        fit: the optimum; ``estimates`` every parameter with interval.
        error: ``train`` and ``held_out`` as the contract defines them; ``None`` where nothing was held out.
        in_turn: labels of blows (or sensors) that were left out in turn, of one or two postures: the held-out error.
        expected: the held-out error that noise and tolerances explain, and the noise floor alone.
        postures: per posture role, model's modes and, where there are any, measured ones.
        left_out: posture → error when only that posture was not used.
        damping: how well damping is predicted in postures that were not fitted to.
    """

    source: str
    robot: Robot
    fit: Fit
    estimates: list[Estimate]
    combinations: list[Combination]
    held_out: list[str]
    error: dict[str, float | None]
    expected: dict[str, float | None]
    postures: dict[str, dict[str, Any]]
    warnings: list[str]
    in_turn: list[str] = field(default_factory=list)
    left_out: dict[str, float] = field(default_factory=dict)
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    profiles: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    damping: Transfer = field(default_factory=transfer)


# --- FRFs -------------------------------------------------------------------------------------------------------------


def fit_campaign(
    campaign: Campaign,
    source: str,
    described: Robot,
    *,
    hold_out: list[str] | None,
    leave_one_out: bool,
    band_hz: tuple[float, float] | None,
    tolerances: bool,
    starts: int,
    seed: int,
    progress: Progress,
    profiled: bool,
) -> Fitting:
    """Fit a description to a hammer test; options as of :func:`twin.fit`, ``profiled``: with the weakest's profiles."""
    require_springs(described)
    recordings = list(believed(campaign, described, source, band_hz)[0].values())
    names = list(dict.fromkeys(r.setup.name for r in recordings))
    aliases = {group: base_name(campaign, group) for group in campaign.postures}
    held = _held_out(source, hold_out, names, aliases)
    train = [r for r in recordings if r.setup.name not in held]
    rest = [r for r in recordings if r.setup.name in held]
    left = names if leave_one_out and len(names) > 1 else []
    tick = progress("fit", (starts + 1) * (1 + len(left)))

    def run(used: list[Recorded]) -> Fit:
        free = free_parameters(
            described, dict.fromkeys(r.setup.name for r in used), campaign.response.label, tolerances=tolerances
        )
        found = fit_frf(described, used, free, starts=starts, seed=seed, progress=tick)
        missed = tolerances and found.noise_known and found.misfit > 1 + BEYOND_NOISE * np.sqrt(2 / max(found.data, 1))
        return with_nodes(described, used, found) if missed else found

    fitted = run(train)
    final = _checked(fitted.parameters.apply(described, fitted.values))
    comparisons = {"fitted": comparison(final, judge(final, _where(train, fitted)), source)}
    error: dict[str, float | None] = {"train": comparisons["fitted"].error, "held_out": None}
    expected: dict[str, float | None] = {"noise_floor": comparisons["fitted"].noise_floor, "held_out": None}
    if rest:
        unseen = _where(rest, fitted)
        comparisons["held out"] = comparison(final, judge(final, unseen), source)
        error["held_out"] = comparisons["held out"].error
        expected["held_out"] = expected_error(final, fitted, unseen) if noise_stated(recordings) else None
    in_turn = blows_of(Sample(tuple(train))) if not rest else ()
    if in_turn:
        missed, data = press(fitted.robot, fitted.parameters, fitted.z, Sample(tuple(train)))
        error["held_out"] = float(np.sqrt(missed / data))
    left_out = {}
    for name in left:
        other = run([r for r in recordings if r.setup.name != name])
        changed = other.parameters.apply(described, other.values)
        alone = [r for r in recordings if r.setup.name == name]
        judged = comparison(changed, judge(changed, _where(alone, other)), source)
        left_out[name] = judged.error
    found = estimates(fitted)
    result = Fitting(
        source, final, fitted, found, combinations(fitted), held, error, expected,
        _campaign_modes(campaign, _where(recordings, fitted), final, held, band_hz, progress), [],
        list(in_turn), left_out, comparisons,
    )  # fmt: skip
    result.damping = transfer(misses_of_frf(result.robot, Posterior.of(fitted), _where(rest, fitted)))
    if profiled:
        weakest = _weakest(found)
        tick = progress("profiles", len(weakest))
        for k in weakest:
            tick(1)
            result.profiles[fitted.parameters.names[k]] = profile(described, train, fitted, found[k])
    result.warnings = [*_warnings(result), *_freed_nodes(fitted), *_data_warnings(campaign, recordings)]
    return result


def _where(some: Sequence[Recorded], fit: Fit) -> tuple[Recorded, ...]:
    """Recordings with their nodes where a fit has them."""
    return placed(some, fit.parameters, fit.values)


def _campaign_modes(
    campaign: Campaign,
    recordings: Sequence[Recorded],
    robot: Robot,
    held: Sequence[str],
    band_hz: tuple[float, float] | None,
    progress: Progress,
) -> dict[str, dict[str, Any]]:
    """The model's modes in the measured band beside identified ones, paired by MAC."""
    found: dict[str, dict[str, Any]] = {}
    tick = progress("modes", len(recordings))
    for r in recordings:
        tick(1)
        if r.setup.name in found:
            continue
        posture = campaign.postures[r.group]
        predicted = _modes_at(robot, r)
        inside = np.flatnonzero(
            (predicted.frequency_hz >= r.frequency[0]) & (predicted.frequency_hz <= r.frequency[-1])
        )
        entries = [_mode(predicted, int(k)) for k in inside]
        record: dict[str, Any] = {
            "q_deg": [float(v) for v in posture.q_deg], "role": "held out" if r.setup.name in held else "fitted",
            "modes": entries, "measured_only": [],
        }  # fmt: skip
        try:
            measured = identify_modes(posture, *(band_hz or (None, None)))
        except InputError:  # a band too short for a stabilisation chart; the fit does not need one
            measured = None
        if measured is not None and measured.modes and len(inside):
            channels = r.setup.response if measured.roving == "response" else r.setup.excitation
            shape = predicted.linear_rows(channels)[:, inside].T
            likeness = mac(measured.shapes, shape)
            frequency = np.array([mode.frequency_hz for mode in measured.modes])
            away = np.abs(np.log(frequency[:, None] / predicted.frequency_hz[inside]))
            record["mac"] = likeness.tolist()
            record["measured_hz"] = frequency.tolist()
            for row, column in _pairs(1 - likeness + away, 0.75):
                mode = measured.modes[row]
                entries[column] |= {
                    "measured_hz": mode.frequency_hz, "measured_damping_percent": mode.damping_percent,
                    "mac": float(likeness[row, column]),
                    "measured_damping_std_percent": mode.damping_std_percent,
                }  # fmt: skip
            paired = {entry["measured_hz"] for entry in entries if "measured_hz" in entry}
            record["measured_only"] = [float(f) for f in frequency if f not in paired]
        found[r.setup.name] = record
    return found


@dataclass(frozen=True)
class _PostureModes:
    """Modes of a posture and the way to see them at a recording's channels."""

    modes: Modes
    structure: Structure

    @property
    def frequency_hz(self) -> FloatArray:
        return self.modes.frequency_hz

    def linear_rows(self, channels: Channels) -> ComplexArray:
        return np.asarray(self.structure.rows(channels, channels.direction) @ self.modes.shape)


def _modes_at(robot: Robot, r: Recorded) -> _PostureModes:
    mechanism = assemble(without_limits(robot), r.setup.q, brakes=r.setup.brakes or "off")
    return _PostureModes(modes(linearise(mechanism)), structure(mechanism))


def _mode(predicted: _PostureModes, k: int) -> dict[str, Any]:
    m = predicted.modes
    return {
        "frequency_hz": float(m.frequency_hz[k]),
        "damping_percent": float(m.damping_percent[k]),
        "dominant": [{"site": site, "share": share} for site, share in m.dominant(k)],
    }


def _pairs(cost: FloatArray, worst: float) -> list[tuple[int, int]]:
    rows, columns = linear_sum_assignment(cost)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < worst]


# --- modal tables -----------------------------------------------------------------------------------------------------


def fit_table(
    table: ModalTable,
    source: str,
    described: Robot,
    *,
    hold_out: list[str] | None,
    leave_one_out: bool,
    objective: ModalObjective,
    tolerances: bool,
    starts: int,
    seed: int,
) -> Fitting:
    """Fit a description to a modal table; options as of :func:`twin.fit`."""
    require_springs(described)
    measured = modal_postures(table, described, source)
    held = _held_out(source, hold_out, list(measured), {name: name for name in measured})
    free = _modal_parameters(described, tolerances)

    def run(used: list[str]) -> tuple[Fit, Robot]:
        found = fit_modes(described, [measured[n] for n in used], free, objective=objective, starts=starts, seed=seed)
        return found, _checked(found.parameters.apply(described, found.values))

    train = [name for name in measured if name not in held]
    fitted, final = run(train)
    paired = predict_modes(final, measured)
    error: dict[str, float | None] = {"train": frequency_error([m for m in paired if m.posture in train])}
    error["held_out"] = frequency_error([m for m in paired if m.posture in held]) if held else None
    left_out, misses = {}, []
    for name in measured if len(measured) > 1 else []:
        other, changed = run([other for other in measured if other != name])
        if leave_one_out:
            left_out[name] = frequency_error(predict_modes(changed, {name: measured[name]}))
        misses += misses_left_out(other, changed, measured[name])
    result = Fitting(
        source, final, fitted, estimates(fitted), combinations(fitted), held, error, {"held_out": None},
        {name: _paired(described, posture, [m for m in paired if m.posture == name], name in held)
         for name, posture in measured.items()},
        [], left_out=left_out,
    )  # fmt: skip
    result.damping = transfer(misses)
    result.warnings = _warnings(result)
    return result


def misses_left_out(fitted: Fit, robot: Robot, posture: ModalPosture) -> list[Miss]:
    """Damping of the measured modes of a posture, beside what a fit to the others predicts."""
    paired = predict_modes(robot, {posture.setup.name: posture})
    rows = [k for k, m in enumerate(paired) if m.damping and m.measured_damping > 0]
    frequency = np.array([float(paired[k].frequency_hz or 0) for k in rows])
    spread = damping_doubt(Posterior.of(fitted), without_limits(robot), posture.setup.q, "off", frequency)
    return [
        Miss(posture.setup.name, paired[k].measured_hz, paired[k].measured_damping, float(paired[k].damping or 0),
             float(posture.damping_spread[k]), float(own))
        for k, own in zip(rows, spread, strict=True)
    ]  # fmt: skip


def _modal_parameters(robot: Robot, tolerances: bool) -> Parameters:
    return free_parameters(robot).only("spring", "entry", *(("link",) if tolerances else ()))


def _paired(robot: Robot, posture: ModalPosture, found: Sequence[PairedMode], held: bool) -> dict[str, Any]:
    return {
        "q_deg": robot.degrees(posture.setup.q),
        "role": "held out" if held else "fitted",
        "modes": [
            {
                "frequency_hz": m.frequency_hz, "damping_percent": 100 * (m.damping or 0.0),
                "measured_hz": float(m.measured_hz),
                "measured_damping_percent": None if np.isnan(m.measured_damping) else 100 * float(m.measured_damping),
                "mac": m.mac, "dominant": [{"site": site, "share": share} for site, share in m.dominant],
            }
            for m in found if m.frequency_hz is not None
        ],
        "measured_only": [float(m.measured_hz) for m in found if m.frequency_hz is None],
    }  # fmt: skip


def _held_out(source: str, asked: list[str] | None, names: list[str], aliases: dict[str, str]) -> list[str]:
    if asked is None:
        return names[-1:] if len(names) >= 3 else []
    found = []
    for name in asked:
        if name not in names and name not in aliases:
            raise InputError("--hold-out", name, f"no such posture in {source}; it has {', '.join(names)}")
        found.append(aliases.get(name, name))
    if len(set(found)) == len(names):
        raise InputError("--hold-out", ", ".join(asked), "nothing is left to fit to")
    return list(dict.fromkeys(found))


def _checked(robot: Robot) -> Robot:
    """The fitted description, validated as any other; meshes and all."""
    return parse_robot(robot.model_dump(mode="json"), "the fitted robot")


def _weakest(found: Sequence[Estimate]) -> list[int]:
    """Springs and dampers the data hold least, most open first."""
    open_ = [
        (e.share, k) for k, e in enumerate(found) if e.parameter.kind in ("spring", "entry") and e.deviation > 0.05
    ]
    return [k for _, k in sorted(open_)[:PROFILED]]


def correlated(found: Fit) -> list[tuple[str, str, float]]:
    """Pairs of springs and dampers whose estimates move together."""
    matrix, names = correlation(found), found.parameters.names
    keep = [k for k, parameter in enumerate(found.parameters) if parameter.kind in ("spring", "entry")]
    pairs = [(names[i], names[j], float(matrix[i, j])) for n, i in enumerate(keep) for j in keep[n + 1 :]]
    return sorted((p for p in pairs if abs(p[2]) > LARGE_CORRELATION), key=lambda p: -abs(p[2]))


def _of_rigid_axes(robot: Robot) -> str:
    """What a fit cannot change and a reader may not know: axes without a stiffness."""
    rigid = [f"joint{k + 1}" for k, axis in enumerate(robot.axes) if axis.stiffness is None]
    return f", and whether the gear of {', '.join(rigid)} is as rigid as described" if rigid else ""


def _warnings(result: Fitting) -> list[str]:
    found, fitted = [], result.fit
    if fitted.misfit > LARGE_MISFIT:
        times = np.sqrt(fitted.misfit)
        means = "which widens the intervals" if fitted.misfit < ASTRAY else "so that no interval holds"
        found.append(
            f"the model misses the data by {times:.1f} times their noise, {means}; `twin diagnose` looks for what is "
            f"missing{_of_rigid_axes(result.robot)}"
        )
    if len(fitted.starts) > 1 and fitted.agreeing < 2:
        found.append("the starts do not agree, so the minimum may be a false one: try more starts (--starts)")
    if fitted.rival is not None and fitted.rival < CLOSE_RIVAL * fitted.scale:
        found.append(
            f"a second minimum fits almost as well (½χ² over the misfit is {fitted.rival / fitted.scale:.1f} larger): "
            "the data hardly tell the two apart; the intervals describe the first"
        )
    elif fitted.rival is not None:
        lost = len(fitted.starts) - fitted.agreeing
        found.append(f"{lost} of {len(fitted.starts)} starts ended in a worse minimum")
    if not fitted.converged:
        found.append("the fit stopped before it converged: its last step was still larger than the tolerance")
    saturated = np.isfinite(fitted.parameters.bound) & (np.abs(fitted.z) >= fitted.parameters.bound)
    stopped: list[tuple[bool, str]] = []  # a gain or a sensor's place is looked at first, and sooner mended
    for e, full in zip(result.estimates, saturated, strict=True):
        said = f"{e.parameter.name} = {e.value:.4g} {e.parameter.unit}".removesuffix(" 1")
        if full:
            stopped.append((e.parameter.kind == "link", said))
        elif abs(e.drift) > LARGE_DRIFT:
            found.append(
                f"{said} lies {abs(e.drift):.1f} prior deviations from {e.parameter.mean:.4g}: doubt it or its prior"
            )
    names = [said for _, said in sorted(stopped, key=lambda one: one[0])]
    if len(names) == 1:
        found.append(f"{names[0]} is saturated: it stops {SATURATED:g} deviations of its tolerance from its prior")
    elif names:
        more = f" and {len(names) - SATURATED_TOLD} more" if len(names) > SATURATED_TOLD else ""
        found.append(
            f"{len(names)} numbers are saturated: they stop {SATURATED:g} deviations of their tolerances from their "
            f"priors: {', '.join(names[:SATURATED_TOLD])}{more}"
        )
    for name, posture in result.postures.items():
        for frequency in posture["measured_only"]:
            found.append(f"{name}: no mode of the model pairs with the measured one at {frequency:.4g} Hz")
    return found


def _freed_nodes(fit: Fit) -> list[str]:
    """That nodes were freed, and which is farthest off."""
    points: dict[str, float] = {}
    for p, value in zip(fit.parameters, fit.values, strict=True):
        if p.kind == "point":
            node, side, _ = p.name.removeprefix("node:").split(".")
            name = f"{'sensor' if side == 'response' else 'blow'} {node}"
            points[name] = float(np.hypot(points.get(name, 0.0), value - p.mean))
    if not points:
        return []
    farthest = max(points, key=lambda name: points[name])
    return [
        "the FRFs show that sensors and blows are not quite where and along which the file says. Their positions and "
        f"directions are free within tolerance, and intervals include that: {farthest} is farthest, by "
        f"{1e3 * points[farthest]:.1f} mm"
    ]


def _data_warnings(campaign: Campaign, recordings: Sequence[Recorded]) -> list[str]:
    found, untested = [], []
    silent = [r.group for r in recordings if not r.stated]
    if silent:
        which = "the recording" if len(silent) == len(recordings) else ", ".join(silent)
        found.append(
            f"{which}: no coherence over two averages or more, hence no measured noise; intervals rest on the misfit"
        )
    for r in recordings:
        posture = campaign.postures[r.group]
        dead = int(dead_channels(posture).sum())
        if dead:
            found.append(f"{r.group}: {dead} channel pairs carry no signal and are not used")
        if posture.coherence is None:
            continue
        inside = (posture.frequency >= r.frequency[0]) & (posture.frequency <= r.frequency[-1])
        low = np.median(posture.coherence[inside], axis=(1, 2)) < LOW_COHERENCE
        for start, end in _runs(low):
            untested.append(f"{r.group} {r.frequency[start]:.3g}–{r.frequency[end]:.3g} Hz")
    if untested:
        found.append(f"no coherence, and hence no test of the model, in {', '.join(untested)}")
    return found


def _runs(mask: FloatArray) -> list[tuple[int, int]]:
    """First and last index of every run of three or more true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 3]
