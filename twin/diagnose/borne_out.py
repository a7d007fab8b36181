"""The last word: a name stays only if the predictions of the recordings become better with it.

Evidence may grow by tension alone: a hypothesis can relieve numbers of the base model that are far from their
description, while what is predicted stays the same. Nobody could see such an answer in an overlay, and where the
description's tolerances are too narrow it is wrong. So the models before and after are compared once more, as they are
written, on what was used and on what was held out.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twin.diagnose.calibration import calibration
from twin.diagnose.note import Note
from twin.diagnose.records import FrfRecord, LogRecord, Record, frf_records
from twin.diagnose.refit import Fitted
from twin.diagnose.triage import Triage
from twin.diagnose.verdict import Finding, Missing, Verdict, Word
from twin.diagnose.within import allowed
from twin.physics import effect_named
from twin.robot.description import Robot


def gained(records: Sequence[Record]) -> float:
    """What ln likelihood hammer tests gain from before to after.

    With H_b and H_a the predictions, it is ½ Σ (|H − H_b|² − |H − H_a|²)/σ².
    The angles of a posture are recorded, too: ½ Σ (e_b² − e_a²), e by how much they are off over their tolerance.
    """
    gain = 0.0
    told: set[tuple[str, bool]] = set()  # force levels share their posture
    for record in records:
        if isinstance(record, FrfRecord):
            gain += 0.5 * float((record.energy("before") - record.energy("after")).sum()) / record.shared
            if record.angles and (record.posture, record.held_out) not in told:
                told.add((record.posture, record.held_out))
                before, after = record.angles["before"], record.angles["after"]
                gain += 0.5 * float(before @ before - after @ after)
    return gain


def falls(finding: Finding) -> bool:
    """Whether a recording is predicted better with what was found than without.

    The error on what was held out must fall, as it is printed, or on what was used where nothing was held out. A hammer
    test must gain ``seen`` in ln likelihood as well. What is found may leave no more than ``unexplained_share`` of its
    misfit beyond noise, unless the error left is that of an adequate model (``held_out_adequate``). A log's ½ χ² over
    the noise of each joint must fall by more than ``tie``, too, for a wrist's torque is mostly noise. Where its base
    model misses what was held out, what is found must take ``unexplained_share`` of that away.
    """
    before, after = (finding.error[stage] for stage in ("before", "after"))
    part = "train" if before["held_out"] is None else "held_out"
    if any(isinstance(record, FrfRecord) for record in finding.records):
        gain = gained(finding.records) if finding.gain is None else finding.gain
        return gain >= calibration()["seen"] and bool(after[part] < before[part]) and explains(finding)
    if finding.missing and all(effect_named(m.first.effect).part == "play" for m in finding.missing):
        return True  # the second encoder shows a gap, which the torque does not feel
    records = [r for r in finding.records if isinstance(r, LogRecord) and r.held_out is (part == "held_out")]
    fall = 0.5 * sum(r.energy("before") - r.energy("after") for r in records) if finding.gain is None else finding.gain
    if records and fall <= calibration()["tie"]:
        return False
    return bool(after[part] < before[part]) and not _slight(finding, before[part], after[part])


def _slight(finding: Finding, before: float, after: float) -> bool:
    """Whether a log that the base model misses is missed by nearly as much with what was found.

    What is wrong is something else then, and the names follow what little of it they can.
    """
    numbers, floor = calibration(), finding.error["noise_floor"]
    if floor is None or finding.held_out_misfit <= numbers["held_out_misfit"]:
        return False
    return bool(after**2 - floor**2 > (1 - numbers["unexplained_share"]) * (before**2 - floor**2))


def all_predict(best: Fitted, fits: Sequence[Fitted], base: Robot, found: Triage, processes: int = 1) -> bool:
    """Whether each of several effects makes the error on postures kept aside fall, beside the others.

    One that does not only relieves numbers far from their description, or follows what no effect explains.

    Args:
        best: with several effects; ``fits`` those without one of them among others.
        base: the description, its limits taken off.
        found: which postures are kept aside.
    """
    allowed_ones = allowed(best, base)
    answers = [piece for piece in best.hypothesis.pieces if piece not in allowed_ones]
    known = {fit.hypothesis.identity: fit for fit in fits}
    for piece in answers if len(answers) > 1 and found.kept else ():
        rest = None if piece.exact else known.get(best.hypothesis.identity - {piece.key})
        if rest is None:
            continue
        _, error = frf_records(base, rest, best, found.used, found.kept, found.shared, processes)
        if error["after"]["held_out"] >= error["before"]["held_out"]:
            return False
    return True


def explains(finding: Finding) -> bool:
    """Whether what was found leaves little of the misfit beyond noise, or an error as of an adequate model.

    Where a law hangs on its numbers so much that their doubt moves its predictions, that is no misfit either. It counts
    up to the share ``mostly`` of the misfit.
    """
    numbers, floor = calibration(), finding.error["noise_floor"]
    part = "train" if finding.error["before"]["held_out"] is None else "held_out"
    before, after = (finding.error[stage][part] for stage in ("before", "after"))
    if floor is not None and finding.unsure**2 <= numbers["mostly"] * before**2:
        floor = float(np.hypot(floor, finding.unsure))
    if floor is None or after**2 <= numbers["held_out_adequate"] * floor**2:
        return True
    return bool(after**2 - floor**2 <= numbers["unexplained_share"] * (before**2 - floor**2))


def rises(finding: Finding, alone: bool = True) -> bool:
    """Whether a recording is predicted clearly worse with what was found in all of them.

    One of several may lose some of what its own fit had: not so much that its model would no longer be adequate.
    """
    before, after = finding.alone or finding.error["before"], finding.error["after"]
    numbers = calibration()
    least = 0.0 if alone else numbers["held_out_adequate"] ** 0.5 * (finding.error.get("noise_floor") or 0.0)
    return any(
        before[part] is not None
        and after[part] is not None
        and after[part] > max(numbers["worse"] * before[part], least)
        for part in ("train", "held_out")
    )


def borne_out(verdict: Verdict) -> Verdict:
    """The verdict, without names that the recordings do not bear out.

    The names stay where one recording is predicted better with them and none clearly worse. Else the model that is
    written is the base model, and ``triage`` says what was refused and why.
    """
    if not verdict.missing:
        return verdict
    worse = [finding for finding in verdict.findings if rises(finding, len(verdict.findings) == 1)]
    if not worse and any(falls(finding) for finding in verdict.findings):
        return verdict
    names = ", ".join(missing.first.phrase for missing in verdict.missing)
    partly = [f for f in verdict.findings if any(isinstance(r, FrfRecord) for r in f.records) and not explains(f)]
    note = _partly(verdict.missing, partly[0]) if partly else tension(verdict.missing)
    if worse and len(verdict.findings) > 1:
        reason = (
            f"no single model fits all recordings. With their common answer ({names}) the error of "
            f"{', '.join(finding.recording for finding in worse)} rises. They may be of different robots, or of one "
            "robot in different states. Diagnose them one by one"
        )
        note = Note(reason, "other_robot")
    findings = [_without(finding) for finding in verdict.findings]
    findings[0].warnings = [*findings[0].warnings, note]
    words = [finding.word for finding in findings]
    apart = worse and len(findings) > 1  # no one model fits them all
    word: Word = "unexplained" if apart or "unexplained" in words else "adequate"
    none, other = (
        (0.0, 1.0) if word == "unexplained" else (min(f.none for f in findings), max(f.other for f in findings))
    )
    base = _base(verdict)
    return replace(verdict, findings=findings, word=word, missing=[], none=none, other=other, base=base, robot=base)


def tension(refused: Sequence[Missing]) -> Note:
    """Why names are not given with which no recording is predicted better."""
    names = ", ".join(missing.first.phrase for missing in refused)
    text = (
        f"some fitted numbers are far from the description. With {names} in the model they come closer, but the "
        "recordings are not predicted better. So it is not named; the description's tolerances may be too narrow"
    )
    return Note(text, "tension", sites=_sites(refused))


def _partly(refused: Sequence[Missing], finding: Finding) -> Note:
    """Why names are not given that leave much of the misfit."""
    names = ", ".join(missing.first.phrase for missing in refused)
    after, floor = finding.error["after"], finding.error["noise_floor"]
    left = after["train"] if after["held_out"] is None else after["held_out"]
    text = (
        f"with {names} in the model the recordings are still missed by {left:.2%}, {left / floor:.0f} times the noise. "
        "So it is not named: something else may be wrong, or fitted numbers are not known well enough"
    )
    return Note(text, "tension", sites=_sites(refused))


def _sites(refused: Sequence[Missing]) -> tuple[str, ...]:
    firsts = [missing.first for missing in refused]
    return tuple(f.site if f.effect == "parameter" else f.key for f in firsts)


def _base(verdict: Verdict) -> Robot:
    """The model that nothing was added to."""
    return verdict.findings[0].base if len(verdict.findings) == 1 else verdict.base


def _without(finding: Finding) -> Finding:
    """A finding with its names taken back: its answer is the base model."""
    if not finding.missing:
        return finding
    before = finding.error["before"]
    floor, error = finding.error["noise_floor"], before["train"]
    numbers = calibration()
    missed = floor is not None and error > numbers["held_out_misfit"] * floor
    if finding.held_out_misfit:  # a log's error counts what its model does not know exactly as missed
        missed = finding.held_out_misfit > numbers["held_out_adequate"]
    other = 1.0 if missed else finding.other if finding.other < 0.5 else numbers["least_other"]
    records: list[Any] = [*finding.records]
    records = [replace(r, predicted={**r.predicted, "after": r.predicted["before"]}) for r in records]
    return replace(
        finding, word="unexplained" if missed else "adequate", missing=[], none=1 - other, other=other,
        robot=finding.base, written=None, next_test=None, apart={}, error={**finding.error, "after": before},
        records=records, fits=finding.fits and (finding.fits[0], finding.fits[0]),
    )  # fmt: skip
