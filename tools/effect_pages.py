"""A page per effect, made from its own file in `twin/physics`: law, sites, parameters, rivals, and its signature.

`python -m tools.effect_pages FOLDER` writes them; `make docs` puts them into the site. The pictures are of the KR90 in
the paper's milling posture, as it is shipped, with the effect and without it. An effect that the shipped robot has is
taken out. Another is added, of its usual size.
"""

import argparse
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from ruamel.yaml import YAML
from ruamel.yaml.compat import StringIO

from twin.diagnose.torque_next import ADVICE
from twin.measure.motion_log import MotionRun
from twin.model.frf import frf, measurement_chain
from twin.model.linear import linearise
from twin.model.replay import inverse_dynamics, motion_of, recorded_torque
from twin.physics import CATALOGUE
from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.joint_law import USUAL_DEFLECTION
from twin.physics.motion import Motion
from twin.report.figures import phase_deg, save
from twin.robot.description import Entry, Robot, load_robot, parse_robot
from twin.robot.mechanism import assemble

ROBOT, POSTURE_DEG = "kr90", (0.0, 70.0, -100.0)
CARRIES = 1  # zero-based: the axis that carries most weight
FREQUENCY, COARSE = np.linspace(4.0, 60.0, 1500), np.linspace(4.0, 60.0, 150)
BAND_HZ = (15.0, 15.4)  # of a mode that an effect adds: between the robot's own
SWING_S, RATE_HZ, SWING_RAD = 8.0, 250.0, 0.5
WIDTH = 70  # characters of a line of YAML
LINE = 50  # of a formula that stays in one line
SHARE = 0.1  # of an axis' RMS torque: what an added law ordinarily adds, as in twin.model.torque_laws
LARGER = 2  # prior deviations of an error of either sign, whose usual value is none
WITHOUT = {"color": "#e8590c", "linewidth": 1.2, "linestyle": "--", "zorder": 3}  # above what it may coincide with
WITH = {"color": "#1f4e9c", "linewidth": 1.6}
SWINGS = ("#9ec5f0", "#4c86c6", "#123a73")
RECORDED = {"hammer": "hammer tests", "levels": "hammer tests at several force levels", "log": "motion logs"}
LEVELS_TEST = "the same blows at two force levels or more, the highest ten times the lowest: the law is in their ratio"
HAMMER_TEST = "a hammer test in six postures or more, with joint 1 turned between them"
CHANNEL_TEST = "a hammer test with the driving points: what only one channel shows does not come from the robot"


@dataclass(frozen=True)
class Example:
    """An entry, and the shipped robot with and without it."""

    entry: Entry
    with_it: Robot
    without: Robot

    @property
    def title(self) -> str:
        """EFFECT@SITE."""
        return f"{self.entry.effect}@{self.entry.site}"

    @property
    def values(self) -> Values:
        """The entry's parameters."""
        return self.with_it.values(self.entry)

    @property
    def axis(self) -> int:
        """Zero-based axis of the site."""
        return axis_of(self.entry.site)


class Swing:
    """A motion of all axes and its torque, as an effect may ask about them (`twin.physics.statements.LogView`)."""

    highest_hz, rate_hz, sample_hz = 4.0, RATE_HZ, RATE_HZ

    def __init__(self, robot: Robot, site: str = "") -> None:
        self.robot, self.site = robot, site
        self.motion = _swing(robot)
        self.torque = inverse_dynamics(robot, self.motion)

    @property
    def axis(self) -> int:
        return axis_of(self.site)

    def usual(self, axis: int | None = None) -> float:
        return SHARE * _rms(self.torque[:, self._axis(axis)])

    def speed(self, axis: int | None = None) -> float:
        return _rms(self.motion.velocity[:, self._axis(axis)])

    def acceleration(self, axis: int | None = None) -> float:
        return _rms(self.motion.acceleration[:, self._axis(axis)])

    def middle(self) -> tuple[float, float]:
        q = self.motion.position[:, self.axis]
        return float(q.mean()), float(0.5 * np.ptp(q))

    def size(self, values: Values) -> float:
        torque = self.effect.torque(self.motion, self.site, values)
        return self.usual() / max((_rms(each) for each in torque.values()), default=1.0)

    def of(self, effect: Effect, site: str) -> "Swing":
        """The same motion, asked by an effect at a site."""
        self.effect, self.site = effect, site
        return self

    def _axis(self, axis: int | None) -> int:
        return self.axis if axis is None else axis


def pages() -> Iterator[tuple[str, str, dict[str, Figure]]]:
    """Name, page in Markdown, and figures by file name, of every effect in the order of the vocabulary."""
    robot = load_robot(ROBOT)
    swing = Swing(robot)
    for name, effect in CATALOGUE.items():
        examples = {kind: example for kind in _drawn(effect) if (example := FIND[kind](robot, effect, swing))}
        figures = {kind: DRAW[kind](example) for kind, example in examples.items()}
        page = _page(effect, examples)
        yield name, page, {_file(name, kind): figure for kind, figure in figures.items()}


def index() -> str:
    """A page that lists them all."""
    head = "# Every effect\n\nEach page is made from the effect's own file in `twin/physics/`.\n"
    rows = [
        f"| [`{name}`]({name}.md) | {_formula(_first(inspect.getmodule(effect)))} | {_kinds(effect)} |"
        for name, effect in CATALOGUE.items()
    ]
    return "\n".join([head, "| effect | law | seen in |", "|---|---|---|", *rows, ""])


# --- pages --------------------------------------------------------------------------------------------------------


def _page(effect: Effect, examples: dict[str, Example]) -> str:
    law = inspect.getdoc(inspect.getmodule(effect)) or ""
    model = inspect.getdoc(type(effect)) or ""
    parts = [f"# `{effect.name}`", _markdown(law), f"**Seen in** {_kinds(effect)}."]
    parts += ["## In the model", _markdown(model), f"Sites: {', '.join(f'`{site}`' for site in effect.sites)}."]
    head = ["| parameter | unit | no effect at | may be |", "|---|---|---|---|"]
    parts += ["\n".join([*head, *map(_row, effect.parameters)])]
    if examples:
        parts += ["## What it looks like"]
    entries = {kind: _yaml(example.entry) for kind, example in examples.items()}
    for entry in dict.fromkeys(entries.values()):  # often one for all pictures
        parts += [f"In `robot.yaml`, as it is drawn below (large enough to be seen):\n\n```yaml\nphysics:\n{entry}```"]
        drawn = [kind for kind in entries if entries[kind] == entry]
        parts += [f"![{CAPTIONS[kind]}]({_file(effect.name, kind)})\n\n*{CAPTIONS[kind]}*" for kind in drawn]
    parts += ["## What is hard to tell from it", _aliases(effect, examples), "## What test shows it", _tests(effect)]
    return "\n\n".join(parts) + "\n"


def _file(name: str, kind: str) -> str:
    return f"{name}-{kind}.png"


def _row(p: Parameter) -> str:
    size = {0: "", -1: "[\u00a0]"}.get(p.length, f"[{p.length}]")
    null = "" if p.word or p.length < 0 or (p.positive and p.null == 0) else "∞" if p.null == np.inf else f"{p.null:g}"
    may = [
        "> 0" if p.positive else "≥ 0" if p.nonnegative else "any" * (not p.word),
        "or left out" if p.optional else "",
    ]
    return f"| `{p.name}`{size} | {p.unit} | {null} | {' '.join(filter(None, may))} |"


def _aliases(effect: Effect, examples: dict[str, Example]) -> str:
    here = [(e, c) for e in examples.values() for c in effect.companions(e.without, e.entry.site, e.values)]
    itself = {(e.entry.effect, e.entry.site) for e in examples.values()}
    named = list(dict.fromkeys(f"`{c.effect}` at `{c.site}`" for _, c in here if (c.effect, c.site) not in itself))
    if not named:
        return (
            "There is no rival that every diagnosis compares it with. "
            "[Diagnosis](../diagnosis.md#what-recordings-can-never-tell-apart) lists what no recording can tell apart."
        )
    return f"At `{here[0][0].entry.site}` a diagnosis always compares it with {', '.join(named)}."


def _tests(effect: Effect) -> str:
    tests = [ADVICE[test] for test in effect.log_tests]
    if "levels" in effect.seen_in:
        tests.insert(0, LEVELS_TEST)
    if "hammer" in effect.seen_in:
        tests.insert(0, CHANNEL_TEST if type(effect).record is not Effect.record else HAMMER_TEST)
    if effect.ordinary:
        return f"It is not searched for as an effect: {effect.ordinary}."
    return "\n".join(f"- {test[0].upper()}{test[1:]}." for test in tests) or "The effect names no test of its own."


def _kinds(effect: Effect) -> str:
    return ", ".join(RECORDED[kind] for kind in RECORDED if kind in effect.seen_in)


def _markdown(text: str) -> str:
    return text.replace("``", "`")


def _first(module: Any) -> str:
    return _markdown(" ".join((inspect.getdoc(module) or "").split("\n\n")[0].split())).replace("|", "\\|")


def _formula(law: str) -> str:
    """A law whose short formula, at its end, stays in one line."""
    words, colon, formula = law.rpartition(": ")
    whole = len(formula) < LINE and re.search("[=×φ̇]", formula)
    return words + colon + (formula.replace(" ", "\u00a0") if whole else formula)


def _yaml(entry: Entry) -> str:
    stream = StringIO()
    writer = YAML()
    writer.default_flow_style = True
    writer.width = 10_000  # a list would be cut anywhere
    writer.representer.add_representer(float, _number)
    writer.dump([_rounded(entry.model_dump(mode="json"))], stream)
    whole = re.sub(r"\[[^]]{,50}\]|\w: ", lambda part: part[0].replace(" ", "\u00a0"), stream.getvalue().strip()[1:-1])
    lines = textwrap.wrap(whole, WIDTH, initial_indent="  - ", subsequent_indent="     ", break_long_words=False)
    return "\n".join([*lines, ""]).replace("\u00a0", " ")


def _number(representer: Any, value: float) -> Any:
    text = re.sub(r"e\+?(-?)0*", r"e\1", f"{value + 0.0:g}")
    return representer.represent_scalar("tag:yaml.org,2002:float", text if re.search(r"[.e]", text) else f"{text}.0")


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return type(value)(float(f"{value:.3g}")) if isinstance(value, int | float) else value


# --- examples -----------------------------------------------------------------------------------------------------


def _drawn(effect: Effect) -> list[str]:
    """The pictures that show an effect."""
    drives = (
        effect.has_torque or effect.records_torque or "mass" in {p.name for p in effect.parameters} or _leans(effect)
    )
    shown = {"frf": "hammer" in effect.seen_in, "loop": "levels" in effect.seen_in}
    return [kind for kind, told in {**shown, "torque": "log" in effect.seen_in and drives}.items() if told]


def _described(robot: Robot, effect: Effect) -> Example | None:
    """The first entry that the shipped robot has."""
    for entry in robot.physics:
        if entry.effect == effect.name:
            return Example(entry, robot, robot.without([f"{entry.effect}@{entry.site}"]))
    return None


def _added(robot: Robot, effect: Effect, site: str, values: Values) -> Example:
    data = robot.model_dump(mode="json")
    data["physics"].append({"effect": effect.name, "site": site, **values})
    with_it = parse_robot(data)
    return Example(with_it.physics[-1], with_it, robot)


def _of_structure(robot: Robot, effect: Effect, swing: Swing) -> Example | None:
    """Of its usual size, where it changes the FRFs most."""
    if described := _described(robot, effect):
        return described
    label = robot.accelerometers[-1]
    sites = [
        site.replace("LABEL", label).replace("NODE", label[:-2]) for site in effect.sites if site.endswith(("L", "E"))
    ]
    tried = []
    for site in (*effect.fixed_sites(robot.axis_count), *sites):
        for values in effect.variants(robot, site, BAND_HZ):
            tried.append(_added(robot, effect, site, _of_either_sign(effect, values)))
    return max(tried, key=lambda example: _change(_frfs(example, COARSE)).max(), default=None)


def _of_either_sign(effect: Effect, values: Values) -> Values:
    """An error of either sign is usually none: some prior deviations of it instead."""
    first = effect.parameters[0]
    if np.any(np.asarray(values[first.name]) != first.null):
        return values
    size = first.null + LARGER * first.spread
    return {**values, first.name: [size] * first.length if first.length else size}


def _of_amplitude(robot: Robot, effect: Effect, swing: Swing) -> Example | None:
    """Of its usual size, at the gear of joint 2."""
    law, k = effect.amplitude_law, robot.axes[CARRIES].stiffness
    assert law is not None
    assert k is not None
    return _added(robot, effect, f"joint{CARRIES + 1}.z", law.entry(np.asarray(law.usual(k))))


def _leans(effect: Effect) -> bool:
    """Whether it turns the weight."""
    return type(effect).gravity is not Effect.gravity


def _of_drive(robot: Robot, effect: Effect, swing: Swing) -> Example | None:
    """Of the size that a search in a motion log takes for usual, at joint 2 where it can be."""
    if described := _described(robot, effect):
        return described
    if _leans(effect):
        (site,), first = effect.fixed_sites(robot.axis_count), effect.parameters[0]
        return _added(robot, effect, site, _of_either_sign(effect, {first.name: [first.null] * first.length}))
    sites = [site for site in effect.fixed_sites(robot.axis_count) if any(map(str.isdigit, site))] or ["log"]
    for site in sorted(sites, key=lambda site: str(CARRIES + 1) not in site):
        for suspected in effect.suspected(swing.of(effect, site)):
            values = dict(suspected.values)
            for k, prior in enumerate(suspected.own):
                if k in suspected.sizes or not suspected.sizes:
                    _put(values, prior.name, prior.mean + (0 if prior.log else prior.deviation))
            return _added(robot, effect, site, values)
    return None


FIND = {"frf": _of_structure, "loop": _of_amplitude, "torque": _of_drive}


def _put(values: dict[str, Any], name: str, value: float) -> None:
    name, _, index = name.partition("[")
    if index:
        values[name] = [value if k == int(index[:-1]) else item for k, item in enumerate(values[name])]
    else:
        values[name] = value


# --- figures ------------------------------------------------------------------------------------------------------

CAPTIONS = {
    "frf": "FRF of the flange in the milling posture with the effect and without it, in the channel that changes most.",
    "loop": "Torque of the joint over its deflection in slow swings of one, two and four times a size.",
    "torque": "Drive torque in a swing of all axes, with the effect and without it, and the difference over position "
    "and over speed.",
}


def _frfs(example: Example, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """FRFs (nf, nr, ne) between the accelerometers' points, without and with the effect, brakes off."""
    labels, found = example.with_it.accelerometers, []
    for robot in (example.without, example.with_it):
        linear = linearise(assemble(robot, robot.angles(POSTURE_DEG), brakes="off"))
        found.append(frf(linear, frequency, measurement_chain(linear, robot, labels, labels)))
    return found[0], found[1]


def _change(frfs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(nr, ne) relative change of each channel pair."""
    return np.asarray(np.linalg.norm(frfs[1] - frfs[0], axis=0) / np.linalg.norm(frfs[0], axis=0))


def _frf(example: Example) -> Figure:
    labels = example.with_it.accelerometers
    found = _frfs(example, FREQUENCY)
    i, j = np.unravel_index(np.argmax(_change(found)), (len(labels), len(labels)))
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": (3, 1)})
    for H, style, label in zip(found, (WITHOUT, WITH), ("without", f"with {example.title}"), strict=True):
        upper.semilogy(FREQUENCY, np.abs(H[:, i, j]), label=label, **style)
        lower.plot(FREQUENCY, phase_deg(H[:, i, j]), **style)
    upper.set_ylabel("accelerance, m/(s²·N)")
    lower.set_ylabel("phase, °")
    lower.set_yticks([-180, 0, 180])
    lower.set_xlabel("frequency, Hz")
    lower.set_xlim(FREQUENCY[0], FREQUENCY[-1])
    upper.set_title(f"{labels[i]}/{labels[j]}", loc="left", fontsize=9)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False, fontsize=9)
    _plain(upper, lower)
    return figure


def _loop(example: Example) -> Figure:
    """The static law: what spring and law carry while the joint swings slowly, and what the law adds."""
    law = CATALOGUE[example.entry.effect].amplitude_law
    k = example.with_it.axes[example.axis].stiffness
    assert law is not None
    assert k is not None
    law, sizes = law.described(example.values)
    swings = USUAL_DEFLECTION * np.array([0.5, 1.0, 2.0])
    x = np.sin(np.linspace(0, 4 * np.pi, 4001))[:, None] * swings
    state, added = law.state(len(swings)), []
    for deflection in x:
        beside, state = law.torque(deflection, np.full(len(swings), k), sizes[:, None], state)
        added.append(beside)
    last = slice(len(x) // 2, None)
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for each in (2, 1, 0):
        style = {"color": SWINGS[each], "linewidth": WITH["linewidth"], "label": f"± {1e3 * swings[each]:.3g} mrad"}
        left.plot(1e3 * x[last, each], (k * x + added)[last, each], **style)
        right.plot(1e3 * x[last, each], np.array(added)[last, each], **style)
    left.plot(1e3 * x[last, 2], k * x[last, 2], label="without", **WITHOUT)
    left.set_ylabel("torque of spring and law, N·m")
    right.set_ylabel("torque of the law, N·m")
    for ax in (left, right):
        ax.set_xlabel("deflection, mrad")
    left.set_title(example.title, loc="left", fontsize=9)
    left.legend(frameon=False, fontsize=9)
    _plain(left, right)
    return figure


def _torque(example: Example) -> Figure:
    motion = _swing(example.with_it)
    without, with_it = (
        recorded_torque(robot, motion.time, inverse_dynamics(robot, replace(motion)))
        for robot in (example.without, example.with_it)
    )
    added = with_it - without
    axis = int(np.argmax(np.sqrt(np.mean(added**2, axis=0))))
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    axes = figure.subplot_mosaic([["time", "time"], ["position", "speed"]])
    axes["time"].plot(motion.time, without[:, axis], label="without", **WITHOUT)
    axes["time"].plot(motion.time, with_it[:, axis], label=f"with {example.title}", **WITH)
    axes["time"].set_xlabel("time, s")
    axes["time"].set_ylabel(f"torque of joint {axis + 1}, N·m")
    figure.legend(
        *axes["time"].get_legend_handles_labels(), loc="outside upper left", ncols=2, frameon=False, fontsize=9
    )
    axes["position"].plot(np.degrees(motion.position[:, axis]), added[:, axis], color=WITH["color"], linewidth=1)
    axes["position"].set_xlabel(f"position of joint {axis + 1}, °")
    axes["position"].set_ylabel("difference, N·m")
    axes["speed"].plot(motion.velocity[:, axis], added[:, axis], color=WITH["color"], linewidth=1)
    axes["speed"].set_xlabel(f"speed of joint {axis + 1}, rad/s")
    axes["speed"].set_ylabel("difference, N·m")
    _plain(*axes.values())
    return figure


DRAW = {"frf": _frf, "loop": _loop, "torque": _torque}


def _swing(robot: Robot) -> Motion:
    """All axes swing about the posture, each at two frequencies of its own, and come to rest at the ends."""
    time = np.arange(0.0, SWING_S, 1 / RATE_HZ)
    window = np.sin(np.pi * time / SWING_S) ** 2
    waves = [np.sin(2 * np.pi * f * time) + 0.4 * np.sin(2 * np.pi * 2.3 * f * time) for f in (0.3, 0.4, 0.5)]
    centre = robot.angles([POSTURE_DEG[0], 85.0, POSTURE_DEG[2]])
    position = centre + SWING_RAD * (window * np.array(waves)).T
    return motion_of(MotionRun("swing", time, position, RATE_HZ))


def _plain(*axes: Axes) -> None:
    for ax in axes:
        ax.grid(True, which="major", color="#e3e6ea", linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8.5)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def write(folder: Path) -> None:
    """All pages and pictures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "index.md").write_text(index())
    for name, page, figures in pages():
        (folder / f"{name}.md").write_text(page)
        for file, figure in figures.items():
            save(figure, folder / file)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    write(parser.parse_args().folder)
