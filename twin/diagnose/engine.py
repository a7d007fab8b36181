"""The engine: recordings are a list of evidence about one set of numbers; each explains what those before left."""

from collections.abc import Sequence

from twin.diagnose.borne_out import borne_out
from twin.diagnose.evidence import Evidence
from twin.diagnose.joint import together
from twin.diagnose.patience import Patience, usual_minutes
from twin.diagnose.verdict import Finding, Verdict
from twin.errors import InputError
from twin.measure.recordings import Recording, one_test_each
from twin.parallel import Progress, cores
from twin.robot.description import Robot


def evidence_of(recording: Recording) -> Evidence:
    """A recording as its kind of evidence; what a kind needs is imported when there is one."""
    if recording.kind == "motion-log":
        from twin.diagnose.torque import Log  # and SciPy's signals, a third of what there is to import

        return Log(recording)
    if recording.kind == "frf-campaign":
        from twin.diagnose.hammer import HammerTest

        return HammerTest(recording)
    from twin.diagnose.modal_table import Table

    return Table(recording)


def diagnosed(
    recordings: Sequence[Recording],
    given: Robot,
    *,
    hold_out: list[str] | None = None,
    seed: int = 0,
    minutes: float | None = None,
    progress: Progress,
) -> tuple[Verdict, list[Evidence]]:
    """The verdict of recordings of one robot, and they as evidence, in the order of its findings.

    Args:
        recordings: motion logs come first: masses are known best from them.
        given: the description as it came, removals applied.
        hold_out: postures or runs not fitted to, by name; by default those the others cover best.
        seed: of the starts.
        minutes: that the search of each recording looks for more; by its size when ``None``.
        progress: makes progress bars.

    Raises:
        InputError: a name to hold out that no recording has, or a recording that does not fit the robot.
    """
    order = ("motion-log", "frf-campaign", "modal-table")
    some = [evidence_of(r) for r in sorted(one_test_each(recordings), key=lambda r: order.index(r.kind))]
    chosen = _shared_out(hold_out, some)
    findings: list[Finding] = []
    for one, held in zip(some, chosen, strict=True):
        told_by = findings[-1] if findings else None
        patience = Patience(usual_minutes(one.recording) if minutes is None else minutes)
        findings.append(
            one.explain(
                given, told_by, hold_out=held, seed=seed, progress=progress, processes=cores(), patience=patience
            )
        )
    return borne_out(_settled(findings, some, chosen)), some


def _settled(findings: list[Finding], some: Sequence[Evidence], chosen: Sequence[list[str] | None]) -> Verdict:
    """The verdict on the one model that the last finding ends with; the others are judged on it."""
    if len(findings) == 1:
        return Verdict.of(findings[0])
    last = findings[-1]
    told_by = next((finding for finding in reversed(findings[:-1]) if finding.following), None)
    robot = told_by.following(last.robot) if told_by and told_by.following else last.robot
    if last.following:  # it stands on what the others found, all numbers fitted
        robot = last.model
    for finding, one, held in zip(findings[:-1], some, chosen, strict=False):
        one.again(finding, robot, last, held)
    return together(findings, last.base, robot)


def _shared_out(hold_out: list[str] | None, some: Sequence[Evidence]) -> list[list[str] | None]:
    """Names to hold out, each to the recordings that have it; a recording that none belongs to chooses itself.

    Raises:
        InputError: a name that no recording has.
    """
    for name in hold_out or []:
        if not any(name in one.names for one in some):
            known = "; ".join(f"{one.recording.source} has {', '.join(one.names)}" for one in some)
            raise InputError("--hold-out", name, f"no such posture or run: {known}")
    return [[name for name in hold_out or [] if name in one.names] or None for one in some]
