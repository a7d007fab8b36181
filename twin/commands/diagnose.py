"""``twin diagnose``: recordings in; what the model leaves out, how sure, and a new model out."""

import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.commands.outputs import Outputs, check_out, check_spared
from twin.diagnose.edit import check_xml, payload_edit
from twin.diagnose.engine import diagnosed
from twin.diagnose.evidence import Evidence
from twin.diagnose.records import FrfRecord, LogRecord
from twin.diagnose.verdict import Verdict
from twin.errors import Told
from twin.identify.posterior import FILE, Posterior, save_posterior
from twin.measure.recordings import Given, read_recordings, robot_of_all, traced
from twin.memory import uncollected
from twin.model.linear import linearise
from twin.model.modes import modes
from twin.model.recorded import without_limits
from twin.parallel import Progress, one_thread_each, silent
from twin.provenance import provenance, write_json
from twin.robot.description import Robot, load_robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, lit, save_mjcf


@one_thread_each()
def diagnose(
    recordings: Given,
    *,
    robot: Robot | str | Path | None = None,
    without: list[str] | None = None,
    hold_out: list[str] | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    minutes: float | None = None,
    progress: Progress | None = None,
) -> Verdict:
    """Diagnose recordings of one robot.

    Args:
        recordings: one or several of :class:`Campaign`, :class:`MotionLog`, :class:`ModalTable` or their files;
            universal files belong together.
        robot: a :class:`Robot`, shipped name, ``robot.yaml`` or URDF; wins over the recordings'.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        hold_out: postures or runs not fitted to, by name; by default those the others cover best.
        out: folder for the new model, report, figures and diagnosis.json; ``None`` writes nothing.
        seed: of the starts.
        minutes: after which the search of a hammer test or modal table starts no further round, and that of a motion
            log tries no wider filter band; 3 by default, more where the recording is large.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    check_out(out)
    progress = progress or silent
    tests = read_recordings(recordings)
    check_spared(out, tests)
    given = robot_of_all(tests, robot).without(without or [])
    verdict, evidence = diagnosed(tests, given, hold_out=hold_out, seed=seed, minutes=minutes, progress=progress)
    options = {"robot": robot, "without": without or [], "hold_out": hold_out, "seed": seed, "minutes": minutes}
    verdict.origin = provenance(traced(tests, robot), options)
    _finish(verdict, evidence, out)
    return verdict


# --- what is written --------------------------------------------------------------------------------------------------


def _finish(verdict: Verdict, evidence: Sequence[Evidence], out: str | Path | None) -> None:
    """Write the model, check it as written, and write what people look at; all of it or nothing."""
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            _check(verdict, evidence, _write_model(verdict, Path(folder)))
        return
    with Outputs(out, "diagnose") as name:
        _write_model(verdict, name("robot.yaml").parent)
        name("robot.xml")
        if verdict.findings[-1].fits:
            name(FILE)
        _check(verdict, evidence, name.stage)
        verdict.model = {"robot": "robot.yaml", "mjcf": "robot.xml"}
        with uncollected():
            _write_report(verdict, name)
        page = name("diagnosis.json")
        verdict.files = list(name.files)
        write_json(page, verdict.data())


def _write_model(verdict: Verdict, folder: Path) -> Path:
    save_robot(folder / "robot.yaml", verdict.robot)
    finding = verdict.findings[-1]
    if finding.fits:
        known = Posterior.of(finding.fits[-1])
        save_posterior(folder / FILE, finding.damping.known_in(known) if finding.damping else known)
    q, brakes = _posture(verdict)
    save_mjcf(folder / "robot.xml", lit(build_spec(assemble(without_limits(verdict.robot), q, brakes=brakes))))
    return folder


def _posture(verdict: Verdict) -> tuple[np.ndarray, Any]:
    """Where robot.xml stands: the first posture of the recordings."""
    for finding in verdict.findings:
        for record in finding.records:
            if isinstance(record, FrfRecord):
                return record.q, record.brakes or "off"
            if isinstance(record, LogRecord):
                return record.position[0], "off"
            return record.q, "on"
    return np.zeros(verdict.robot.axis_count), "off"


def _check(verdict: Verdict, evidence: Sequence[Evidence], folder: Path) -> None:
    """The edit test: the written model, read again, in MuJoCo."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Told)  # of a file that has no place of its own yet
        written = load_robot(folder / "robot.yaml")
    alone = len({one.recording.kind for one in evidence}) == 1
    for finding, one in zip(verdict.findings, evidence, strict=True):
        verdict.checks += one.checks(written, finding, alone)
    if frfs := [r for finding in verdict.findings for r in finding.records if isinstance(r, FrfRecord)]:
        verdict.payload_edit = payload_edit(verdict.base, verdict.robot, frfs)
    verdict.checks.append(check_xml(folder / "robot.xml", written, *_posture(verdict)))


def _write_report(verdict: Verdict, name: Outputs) -> None:
    """Figures, the page and the modes before and after."""
    from twin.report.scene import write_modes

    q, brakes = _posture(verdict)

    def animate() -> None:
        for stage, shown in (("before", verdict.base), ("after", verdict.robot)):
            mechanism = assemble(without_limits(shown), q, brakes=brakes)
            found = modes(linearise(mechanism))
            if len(found):
                write_modes(name(f"modes-{stage}.rrd"), mechanism, found)

    name.report(verdict, "diagnosis.html", meanwhile=animate)  # in this process: Rerun does not outlive a fork
