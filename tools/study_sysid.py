"""Side by side with mujoco.sysid: same truth, same blows, same eighteen parameters; time and accuracy.

    python tools/study_sysid.py [--seed 1] [--blows 3]        (needs mujoco[sysid])

The independent truth code hits a robot whose springs and dampers are not those described (stiffness ×/÷ 1.3, damping
×/÷ 2 or 10); everything else is known to both. ``mujoco.sysid`` gets the time records of some blows in three postures
and fits accelerations by rolling MuJoCo out, with limits at the priors' three deviations; ``twin fit`` gets the FRFs of
the same records.
"""

import time
from dataclasses import replace
from typing import Annotated, Any

import mujoco
import numpy as np
import typer

from tools.truth.chain import Tolerances
from tools.truth.chain import kr90 as chain
from tools.truth.recording import HAMMER, SENSORS, HammerTest, draw_postures, draw_truth, h1, raw_hits, streams
from twin.identify.elastic import fit_frf
from twin.measure.campaign import Campaign, Channels, PostureFRF
from twin.model.parameters import free_parameters
from twin.model.recorded import prepare
from twin.robot.description import Robot, load_robot
from twin.robot.mechanism import assemble
from twin.robot.mjcf import build_spec

STEP_S = 1 / 2048
MOST_ITERATIONS = 60
SECONDS = 2.0  # of every record that sysid rolls out


def channels(found: Any) -> Channels:
    return Channels(
        tuple(c.label for c in found), tuple(c.body for c in found), np.array([c.position for c in found]),
        np.array([c.direction for c in found]),
    )  # fmt: skip


def with_points(robot: Robot, blows: Any) -> Robot:
    """The description with the truth code's hammer and sensor points."""
    points = [
        {"label": c.label, "body": c.body, "position": list(c.position), "direction": [float(x) for x in c.direction]}
        for c in {c.label: c for c in (*blows, *SENSORS)}.values()
    ]
    data = robot.model_dump(mode="json") | {"test_points": points, "accelerometers": [c.label for c in SENSORS]}
    return Robot.model_validate(data)


def by_sysid(robot: Robot, records: list[tuple[np.ndarray, str, np.ndarray, np.ndarray, float]]) -> dict[str, float]:
    """mujoco.sysid's estimates; a record is (q, blow, force, response, rate)."""
    from mujoco import sysid

    parameters = free_parameters(robot, tolerances=False)
    given = sysid.ParameterDict()
    for p in parameters:

        def modifier(spec: mujoco.MjSpec, value: Any, site: str = p.site, what: str = p.quantity) -> None:
            joint, size = spec.joint(site), float(np.exp(np.ravel(value.value)[0]))
            if what == "damping":
                joint.damping = [size, 0, 0]
            else:
                joint.springref = joint.springref * joint.stiffness[0] / size  # carries the same weight
                joint.stiffness = [size, 0, 0]

        middle, reach = np.log(p.mean), 3 * p.deviation
        given.add(sysid.Parameter(p.name, middle, middle - reach, middle + reach, modifier=modifier))

    sequences = []
    for number, (q, label, force, response, rate) in enumerate(records):
        spec = build_spec(assemble(robot, q), visual=False)
        spec.option.timestep = STEP_S
        model = spec.compile()
        times = np.arange(round(SECONDS / STEP_S)) * STEP_S
        known = np.arange(len(force)) / rate
        control = np.zeros((len(times), model.nu))
        control[:, model.actuator(f"hammer {label}").id] = np.interp(times + STEP_S / 2, known, force)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        turn = data.xmat[model.body("link3").id].reshape(3, 3)
        measured = np.stack([np.interp(times, known, response[k]) for k in range(3)], axis=1) @ turn.T
        sensors = np.zeros((len(times), model.nsensordata))
        columns = [model.sensor(c.label).adr[0] for c in SENSORS]
        for column in columns:
            sensors[:, column : column + 3] = measured
        sequences.append(
            sysid.ModelSequences(
                f"record{number}", spec, f"blow{number}",
                sysid.create_initial_state(model, np.zeros(model.nq), np.zeros(model.nv)),
                sysid.TimeSeries.from_control_names(times, control, model),
                sysid.TimeSeries.from_names(times, sensors, model),
            )
        )  # fmt: skip

    def residual(_: Any, predicted: Any, measured: Any, model: Any, *__: Any, **___: Any) -> Any:
        column = model.sensor(SENSORS[0].label).adr[0]
        n = min(len(predicted.times), len(measured.times))
        felt = predicted.data[:n, column : column + 3] + model.opt.gravity  # framelinacc stands still at +g
        difference = felt - measured.data[:n, column : column + 3]
        return difference.ravel(), predicted, predicted

    function = sysid.build_residual_fn(models_sequences=sequences, modify_residual=residual)
    found, _ = sysid.optimize(given, function, optimizer="mujoco", verbose=False, max_iters=MOST_ITERATIONS)
    return {name: float(np.exp(np.ravel(found[name].value)[0])) for name in parameters.names}


def main(
    seed: Annotated[int, typer.Option(help="of the truth")] = 1,
    blows: Annotated[int, typer.Option(help="hammer points used, in every posture")] = 3,
) -> None:
    """Run both and print them."""
    test = HammerTest(hits=1, averages=1, noise=3e-5, lines=200)
    tolerances = replace(Tolerances.none(), stiffness=1.3, damping=2.0, damping_poor=10.0)
    postures = draw_postures(3, np.random.default_rng(0))
    truth = draw_truth(seed, (), postures, tolerances, sag=False)
    keep = [20, 21, 22, *np.linspace(0, 19, blows - 3).round().astype(int)][:blows]
    robot = with_points(load_robot("kr90"), [HAMMER[k] for k in keep])
    records, groups = [], {}
    rng = streams(seed)[3]
    for posture in postures:
        force, response, before = raw_hits(truth, posture, test, 300.0, rng)
        start = round(before * test.hit_rate_hz)
        for k in keep:
            records.append(
                (
                    robot.angles(posture.q_deg),
                    HAMMER[k].label,
                    force[k, 0, start:],
                    response[k, 0, :, start:],
                    test.hit_rate_hz,
                )
            )
        frf, _ = h1(force[keep], response[keep], test, before)
        coherence = np.full(frf.shape, 0.9999)
        groups[posture.name] = PostureFRF(
            posture.name, np.array(posture.q_deg), "on", test.frequency, frf, "accelerance", coherence, 3,
            exponential_window_rate=test.decay,
        )  # fmt: skip
    campaign = Campaign(channels(SENSORS), channels([HAMMER[k] for k in keep]), groups, "kr90")
    began = time.perf_counter()
    recordings = list(prepare(campaign, robot).values())
    fit = fit_frf(robot, recordings, free_parameters(robot, tolerances=False), starts=1)
    ours, seconds = dict(zip(fit.parameters.names, fit.values, strict=True)), time.perf_counter() - began
    began = time.perf_counter()
    theirs = by_sysid(robot, records)
    print(f"twin fit: {seconds:.1f} s; mujoco.sysid: {time.perf_counter() - began:.1f} s; {len(records)} records")
    nominal, true = chain(), truth.chain
    for name in ours:
        site, _, what = name.rpartition(".")
        place = int(site[5]) - 1, "zxy".index(site[-1])
        value = getattr(true, what)[place]
        print(
            f"  {name:20} true {value:10.4g}  described {getattr(nominal, what)[place] / value - 1:+7.1%}"
            f"  twin {ours[name] / value - 1:+8.2%}  sysid {theirs[name] / value - 1:+8.2%}"
        )
    for what in ("stiffness", "damping"):
        errors = [
            [
                abs(np.log(found[name] / getattr(true, what)[int(name[5]) - 1]["zxy".index(name[7])]))
                for name in found
                if what in name
            ]
            for found in (ours, theirs)
        ]
        print(f"  {what}: median |ln error| twin {np.median(errors[0]):.4f}, sysid {np.median(errors[1]):.4f}")


if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(main)
    app()
