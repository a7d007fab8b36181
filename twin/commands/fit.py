"""``twin fit``: measured FRFs or a modal table in; joint stiffness and damping with honest intervals out."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError
from twin.identify.damping_transfer import Miss, Transfer, foretold, misses_of_frf, transfer
from twin.identify.elastic import Fit, fit_frf
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
from twin.identify.posterior import FILE, Posterior, save_posterior
from twin.identify.recorded import Recorded, base_name, noise_stated, prepare, within_limits, without_limits
from twin.identify.uncertainty import (
    LARGE_DRIFT,
    Combination,
    Estimate,
    combinations,
    correlation,
    estimates,
    profile,
)
from twin.measure.campaign import VARIANCE_FLOOR_QUANTILE, Campaign, FloatArray, dead_channels
from twin.measure.modal import identify_modes
from twin.measure.modal_table import ModalTable
from twin.measure.recordings import Given, Recording, read_one, traced
from twin.measure.shapes import mac
from twin.model.linear import linearise
from twin.model.modes import Modes, modes
from twin.model.parameters import SATURATED, Parameters, free_parameters
from twin.parallel import Progress, silent
from twin.provenance import provenance, write_json
from twin.ranges import check_band, check_count
from twin.result import Result, Table, written
from twin.robot.description import Robot, parse_robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf

LOW_COHERENCE = 0.6  # of the channels' median, below which a band is named
LARGE_MISFIT = 2.0  # χ² per datum
CLOSE_RIVAL = 3.0  # cost above the best of another minimum that is still to be reckoned with
LARGE_CORRELATION = 0.95
PROFILED = 4  # parameters whose profile is drawn


@dataclass
class FitResult(Result):
    """What ``twin fit`` found; prints itself, and is the JSON of the command.

    Attributes:
        source: the recording or modal table.
        robot: the fitted description.
        fit: the optimum; ``estimates`` every parameter with interval.
        error: ``train`` and ``held_out`` as the contract defines them; ``None`` where nothing was held out.
        expected: the held-out error that noise and tolerances explain, and the noise floor alone.
        postures: per posture role, model's modes and, where there are any, measured ones.
        left_out: posture → error when only that posture was not used.
        damping: how well damping is foretold in postures that were not fitted to.
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
    left_out: dict[str, float] = field(default_factory=dict)
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    profiles: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    model: dict[str, str | None] = field(default_factory=lambda: {"robot": None, "mjcf": None})
    origin: dict[str, Any] = field(default_factory=dict)
    damping: Transfer = field(default_factory=lambda: transfer([]))

    drawn_by = "twin.report.fit_report"

    def data(self) -> dict[str, Any]:
        """The JSON of the command."""
        parameters: dict[str, dict[str, Any]] = {}
        links: dict[str, dict[str, Any]] = {}
        recording: dict[str, Any] = {}
        for e in self.estimates:
            entry = {
                "value": e.value, "unit": e.parameter.unit, "interval90": list(e.interval90),
                "identifiable": e.identifiable, "data_share": e.share, "drift": e.drift,
                "prior": {"value": e.parameter.mean, "deviation": e.parameter.deviation, "log": e.parameter.log},
            }  # fmt: skip
            if e.parameter.kind in ("posture", "sag", "gain"):
                recording[e.parameter.name] = entry
            elif e.parameter.kind == "link":
                links.setdefault(_site(e), {})[_quantity(e)] = entry
            else:
                parameters.setdefault(_site(e), {})[_quantity(e)] = entry
        return {
            "robot": self.robot.name,
            "source": self.source,
            "parameters": parameters,
            "links": links,
            "recording": recording,
            "held_out": self.held_out,
            "error": self.error,
            "expected": self.expected,
            "leave_one_out": self.left_out,
            "damping_transfer": self.damping.data(),
            "misfit": self.fit.misfit,
            "starts": {"agreeing": self.fit.agreeing, "of": len(self.fit.starts), "rival": self.fit.rival},
            "converged": self.fit.converged,
            "combinations": [
                {"data_share": c.share, "weights": {k: w for k, w in c.weights.items() if abs(w) > 0.2}}
                for c in self.combinations
            ],
            "correlated": [{"pair": list(pair), "correlation": value} for *pair, value in correlated(self.fit)],
            "postures": self.postures,
            "parts": {role: list(found.parts) for role, found in self.comparisons.items()},
            "warnings": self.warnings,
            "model": self.model,
            "files": self.files,
            "provenance": self.origin,
        }

    def tables(self) -> list[Table]:
        """Springs and dampers with their intervals, pale where the data do not hold them, and the errors."""
        shown = [e for e in self.estimates if e.parameter.kind in ("spring", "entry")]
        rows = [
            (e.parameter.name, f"{e.value:.4g}", "{:.4g} … {:.4g}".format(*e.interval90), e.parameter.unit)
            for e in shown
        ]
        errors = [(k.replace("_", " "), f"{v:.2%}") for k, v in self.error.items() if v is not None]
        return [
            Table(
                ("parameter", "value", "90 % interval", "unit"), rows, (1, 2),
                [k for k, e in enumerate(shown) if not e.identifiable],
            ),
            Table(("error", ""), errors, (1,)),
        ]  # fmt: skip

    def __str__(self) -> str:
        fit = self.fit
        lines = [f"{self.robot.name} fitted to {self.source}"]
        lines.append(f"  {'':18} {'stiffness':>11} {'90 % interval':>24}   {'damping':>11} {'90 % interval':>24}")
        for site in dict.fromkeys(_site(e) for e in self.estimates if e.parameter.kind in ("spring", "entry")):
            cells = {_quantity(e): e for e in self.estimates if _site(e) == site}
            row = "   ".join(_cell(cells.get(name)) for name in ("stiffness", "damping"))
            lines.append(f"  {site:18} {row}".rstrip())
            for name in cells:
                if name not in ("stiffness", "damping") and cells[name].parameter.kind == "entry":
                    lines.append(f"  {'':18} {name} {_cell(cells[name]).strip()}")
        lines.append("  ( ) the data do not hold it: a bound, or mostly the prior")
        errors = "  ".join(
            f"{name.replace('_', ' ')} {value:.2%}" for name, value in self.error.items() if value is not None
        )
        floor = self.expected.get("held_out")
        lines.append(f"  error: {errors}" + (f"  (noise and tolerances explain {floor:.2%})" if floor else ""))
        lines.append(f"  held out: {', '.join(self.held_out) or 'nothing'}")
        if self.left_out:
            left = "  ".join(f"{name} {value:.2%}" for name, value in self.left_out.items())
            lines.append(f"  each posture left out in turn: {left}")
        lines.append(
            f"  {fit.agreeing} of {len(fit.starts)} starts agree · χ² per datum {fit.misfit:.2f} · "
            f"{sum(e.identifiable for e in self.estimates)} of {len(self.estimates)} numbers held by the data"
        )
        for name, posture in self.postures.items():
            for mode in posture["modes"]:
                measured = mode.get("measured_hz")
                damping = mode.get("measured_damping_percent")
                beside = f"   measured {measured:7.2f} Hz" if measured else ""
                beside += f" {damping:6.2f} %" if damping is not None else ""
                alike = f"   MAC {mode['mac']:.0%}" if mode.get("mac") is not None else ""
                lines.append(
                    f"  {name:12} {mode['frequency_hz']:7.2f} Hz {mode['damping_percent']:6.2f} %{beside}{alike}"
                )
        lines.append(f"  {self.damping}")
        lines += [f"  warning: {text}" for text in self.warnings]
        if self.files:
            lines.append(f"  {written(self.files)}")
        return "\n".join(lines)


def fit(
    recording: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    hold_out: list[str] | None = None,
    leave_one_out: bool = False,
    objective: ModalObjective = "posterior",
    band_hz: tuple[float, float] | None = None,
    tolerances: bool = True,
    starts: int = 4,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a robot to a hammer test or a modal table.

    Args:
        recording: a :class:`Campaign` or :class:`ModalTable`, or its file, or universal files that belong together.
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the recording's.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        hold_out: postures not used, by name; by default the last of three or more, an empty list for none.
        leave_one_out: also fit with every posture left out in turn.
        objective: on modal tables, ``posterior`` or the source paper's Eq. 23, ``paper``.
        band_hz: lines used, lowest and highest.
        tolerances: masses, centres of mass, inertias, angles and gains free within the description's tolerances.
        starts: how many.
        out: folder for what is written; ``None`` writes nothing.
        seed: of the starts.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    progress = progress or silent
    given = read_one(recording, "frf-campaign", "modal-table")
    if band_hz is not None:
        check_band("--band", band_hz)
    check_count("starts", starts)
    described = given.described(robot, without)
    _require_springs(described)
    options = {
        "robot": robot, "without": without or [], "hold_out": hold_out, "leave_one_out": leave_one_out,
        "objective": objective, "band_hz": band_hz, "tolerances": tolerances, "starts": starts, "seed": seed,
    }  # fmt: skip
    if given.kind == "modal-table":
        found = _fit_table(given, described, hold_out, leave_one_out, objective, tolerances, starts, seed)
    else:
        if objective == "paper":
            raise InputError("--objective", "paper", "Eq. 23 needs modes: give a modal table (twin modal writes one)")
        found = _fit_campaign(
            given, described, hold_out, leave_one_out, band_hz, tolerances, starts, seed, progress, out is not None
        )
    found.origin = provenance(traced([given], robot), options)
    if out is not None:
        with Outputs(out, "fit") as outputs:
            found.files = outputs.files
            _write(found, outputs, progress)
    return found


# --- FRFs -------------------------------------------------------------------------------------------------------------


def _fit_campaign(
    given: Recording,
    described: Robot,
    hold_out: list[str] | None,
    leave_one_out: bool,
    band_hz: tuple[float, float] | None,
    tolerances: bool,
    starts: int,
    seed: int,
    progress: Progress,
    profiled: bool,
) -> FitResult:
    campaign, source = given.content, given.source
    recordings = list(prepare(campaign, described, source, band_hz).values())
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
        return fit_frf(described, used, free, starts=starts, seed=seed, progress=tick)

    fitted = run(train)
    final = _checked(fitted.parameters.apply(described, fitted.values))
    comparisons = {"fitted": comparison(final, judge(final, train), source)}
    error: dict[str, float | None] = {"train": comparisons["fitted"].error, "held_out": None}
    expected: dict[str, float | None] = {"noise_floor": comparisons["fitted"].noise_floor, "held_out": None}
    if rest:
        comparisons["held out"] = comparison(final, judge(final, rest), source)
        error["held_out"] = comparisons["held out"].error
        expected["held_out"] = expected_error(final, fitted, rest) if noise_stated(recordings) else None
    left_out = {}
    for name in left:
        other = run([r for r in recordings if r.setup.name != name])
        changed = other.parameters.apply(described, other.values)
        judged = comparison(changed, judge(changed, [r for r in recordings if r.setup.name == name]), source)
        left_out[name] = judged.error
    found = estimates(fitted)
    result = FitResult(
        source, final, fitted, found, combinations(fitted), held, error, expected,
        _campaign_modes(campaign, recordings, final, held, band_hz, progress), [], left_out, comparisons,
    )  # fmt: skip
    unseen = [r for r in recordings if r.setup.name in result.held_out]
    result.damping = transfer(misses_of_frf(result.robot, Posterior.of(result.fit), unseen))
    if profiled:
        weakest = _weakest(found)
        tick = progress("profiles", len(weakest))
        for k in weakest:
            tick(1)
            result.profiles[fitted.parameters.names[k]] = profile(described, train, fitted, found[k])
    result.warnings = _warnings(result, _perfect_misfit(campaign)) + _data_warnings(campaign, recordings)
    return result


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
    structure: Any

    @property
    def frequency_hz(self) -> FloatArray:
        return self.modes.frequency_hz

    def linear_rows(self, channels: Any) -> Any:
        return self.structure.rows(channels, channels.direction) @ self.modes.shape


def _modes_at(robot: Robot, r: Recorded) -> _PostureModes:
    from twin.model.sensitivity import structure

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
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < worst]


# --- modal tables -----------------------------------------------------------------------------------------------------


def _fit_table(
    given: Recording,
    described: Robot,
    hold_out: list[str] | None,
    leave_one_out: bool,
    objective: ModalObjective,
    tolerances: bool,
    starts: int,
    seed: int,
) -> FitResult:
    table: ModalTable = given.content
    measured = modal_postures(table, described, given.source)
    held = _held_out(given.source, hold_out, list(measured), {name: name for name in measured})
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
    result = FitResult(
        given.source, final, fitted, estimates(fitted), combinations(fitted), held, error, {"held_out": None},
        {name: _paired(described, posture, [m for m in paired if m.posture == name], name in held)
         for name, posture in measured.items()},
        [], left_out,
    )  # fmt: skip
    result.damping = transfer(misses)
    result.warnings = _warnings(result)
    return result


def misses_left_out(fitted: Fit, robot: Robot, posture: ModalPosture) -> list[Miss]:
    """Damping of the measured modes of a posture, beside what a fit to the others foretells."""
    paired = predict_modes(robot, {posture.setup.name: posture})
    rows = [k for k, m in enumerate(paired) if m.damping and m.measured_damping > 0]
    frequency = np.array([float(paired[k].frequency_hz or 0) for k in rows])
    spread = foretold(Posterior.of(fitted), without_limits(robot), posture.setup.q, "off", frequency)
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


# --- shared -----------------------------------------------------------------------------------------------------------


def _require_springs(robot: Robot) -> None:
    if not free_parameters(robot, tolerances=False).items:
        raise InputError(
            robot.name, "axes", "expected at least one axis with a stiffness: a rigid robot has nothing to fit"
        )


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


def _site(e: Estimate) -> str:
    name = e.parameter.name
    if e.parameter.kind == "link":
        return name.partition(".")[0]
    return e.parameter.site.partition("@")[2] or e.parameter.site


def _quantity(e: Estimate) -> str:
    return e.parameter.name.partition(".")[2] if e.parameter.kind == "link" else e.parameter.quantity


def _cell(e: Estimate | None) -> str:
    if e is None:
        return f"{'':>11} {'':>24}"
    low, high = e.interval90
    value = f"{e.value:.4g}" if e.identifiable else f"({e.value:.3g})"
    bound = (
        f"{low:.4g} … {high:.4g}"
        if e.identifiable
        else f"< {high:.3g}"
        if low < high / 10
        else f"{low:.3g} … {high:.3g}"
    )
    return f"{value:>11} {bound:>24}"


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


def _warnings(result: FitResult, perfect_misfit: float = 1.0) -> list[str]:
    found, fitted = [], result.fit
    if len(fitted.starts) > 1 and fitted.agreeing < 2:
        found.append(f"no two of {len(fitted.starts)} starts agree: this may be a false minimum; try more starts")
    if fitted.rival is not None and fitted.rival < CLOSE_RIVAL * fitted.scale:
        found.append(
            f"a second minimum costs only {fitted.rival:.1f} more (in ½χ²): the data hardly tell the two apart; "
            "intervals are about the first"
        )
    elif fitted.rival is not None:
        lost = len(fitted.starts) - fitted.agreeing
        found.append(f"{lost} of {len(fitted.starts)} starts ended in a worse minimum")
    if not fitted.converged:
        found.append("the last step was still larger than the tolerance")
    if fitted.misfit > LARGE_MISFIT * perfect_misfit:
        found.append(
            f"the model misses the data by {np.sqrt(fitted.misfit):.1f} times their noise, which widens the intervals; "
            "twin diagnose looks for what is missing"
        )
    saturated = np.isfinite(fitted.parameters.bound) & (np.abs(fitted.z) >= fitted.parameters.bound)
    for e, full in zip(result.estimates, saturated, strict=True):
        said = f"{e.parameter.name} = {e.value:.4g} {e.parameter.unit}".removesuffix(" 1")
        if full:
            found.append(f"{said} is saturated: it stops {SATURATED:g} deviations of its tolerance from its prior")
        elif abs(e.drift) > LARGE_DRIFT:
            found.append(
                f"{said} lies {abs(e.drift):.1f} prior deviations from {e.parameter.mean:.4g}: doubt it or its prior"
            )
    for name, posture in result.postures.items():
        for frequency in posture["measured_only"]:
            found.append(f"{name}: no mode of the model pairs with the measured one at {frequency:.4g} Hz")
    return found


def _perfect_misfit(campaign: Campaign) -> float:
    """χ² per datum of a perfect model whose noise is estimated line by line, from the fewest averages there are.

    (n/χ²)-scatter of the estimate, floored as :func:`twin.measure.campaign.frf_variance` does; 1.8 for three hits.
    """
    averages = [p.averages for p in campaign.postures.values() if p.averages and p.averages > 1]
    if not averages:
        return 1.0
    n = min(averages)
    variance = gammaincinv(n - 1, (np.arange(1000) + 0.5) / 1000) / n  # chi-squared, 2 (n − 1) degrees of freedom
    return float(np.mean(1 / np.maximum(variance, np.quantile(variance, VARIANCE_FLOOR_QUANTILE))))


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


# --- what is written --------------------------------------------------------------------------------------------------


def _write(found: FitResult, name: Outputs, progress: Progress) -> None:
    save_robot(name("robot.yaml"), found.robot)
    save_posterior(name(FILE), found.damping.known_in(Posterior.of(found.fit)))
    first = next(iter(found.postures.values()))
    mechanism = assemble(found.robot, within_limits(found.robot, found.robot.angles(first["q_deg"])))
    save_mjcf(name("robot.xml"), lit(build_spec(mechanism)))
    found.model = {"robot": str(name.out / "robot.yaml"), "mjcf": str(name.out / "robot.xml")}
    name.report(found, progress=progress)
    write_json(name("fit.json"), found.data())
