"""ROS 1 and ROS 2 bags through rosbags, and what a JointState says: rad and N·m by the message's definition."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from twin.importing.tables import Channel, Table, library

JOINT_STATE = "JointState"
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}  # sensor_msgs/JointState, of revolute joints


def read(path: Path) -> list[Table]:
    """A table per topic of joint states: ``time``, ``position.JOINT``, ``velocity.JOINT``, ``effort.JOINT``."""
    reader, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    bag = path.parent if path.suffix == ".db3" else path
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    topics: dict[str, list[Any]] = {}
    with reader.AnyReader([bag], default_typestore=store) as messages:
        wanted = [c for c in messages.connections if c.msgtype.endswith(JOINT_STATE)]
        for connection, _, data in messages.messages(connections=wanted):
            topics.setdefault(connection.topic, []).append(messages.deserialize(data, connection.msgtype))
    return [joint_states(f"{path.stem}{topic.replace('/', '.')}", said) for topic, said in topics.items()]


def joint_states(name: str, messages: Iterable[Any]) -> Table:
    """Messages of one topic as a table; the clock is that of their headers, counted from the first."""
    said = list(messages)
    joints = list(said[0].name)
    order = [[list(message.name).index(joint) for joint in joints] for message in said]
    stamp = [(m.header.stamp.sec - said[0].header.stamp.sec, _nanoseconds(m.header.stamp)) for m in said]
    channels = {"time": Channel(np.array([sec + 1e-9 * ns for sec, ns in stamp]), "s")}
    for field, unit in UNITS.items():
        if all(len(getattr(message, field)) == len(joints) for message in said):
            rows = np.array([np.asarray(getattr(m, field))[at] for m, at in zip(said, order, strict=True)])
            channels |= {f"{field}.{joint}": Channel(rows[:, i], unit) for i, joint in enumerate(joints)}
    return Table(name, channels)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec)
