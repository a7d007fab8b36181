"""A robot beside a hammer test as a diagnosis sees it: by its linear model, or its blows stepped in time."""

from twin.diagnose.frf_faults import sound
from twin.identify.elastic_compare import Comparison, comparison, judge
from twin.identify.struck import amplitude_entries, judge_struck
from twin.measure.blows import blows
from twin.measure.campaign import Campaign
from twin.model.recorded import believed
from twin.robot.description import Robot


def compare_hammer(robot: Robot, campaign: Campaign, source: str, as_is: bool = False) -> Comparison:
    """The error of a robot on a hammer test, none of its physics fitted.

    Channels without coherence are left out. Channels in another unit, reversed or exchanged are put right and told,
    unless ``as_is``. Blows are stepped in time where the robot has one law that depends on amplitude and the recording
    says how hard they were; otherwise the robot is linearised.

    Args:
        robot: description.
        campaign: as recorded.
        source: the file, for messages.
        as_is: leave posture angles and channels as they are stated.

    Raises:
        InputError: the campaign does not fit the robot.
    """
    campaign = campaign if as_is else sound(campaign, robot, source)
    recordings = list(believed(campaign, robot, source)[0].values())
    laws, how = amplitude_entries(robot), blows(campaign)
    struck = judge_struck(robot, recordings, how, as_is=as_is) if len(laws) == 1 and how else None
    return comparison(robot, struck or judge(robot, recordings, as_is=as_is), source)
