"""Whether the hardest blow of a hammer test moves a robot farther than small motion, which linear models predict."""

from collections.abc import Sequence
from dataclasses import replace

from twin.diagnose.note import Note
from twin.measure.blows import blows
from twin.measure.campaign import Campaign
from twin.model.expansion import with_channels
from twin.model.hammer import HammerTest, usual_duration
from twin.model.linear import linearise
from twin.model.recorded import Recorded
from twin.model.simulated_test import LARGE, beyond_linear, suited_force
from twin.robot.description import Robot
from twin.robot.mechanism import assemble


def moved_far(robot: Robot, campaign: Campaign, recordings: Sequence[Recorded]) -> list[Note]:
    """A note where the hardest blow moves the robot so far that its FRFs are not those of small motion."""
    blow = blows(campaign) or {}
    if not blow:
        return []
    hardest = max(recordings, key=lambda r: blow[r.group].peak_n)
    name, hit, setup = hardest.group, blow[hardest.group], hardest.setup
    struck = with_channels(robot, campaign.excitation, campaign.response)
    mechanism = assemble(struck, setup.q, brakes=setup.brakes or "off")
    linear, test = linearise(mechanism), HammerTest(pulse_s=hit.pulse_s, duration_s=hit.length_s)
    test = replace(test, duration_s=usual_duration(linear, test))
    if (off := beyond_linear(mechanism, linear, test, hit.peak_n)) <= LARGE:
        return []
    text = (
        f"{name}: {hit.peak_n:.0f} N move this robot so far that its FRFs differ by {off:.1%} from those of small "
        f"motion, which every model here predicts. Hit it with {suited_force(hit.peak_n, off):g} N"
    )
    return [Note(text, "linearity")]
