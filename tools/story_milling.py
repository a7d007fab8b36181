"""The story of the README: the depth a user would have trusted, the cut that chatters, the name, the new depth.

    python -m tools.story_milling [--out docs/milling-story.png]

A robot of the truth code stands on a foundation that tilts, which its description does not know, and is struck in six
postures. The described model refitted and the diagnosed one both state a depth for a cut in a posture that nobody
struck; then the true robot cuts at both.
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from matplotlib.figure import Figure

from tools.trials.milling import keep_model
from tools.truth.chain import Tolerances
from tools.truth.effects import Effect
from tools.truth.elastic import assemble
from tools.truth.milling import Cut, arc, envelope, last_link, limits
from tools.truth.recording import HammerTest, draw_postures, draw_truth, streams, write_campaign
from twin.diagnose.hammer import diagnose_campaign
from twin.measure.recordings import read_campaign
from twin.milling.cut import read_cut
from twin.milling.ensemble import ensemble, quantile_of_safe
from twin.milling.map import lobes
from twin.milling.postures import tips
from twin.milling.tool_point import ToolModes
from twin.report.figures import save
from twin.robot.description import load_robot

SEED, CONCEALED = 3, Effect("base_compliance", "base.ry", {"stiffness": 1.5e7, "damping": 3000.0})
Q_DEG, FEED = (35.0, 100.0, -85.0), (0.0, 1.0, 0.0)
TEETH, IMMERSION, RPM = 3, 0.5, 1500.0
SPEEDS = np.geomspace(600, 6000, 160)
TRUE_SPEEDS = np.geomspace(650, 5800, 24)
DEEPEST_M, DRAWS = 0.02, 60
ASKED = {
    "tool": {"teeth": TEETH, "overhang_m": 0.25, "direction": [1.0, 0.0, 0.0], "mass_kg": 20.0, "com_m": 0.12},
    "coefficients": {"kt_n_per_m2": 6.0046e8, "kr_n_per_m2": 1.8096e8, "deviation_percent": 10.0},
    "immersion": IMMERSION, "milling": "down", "feed_direction": list(FEED), "table_z_m": None,
    "depth_max_m": DEEPEST_M,
}  # fmt: skip


def stated(folder: Path, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits and 90 % depths (ns,), m, of a kept model."""
    robot, cut = load_robot(folder / "robot.yaml"), read_cut(ASKED)
    q = robot.angles(Q_DEG)[None]
    own = tips(robot, q, cut, "off")
    rotation = cut.frame(own.axis)
    limit = lobes(own.modes.turned(rotation), cut, speeds)[0]
    drawn = ensemble(robot, cut, DRAWS)
    assert drawn is not None
    seen = drawn.tips(q, cut, "off").modes
    modes = ToolModes(seen.pole[:, 0], seen.shape[:, 0]).turned(rotation[0])
    return limit, quantile_of_safe(lobes(modes, cut, speeds, drawn.coefficients))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/milling-story.png"))
    out = parser.parse_args().out
    postures = draw_postures(6, streams(SEED)[1])
    truth = draw_truth(SEED, (CONCEALED,), postures, Tolerances())
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_campaign(folder / "frf.h5", truth, postures, HammerTest(), streams(SEED)[3])
        given = load_robot("kr90")
        found = diagnose_campaign(read_campaign(folder / "frf.h5"), given, "frf.h5")
        for stage, fit in zip(("before", "after"), found.fits, strict=True):
            keep_model(folder / stage, fit)
        at = np.append(SPEEDS, RPM)
        depths = {stage: stated(folder / stage, at) for stage in ("before", "after")}
    spindle = Effect("payload", "flange", {"mass": 20.0, "com": [1.615 + 0.12, -0.041, 0.0]})
    structure = assemble(truth.chain, np.deg2rad(Q_DEG), (CONCEALED, spindle))
    tip, shear = truth.chain.flange + np.array([0.25, 0, 0]), np.array([6.0046e8, 1.8096e8, 0.0])
    cases = [
        (
            structure,
            Cut(tip, -last_link(structure)[:, 0], np.array(FEED), TEETH, arc(IMMERSION, False), shear, float(rpm)),
        )
        for rpm in (*TRUE_SPEEDS, RPM)
    ]
    true = limits(cases, DEEPEST_M)
    name = " and ".join(f"{m.first.title} (probability {m.probability:.2f})" for m in found.missing)
    before, after = (1e3 * float(depths[stage][1][-1]) for stage in ("before", "after"))
    trusted = 1e3 * float(depths["before"][0][-1])
    print(f"before: limit {trusted:.2f} mm, 90 % {before:.2f} mm; {found.word}: {name}")
    print(
        f"after: limit {1e3 * depths['after'][0][-1]:.2f} mm, 90 % {after:.2f} mm; true limit {1e3 * true[-1]:.2f} mm"
    )
    save(drawn(depths, true, [envelope(*cases[-1], d / 1e3, 2.0) for d in (before, after)], before, after), out)


def drawn(
    depths: dict[str, tuple[np.ndarray, np.ndarray]], true: np.ndarray, motion: list[tuple[np.ndarray, np.ndarray]],
    before: float, after: float,
) -> Figure:  # fmt: skip
    """Lobes of both models with the true limits on them; the tip of the true robot at both depths."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for stage, colour, word in (("before", "#e8590c", "before the diagnosis"), ("after", "#1f4e9c", "after it")):
        limit, safe = (1e3 * values[:-1] for values in depths[stage])
        left.loglog(SPEEDS, limit, color=colour, linewidth=1, alpha=0.5, label=f"limit of the model {word}")
        left.loglog(SPEEDS, safe, color=colour, linewidth=2.2, label=f"90 % safe {word}")
    left.loglog(TRUE_SPEEDS, 1e3 * true[:-1], "ko", markersize=5, label="true robot's limit, stepped in time")
    for depth, colour in ((before, "#e8590c"), (after, "#1f4e9c")):
        left.plot(RPM, depth, "s", color=colour, markersize=10, markeredgecolor="white", zorder=5)
    left.set_xlabel("spindle speed, rpm")
    left.set_ylabel("axial depth of cut, mm")
    left.set_xticks([600, 1000, 2000, 5000], ["600", "1000", "2000", "5000"])
    left.minorticks_off()
    left.grid(True, color="#d5d8dd", linewidth=0.5)
    left.legend(fontsize=8)
    left.set_title("How deep may it cut? A posture that nobody struck", fontsize=10)
    for (time, size), depth, colour in zip(motion, (before, after), ("#e8590c", "#1f4e9c"), strict=True):
        word = "chatters" if size[-1] > size[0] else "cuts"
        right.semilogy(time, size, color=colour, linewidth=2, label=f"{depth:.2f} mm: {word}")
    right.set_ylim(3e-3, 3e2)
    right.grid(True, color="#d5d8dd", linewidth=0.5)
    right.legend(fontsize=10)
    right.set_xlabel("time, s")
    right.set_ylabel("vibration of the tip over that at the start")
    right.set_title(f"The true robot's cut at {RPM:g} rpm, at both depths", fontsize=10)
    return figure


if __name__ == "__main__":
    main()
