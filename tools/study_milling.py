"""Limits of milling against published radii, an independent time simulation and closed forms, and how fast they are.

    python -m tools.study_milling            # everything, some minutes
    python -m tools.study_milling radii slot first thirteen kr90 slow speed amplitude

The time simulation (`tools.truth.milling`) shares no code with the twin: it steps the delay equation from a random
disturbance and reads the growth rate; a limit is where the rate changes sign.
"""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from tools.truth import milling as truth
from twin.milling.cut import Cut, read_cut
from twin.milling.in_time import CutInTime, CutStepper
from twin.milling.stability import limits, multipliers
from twin.milling.tool_point import ToolModes, real_modes, tool_point
from twin.milling.zeroth_order import limiting_depth, low_frequency_depth
from twin.report.figures import save
from twin.robot.description import Entry, Robot, load_robot

PUBLISHED_HZ = [7.07, 10.29, 16.02, 18.49, 34.39, 37.81, 72.67, 107.81, 116.76, 121.93, 141.74, 193.88, 253.25]
PUBLISHED_PERCENT = [3.74, 2.21, 2.30, 3.32, 4.00, 3.84, 5.05, 4.84, 7.60, 3.44, 2.07, 3.67, 3.88]
RADII = {0.2: 0.819742784, 0.5: 1.073975587, 0.7: 1.221556136, 1.0: 1.406473525}  # mm: limit of semi-discretisation


def benchmark_cut(immersion: float, milling: str, teeth: int = 2) -> Cut:
    """Insperger and Stépán's coefficients."""
    content = {"tool": {"teeth": teeth}, "coefficients": "benchmark", "immersion": immersion, "milling": milling}
    return read_cut(content)


def benchmark_modes() -> ToolModes:
    """Insperger and Stépán's tool: one mode along the feed."""
    return real_modes([922.0], [1.1], [[0.03993**-0.5, 0.0, 0.0]])


def thirteen_modes(seed: int = 0) -> ToolModes:
    """A published milling robot's frequencies and dampings, with drawn shapes of 30 to 200 kg in all directions."""
    rng = np.random.default_rng(seed)
    shape = rng.standard_normal((13, 3))
    shape /= np.linalg.norm(shape, axis=1, keepdims=True) * np.sqrt(rng.uniform(30, 200, (13, 1)))
    return real_modes(PUBLISHED_HZ, PUBLISHED_PERCENT, shape)


def simulated_limits(
    modes: ToolModes, cut: Cut, speeds: np.ndarray, near: np.ndarray, steps: int, seconds: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (S,) m at which the simulated growth changes sign, looked for within 10 % of ``near`` (NaN where it does
    not), and the largest growth rate (S,) 1/s from a tenth of ``near`` up to 0.9 of it."""
    share = np.concatenate([np.linspace(0.1, 0.9, 9), np.linspace(0.92, 1.10, 10)])
    c = cut.coefficients
    plan = truth.Cut(
        np.zeros(3), np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), cut.tool.teeth,
        truth.arc(cut.immersion, cut.milling == "up"), np.array([c.kt_n_per_m2, c.kr_n_per_m2, c.ka_n_per_m2]), 1.0,
    )  # fmt: skip
    oscillating = modes.pole.imag > 0
    real_pole, real_shape = modes.pole[~oscillating], modes.shape[~oscillating]
    pole = np.concatenate([modes.pole[oscillating], real_pole + 1e-9j])
    shape = np.concatenate([modes.shape[oscillating], real_shape])
    columns = len(share) * len(speeds)
    rate = truth.growth(
        np.repeat(pole[:, None], columns, 1),
        np.repeat(shape[:, :, None], columns, 2),
        np.repeat(truth.directions(plan, steps)[..., None], columns, 3),
        (share[:, None] * near).ravel(), np.tile(60 / speeds / cut.tool.teeth, len(share)), seconds,
    ).reshape(len(share), -1)  # fmt: skip
    found = np.full(len(speeds), np.nan)
    for k in range(len(speeds)):
        up = np.flatnonzero((rate[8:-1, k] < 0) & (rate[9:, k] >= 0))
        if len(up):
            a, b = 8 + up[0], 9 + up[0]
            mix = rate[a, k] / (rate[a, k] - rate[b, k])
            found[k] = near[k] * (share[a] + mix * (share[b] - share[a]))
    return found, rate[:9].max(axis=0)


def compare(name: str, modes: ToolModes, cut: Cut, speeds: np.ndarray, steps: int = 160, seconds: float = 12.0) -> None:
    """Print limits beside the time simulation, speed by speed, and without cross terms."""
    found = limits(modes, cut, speeds, cut.depth_max_m)
    first = found.first()
    some = np.isfinite(first)
    speeds, first = speeds[some], first[some]
    direct = limits(modes.without_cross_terms(), cut, speeds, 10 * cut.depth_max_m).first()
    simulated, below = simulated_limits(modes, cut, speeds, first, steps, seconds)
    kinds = [str(found.kind[np.argmax(found.row == row)]) for row in np.flatnonzero(some)]
    print(f"{name}: rpm, limit mm, simulated mm, difference %, error without cross terms %, kind")
    for k, rpm in enumerate(speeds):
        print(
            f"  {rpm:8.0f} {1e3 * first[k]:9.4f} {1e3 * simulated[k]:9.4f} {100 * (first[k] / simulated[k] - 1):8.3f}"
            f" {100 * (direct[k] / first[k] - 1):9.1f}  {kinds[k]}"
        )
    worst = np.max(np.abs(first / simulated - 1))
    print(f"  largest difference {100 * worst:.3f} %; growth below 0.9 of the limit at most {below.max():.3g} 1/s")


def radii() -> None:
    """Spectral radii of the slot at 5000 rpm."""
    cut, modes = benchmark_cut(1.0, "up"), benchmark_modes()
    for depth, published in RADII.items():
        radius = abs(multipliers(modes, cut, 5000, depth * 1e-3)[0])
        print(f"slot, 5000 rpm, {depth} mm: radius {radius:.9f}, off the published by {radius - published:.1e}")


def slot() -> None:
    """First limits in full immersion, which is up and down milling at once."""
    _first(1.0, ("up",), np.linspace(5000, 20000, 7))


def first() -> None:
    """First limits of up and down milling at lower immersions."""
    for immersion in (0.05, 0.1, 0.5):
        _first(immersion, ("up", "down"), np.linspace(5000, 20000, 7))


def _first(immersion: float, ways: tuple[str, ...], speeds: np.ndarray) -> None:
    for milling in ways:
        cut = benchmark_cut(immersion, milling).model_copy(update={"depth_max_m": 0.05})
        compare(f"{milling} milling, immersion {immersion:g}", benchmark_modes(), cut, speeds, 500, 0.6)


def thirteen() -> None:
    """The published milling robot at twenty spindle speeds."""
    cut = benchmark_cut(0.5, "down").model_copy(update={"depth_max_m": 0.1})
    compare("13 modes, half immersion", thirteen_modes(), cut, np.geomspace(800, 12000, 20), 120, 5.0)


def kr90_point() -> tuple[ToolModes, Cut]:
    """The KR90 in the paper's milling posture with a spindle of 12 kg."""
    cut = read_cut({"tool": {"teeth": 2, "overhang_m": 0.25, "mass_kg": 12}, "coefficients": "benchmark"})
    point = tool_point(load_robot("kr90"), np.deg2rad([0, 70, -100]), "on", cut)
    return point.modes.turned(cut.frame(point.axis)), cut.model_copy(update={"depth_max_m": 0.1})


def kr90() -> None:
    """A KR90 posture at twenty spindle speeds."""
    modes, cut = kr90_point()
    speeds = np.geomspace(1000, 12000, 20)
    compare("KR90, milling posture", modes, cut, speeds[:8], 60, 60.0)
    compare("KR90, milling posture", modes, cut, speeds[8:], 40, 60.0)  # several modes nearly as slow as the border's


def slow() -> None:
    """The closed form of slow vibration in its limit, against the spectral limits."""
    modes, cut = kr90_point()
    print("vibration slow against the teeth: rpm, spectral mm, closed form mm, difference %")
    for rpm in (3000.0, 12000.0, 48000.0, 192000.0, 384000.0):
        exact = limits(modes, cut, np.array([rpm]), 10.0).first()[0]
        form = float(low_frequency_depth(modes, cut, rpm))
        print(f"  {rpm:8.0f} {1e3 * exact:9.4f} {1e3 * form:9.4f} {100 * (form / exact - 1):8.3f}")


NONLINEAR: dict[str, dict[str, Any] | None] = {
    "as described": None,
    "gap of 50 µrad in joint 1": {"effect": "backlash", "site": "joint1.z", "gap": 5e-5},
    "slip of 15 % in joint 3 beyond 10 µrad": {
        "effect": "hysteresis", "site": "joint3.z", "stiffness": [4.2e5], "yield_torque": [4.2],
    },
    "joint 1 twice as stiff at 50 µrad": {"effect": "hardening_stiffness", "site": "joint1.z", "cubic": 2e15},
}  # fmt: skip
AMPLITUDE_Q, AMPLITUDE_RPM = np.deg2rad([0, 70, -100]), 2500.0


def amplitude_cut() -> Cut:
    """A cut whose limit asks much of the joints: teeth of thick chips, so that they stay in the work for long."""
    tool = {"teeth": 2, "overhang_m": 0.25, "mass_kg": 12}
    return read_cut({"tool": tool, "coefficients": "benchmark", "milling": "up", "feed_per_tooth_m": 3e-4})


def nonlinear_robot(entry: dict[str, Any] | None) -> Robot:
    """The KR90 with one entry more."""
    robot = load_robot("kr90")
    return (
        robot if entry is None else robot.model_copy(update={"physics": [*robot.physics, Entry.model_validate(entry)]})
    )


def linear_limit(robot: Robot, cut: Cut) -> float:
    """Depth, m, that the lobes state."""
    point = tool_point(robot, AMPLITUDE_Q, "on", cut)
    modes = point.modes.turned(cut.frame(point.axis))
    return float(limits(modes, cut, np.array([AMPLITUDE_RPM]), 0.05).first()[0])


def settled_m(ran: CutInTime) -> float:
    """RMS change of the motion from turn to turn over the last tenth, m; having run away, a tenth of the tool."""
    count = len(ran.change_m)
    return float(np.mean(ran.change_m[-max(1, count // 10) :])) if count > 8 else 0.1 * amplitude_cut().tool.diameter_m


def amplitude() -> None:
    """Where linear lobes lie: one cut after blows of many sizes, joints linear or not; a figure."""
    cut, blows, depths = amplitude_cut(), (0.0, 1.0, 2.0, 3.0, 4.0, 6.0), np.arange(0.5, 6.6, 0.5)
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    for ax, (name, entry) in zip(figure.subplots(2, 2, sharex=True, sharey=True).flat, NONLINEAR.items(), strict=True):
        robot = nonlinear_robot(entry)
        limit, stepper = 1e3 * linear_limit(robot, cut), CutStepper(robot, AMPLITUDE_Q, "on", cut, AMPLITUDE_RPM)
        ran = [[stepper.run(1e-3 * depth, kick_n_s=blow) for depth in depths] for blow in blows]
        size = np.array([[settled_m(one) for one in row] for row in ran])
        chatter = np.array([[one.chatter for one in row] for row in ran])
        shown = ax.pcolormesh(
            depths, np.arange(len(blows)), 1e6 * size, norm=LogNorm(0.1, 2000), cmap="viridis", shading="nearest"
        )
        at, row = np.meshgrid(depths, np.arange(len(blows)))
        edge = [Stroke(linewidth=3.2, foreground="black"), Normal()]  # seen on every colour, and in the legend
        ax.plot(at[chatter], row[chatter], "x", color="white", markersize=6, label="chatters", path_effects=edge)
        ax.axvline(limit, color="#e8590c", linewidth=2.2, label="limit of the linear lobes")
        ax.set_title(f"{name}: linear limit {limit:.2f} mm", fontsize=10)
        ax.set_yticks(np.arange(len(blows)), [f"{blow:g}" for blow in blows])
        print(f"{name}: linear limit {limit:.2f} mm")
        for blow, row in zip(blows, chatter, strict=True):
            print(f"  blow {blow:g} N·s: chatters at", *(f"{depth:g}" for depth in depths[row]), "mm")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower right", ncols=2, fontsize=9, frameon=False)
    figure.colorbar(shown, ax=figure.axes, label="settled change from turn to turn, µm")
    figure.supxlabel("axial depth of cut, mm", fontsize=10)
    figure.supylabel("blow before the cut, N·s", fontsize=10)
    save(figure, Path("docs/milling-amplitude.png"))


def speed() -> None:
    """CPU time of a chart of 1000 speeds, and of closed forms of 10,000 postures."""
    modes, cut = kr90_point()
    for name, some in (("KR90", modes), ("13 modes", thirteen_modes())):
        start = time.process_time()
        found = limits(some, cut, np.linspace(1000, 12000, 1000), 0.05)
        found.unstable(np.linspace(0, 0.05, 200))
        spent = time.process_time() - start
        print(f"{name}: chart of 1000 speeds x 200 depths {spent:.1f} s CPU, {len(found.row)} limits")
    many = ToolModes(np.tile(modes.pole, (10_000, 1)), np.tile(modes.shape, (10_000, 1, 1)))
    start = time.process_time()
    limiting_depth(many, cut)
    print(f"closed form, 10,000 postures: {time.process_time() - start:.1f} s CPU")


STUDIES: dict[str, Any] = {
    "radii": radii, "slot": slot, "first": first, "thirteen": thirteen, "kr90": kr90, "slow": slow, "speed": speed,
    "amplitude": amplitude,
}  # fmt: skip

if __name__ == "__main__":
    if unknown := [word for word in sys.argv[1:] if word not in STUDIES]:
        sys.exit(f"{unknown[0]}: expected any of {', '.join(STUDIES)}")
    for study in sys.argv[1:] or STUDIES:
        STUDIES[study]()
