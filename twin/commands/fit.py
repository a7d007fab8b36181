"""``twin fit``: measured FRFs or a modal table in; joint stiffness and damping with honest intervals out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.commands.outputs import Outputs, check_out, check_spared
from twin.diagnose.frf_faults import sound
from twin.errors import InputError
from twin.identify.descent import ASTRAY
from twin.identify.elastic_modal import ModalObjective
from twin.identify.fitting import Fitting, correlated, fit_campaign, fit_table
from twin.identify.posterior import FILE, Posterior, save_posterior
from twin.identify.press import OF_RECORDINGS
from twin.identify.uncertainty import Estimate
from twin.measure.recordings import Given, read_one, traced
from twin.model.recorded import within_limits
from twin.parallel import Progress, one_thread_each, silent
from twin.provenance import provenance, write_json
from twin.ranges import check_band, check_count
from twin.result import Result, listed, no_model, written
from twin.robot.description import Robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf
from twin.table import Table


@dataclass
class FitResult(Fitting, Result):
    """What ``twin fit`` found; prints itself, and is the JSON of the command.

    Attributes:
        robot: the fitted description.
        estimates: every parameter with its interval.
        combinations: what the data determine together, and how well.
        held_out: postures that were not used.
        error: ``train`` and ``held_out``; ``None`` where nothing was held out.
        expected: the held-out error that noise and tolerances explain, and the noise floor alone.
        postures: per posture role, the model's modes and, where there are any, measured ones.
        left_out: posture → error when only that posture was not used.
        warnings: what to know before the numbers are used.
        files: what was written; ``model`` where the new model is.
    """

    files: list[str] = field(default_factory=list)
    model: dict[str, str | None] = field(default_factory=no_model)
    origin: dict[str, Any] = field(default_factory=dict)

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
            if e.parameter.kind in OF_RECORDINGS or e.parameter.kind == "sag":
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
            "held_out": self.held_out or self.in_turn,
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
        if fit.misfit > ASTRAY:
            lines.append(f"  do not use these numbers: {self.warnings[0]}")
        lines.append(f"  {'':18} {'stiffness':>11} {'90 % interval':>24}   {'damping':>11} {'90 % interval':>24}")
        for site in dict.fromkeys(_site(e) for e in self.estimates if e.parameter.kind in ("spring", "entry")):
            cells = {_quantity(e): e for e in self.estimates if _site(e) == site}
            row = "   ".join(_cell(cells.get(name)) for name in ("stiffness", "damping"))
            lines.append(f"  {site:18} {row}".rstrip())
            for name in cells:
                if name not in ("stiffness", "damping") and cells[name].parameter.kind == "entry":
                    lines.append(f"  {'':18} {name} {_cell(cells[name]).strip()}")
        lines.append("  ( ) not determined by the data: a bound, or mostly the prior")
        errors = "  ".join(
            f"{name.replace('_', ' ')} {value:.2%}" for name, value in self.error.items() if value is not None
        )
        floor = self.expected.get("held_out")
        lines.append(f"  error: {errors}" + (f"  (noise and tolerances explain {floor:.2%})" if floor else ""))
        turn = " in turn" if self.in_turn else ""
        lines.append(f"  held out{turn}: {listed(self.held_out or self.in_turn) or 'nothing'}")
        if self.left_out:
            left = "  ".join(f"{name} {value:.2%}" for name, value in self.left_out.items())
            lines.append(f"  each posture left out in turn: {left}")
        held = sum(e.identifiable for e in self.estimates)
        lines.append(f"  {fit.told} · {held} of {len(self.estimates)} numbers held by the data")
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


@one_thread_each()
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
        recording: a :class:`Campaign` or :class:`ModalTable`, or its file, or several hammer tests of the same points.
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
    given = read_one(recording, "frf-campaign", "modal-table", robot=robot)
    check_spared(out, [given])
    if band_hz is not None:
        check_band("--band", band_hz)
    check_count("starts", starts)
    described = given.described(robot, without)
    options = {
        "robot": robot, "without": without or [], "hold_out": hold_out, "leave_one_out": leave_one_out,
        "objective": objective, "band_hz": band_hz, "tolerances": tolerances, "starts": starts, "seed": seed,
    }  # fmt: skip
    if given.kind == "modal-table":
        fitting = fit_table(
            given.content, given.source, described, hold_out=hold_out, leave_one_out=leave_one_out,
            objective=objective, tolerances=tolerances, starts=starts, seed=seed,
        )  # fmt: skip
    else:
        if objective == "paper":
            raise InputError("--objective", "paper", "Eq. 23 needs modes: give a modal table (twin modal writes one)")
        fitting = fit_campaign(
            sound(given.content, described, given.source), given.source, described, hold_out=hold_out,
            leave_one_out=leave_one_out, band_hz=band_hz, tolerances=tolerances, starts=starts, seed=seed,
            progress=progress, profiled=out is not None,
        )  # fmt: skip
    found = FitResult(**vars(fitting))
    found.source = ", ".join(str(getattr(one, "source", one)) for one in given.inputs)
    found.origin = provenance(traced([given], robot), options)
    if out is not None:
        with Outputs(out, "fit") as outputs:
            found.files = outputs.files
            _write(found, outputs, progress)
    return found


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
