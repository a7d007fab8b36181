"""MCAP through mcap and mcap-ros2-support: joint states of ROS 2."""

from pathlib import Path
from typing import Any

from twin.importing.ros_bag import JOINT_STATE, joint_states
from twin.importing.tables import Table, library


def read(path: Path) -> list[Table]:
    """A table per topic of joint states, with the channels of a bag."""
    reader, decoder = library("mcap.reader"), library("mcap_ros2.decoder")
    topics: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        messages = reader.make_reader(stream, validate_crcs=True, decoder_factories=[decoder.DecoderFactory()])
        wanted = [
            channel.topic
            for channel in messages.get_summary().channels.values()
            if messages.get_summary().schemas[channel.schema_id].name.endswith(JOINT_STATE)
        ]
        if wanted:
            for _, channel, _, message in messages.iter_decoded_messages(topics=wanted):
                topics.setdefault(channel.topic, []).append(message)
    return [joint_states(f"{path.stem}{topic.replace('/', '.')}", said) for topic, said in topics.items()]
