"""The weight of sensors that go from node to node: what it does to FRFs is taken off them.

``sensor_mass`` has the inertia of such a sensor, which is nearly all of it. Its weight also bends the robot and turns
its joints, as a payload's does. Of a block of 5 kg that is 0.2 % of an FRF: more than a faint effect.
"""

from dataclasses import replace

import numpy as np

from twin.diagnose.refit import Fitted
from twin.measure.campaign import ComplexArray
from twin.model.recorded import Recorded
from twin.model.sensitivity import observe, recording_chain
from twin.physics.chain import node_of
from twin.physics.payload import Payload
from twin.robot.description import Entry, Robot


def weightless(recordings: tuple[Recorded, ...], fit: Fitted) -> tuple[Recorded, ...]:
    """Recordings without what the weight of a fit's sensors does to them; the same ones where it has no sensors."""
    if not recordings:
        return recordings
    setup = recordings[0].setup
    load = recording_chain(fit.robot, setup.response, setup.excitation).response_load
    if not load.any():
        return recordings
    return tuple(replace(r, frf=r.frf - _of_weight(r, fit, load)) for r in recordings)


def _of_weight(r: Recorded, fit: Fitted, load: np.ndarray) -> ComplexArray:
    """What a mass that hangs at a channel's node changes in its FRFs (nf, nr, ne) beyond its inertia."""
    found, response = np.zeros_like(r.frf), r.setup.response
    before = _predicted(r, fit, fit.robot)
    bare = [e for e in fit.robot.physics if not _loads(fit.robot.model_copy(update={"physics": [e]}), r)]
    robot = fit.robot.model_copy(update={"physics": bare})
    for node in dict.fromkeys(map(node_of, response.label)):
        rows = [k for k, label in enumerate(response.label) if node_of(label) == node]
        mass, body = float(load[rows[0], rows[0]]), response.body[rows[0]]
        if mass > 0 and body.startswith("link"):
            values = {"mass": mass, "com": response.position[rows[0]].tolist()}
            hung = Entry.model_validate({"effect": Payload.name, "site": body, **values})
            found[:, rows] = (_predicted(r, fit, _with(robot, hung)) - before)[:, rows]
    return found


def _with(robot: Robot, entry: Entry) -> Robot:
    return robot.model_copy(update={"physics": [*robot.physics, entry]})


def _loads(robot: Robot, r: Recorded) -> bool:
    return bool(recording_chain(robot, r.setup.response, r.setup.excitation).response_load.any())


def _predicted(r: Recorded, fit: Fitted, robot: Robot) -> ComplexArray:
    return r.respond(*observe(robot, r.setup, fit.parameters, fit.values))
