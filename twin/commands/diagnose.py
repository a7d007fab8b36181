"""``twin diagnose``: recordings in; what the model leaves out, how sure, and a new model out."""

from collections.abc import Sequence
from pathlib import Path

from twin.commands.modal import read_recording
from twin.commands.simulate import Progress
from twin.diagnose.decide import decide
from twin.diagnose.hypotheses import suspects
from twin.diagnose.locate import mismatch
from twin.diagnose.next_test import next_test, smallest_visible
from twin.diagnose.objective import Sample
from twin.diagnose.refit import noise_floor, recorded_error
from twin.diagnose.search import REFIT_LINES, SCREEN_LINES, converge, explain, settle
from twin.diagnose.triage import triage
from twin.diagnose.verdict import Verdict, judge
from twin.errors import InputError
from twin.identify.elastic import without_limits
from twin.identify.parameters import free_parameters
from twin.measure.campaign import Campaign
from twin.provenance import provenance, write_json
from twin.robot.description import Axis, Robot, load_robot, save_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec, save_mjcf


def diagnose(
    recordings: Sequence[str | Path],
    *,
    robot: str | None = None,
    without: list[str] | None = None,
    hold_out: list[str] | None = None,
    out: Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Verdict:
    """Diagnose hammer tests.

    Args:
        recordings: a campaign, or universal files that belong together.
        robot: shipped name, ``robot.yaml`` or URDF; wins over the recording's.
        without: entries to remove, ``EFFECT`` or ``EFFECT@SITE``.
        hold_out: postures not used, by name; by default those the others cover best.
        out: folder for the new model and diagnosis.json; ``None`` writes nothing.
        seed: of the starts.
        progress: makes progress bars.

    Raises:
        InputError: bad input; nothing is written.
    """
    source = Path(recordings[0])
    campaign = read_recording(recordings)
    named = load_robot(robot) if robot else load_robot(campaign.robot or "kr90", relative_to=source.parent)
    given = named.without(without or [])
    if not free_parameters(given, tolerances=False).items:
        raise InputError(given.name, "axes", "expected at least one axis with a stiffness: nothing can vibrate")
    verdict = diagnose_campaign(campaign, given, str(source), hold_out=hold_out, seed=seed, progress=progress)
    verdict.origin = provenance(
        recordings, {"robot": robot, "without": without or [], "hold_out": hold_out, "seed": seed}
    )
    if out is not None:
        _write(verdict, campaign, given, out)
    return verdict


def diagnose_campaign(
    campaign: Campaign,
    given: Robot,
    source: str = "recording",
    *,
    hold_out: list[str] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Verdict:
    """The same on a campaign in memory."""
    found = triage(campaign, given, source, hold_out)
    base = without_limits(given)
    sample, kept = Sample(tuple(found.used)), found.kept
    free = free_parameters(base, dict.fromkeys(r.setup.name for r in found.used), campaign.response.label)
    free = free.select(k for k, p in enumerate(free) if p.kind != "sag")
    search = converge(base, free, sample, seed=seed)
    band = float(found.used[0].frequency[0]), float(found.used[0].frequency[-1])
    brakes = [r.setup.brakes for r in found.recordings.values()]
    looked_at = suspects(base, campaign.response, campaign.excitation, brakes, band)
    explain(base, search, sample, looked_at, progress)
    *fits, settled = settle(base, search, sample)
    decision = decide(fits, settled, looked_at)
    kind = judge(decision)
    best = decision.ranked[0] if kind in ("named", "ambiguous") else settled

    def error(robot: Robot, train: float) -> dict[str, float | None]:
        return {"train": train, "held_out": recorded_error(robot, kept) if kept else None}

    floor = noise_floor(sample.recordings)
    verdict = Verdict(
        kind, best.robot.model_copy(update={"axes": _limits(best.robot, given)}), decision, settled,
        {
            "as_given": error(base, recorded_error(base, sample.recordings)),
            "before": error(settled.robot, floor * settled.misfit**0.5),
            "after": error(best.robot, floor * best.misfit**0.5), "noise_floor": floor,
        },
        list(found.held_out), checks=found.warnings,
    )  # fmt: skip
    where = mismatch(settled, sample.thin(REFIT_LINES))
    site = best.hypothesis.site or next(iter(where.sites), "")
    verdict.location = [{"recording": source, "site": site, **spot} for spot in where.spots()]
    few = sample.thin(SCREEN_LINES)
    verdict.smallest_visible = smallest_visible(base, settled, few, looked_at)
    if decision.rivals and kind == "ambiguous":
        verdict.next_test = next_test(base, decision.ranked[0], decision.ranked[decision.rivals[0]], few, seed)
    return verdict


def _limits(robot: Robot, given: Robot) -> list[Axis]:
    """The axes of a fitted robot with the limits the fit took away."""
    return [axis.model_copy(update={"limits": old.limits}) for axis, old in zip(robot.axes, given.axes, strict=True)]


def _write(verdict: Verdict, campaign: Campaign, given: Robot, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    save_robot(out / "robot.yaml", verdict.robot)
    posture = next(iter(campaign.postures.values()))
    mechanism = assemble(verdict.robot, given.angles(posture.q_deg), brakes=posture.brakes or "off")
    save_mjcf(out / "robot.xml", build_spec(mechanism))
    verdict.model = {"robot": str(out / "robot.yaml"), "mjcf": str(out / "robot.xml")}
    write_json(out / "diagnosis.json", verdict.data())
