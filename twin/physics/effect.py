"""What one effect states: its law, where it can act, its parameters, and how it is written into the model.

A new effect is one new file with one subclass of :class:`Effect`, listed in ``twin/physics/__init__.py``.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from twin.physics.statements import LinearPart, LogView, Part, Prior, Suspected, Test
from twin.ranges import implausible

if TYPE_CHECKING:
    from twin.physics.chain import MeasurementChain
    from twin.physics.doubt import Weight
    from twin.physics.joint_law import Law
    from twin.physics.motion import Motion
    from twin.robot.description import Robot
    from twin.robot.mechanism import Mechanism

MOST_ELEMENTS = 100  # of a list, as springs in parallel or coefficients of a formula
UNIT_VECTORS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

Values = Mapping[str, Any]
"""The parameters of one entry: name → number, list of numbers or word."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: as in the robot description.
        unit: SI unit; ``"1"`` where there is none.
        null: the value at which the model is the one without the effect (``inf`` for a rigid spring).
        length: 0 for a number, ``n`` for a list of n numbers, -1 for a list of any length.
        optional: may be left out of an entry (it then takes ``null``).
        positive: must be greater than zero.
        nonnegative: must not be less than zero. With neither, any finite number will do.
        scale: a fit seeks its logarithm, though an entry may hold numbers of either sign.
        word: a word, not a number (an axis letter, a joint).
        spread: prior standard deviation about the typical value when the entry is suspected: of the logarithm where the
            parameter cannot be negative, else in ``unit``; 0 leaves it at the typical value.
    """

    name: str
    unit: str
    null: float = 0.0
    length: int = 0
    optional: bool = False
    positive: bool = False
    nonnegative: bool = False
    scale: bool = False
    word: bool = False
    spread: float = 0.0

    @property
    def log(self) -> bool:
        """A scale, whose prior is log-normal."""
        return self.positive or self.nonnegative or self.scale

    def check(self, value: object) -> str | None:
        """Why ``value`` cannot be this parameter, or ``None`` when it can."""
        if self.word:
            return None if isinstance(value, str | int) and value != "" else f"expected a word, found {value!r}"
        items = value if self.length and isinstance(value, list | tuple) else [value]
        if self.length and not isinstance(value, list | tuple):
            return f"expected a list of numbers, found {value!r}"
        if self.length > 0 and len(items) != self.length:
            return f"expected {self.length} numbers, found {len(items)}"
        if len(items) > MOST_ELEMENTS:
            return f"expected at most {MOST_ELEMENTS} numbers, found {len(items)}"
        for item in items:
            if isinstance(item, bool) or not isinstance(item, int | float) or not np.isfinite(item):
                return f"expected a finite number [{self.unit}], found {item!r}"
            if self.positive and item <= 0:
                return f"expected a number > 0 [{self.unit}], found {item!r}"
            if self.nonnegative and item < 0:
                return f"expected a number ≥ 0 [{self.unit}], found {item!r}"
            if problem := implausible(item, self.unit, self.positive):
                return problem
        return None


@dataclass(frozen=True)
class Companion:
    """A rival that mechanics names.

    Attributes:
        effect, site: as in a diagnosis; effect ``parameter`` for a number of the description (``link3.mass``).
        values: where its search starts; ``None`` for what is typical of it.
    """

    effect: str
    site: str
    values: Values | None = None


class Effect:
    """One entry of the vocabulary. Subclasses are stateless; the values live in the robot description.

    Attributes:
        name: identifier in robot descriptions, ``--without`` and diagnoses.
        sites: where it can act; ``{i}`` stands for every axis or link number, ``LABEL`` and ``NODE`` for a channel.
        parameters: in the order of the vocabulary.
        seen_in: the kinds of recording that can show it.
        order: entries are applied by increasing order: 0 shapes the tree, 1 hangs bodies on it, 2 acts on
            joints, 3 acts on what the others added.
        sprung: it adds one coordinate, named like the site, with its ``stiffness`` and ``damping``.
        at_drive: its torque is of the drive's own rotor: where other axes turn that too, it acts on all of them.
        role: what its torque law is part of: ``"load"`` goes through the gear, ``"friction"`` is what load and
            warm-up act on, ``"drive"`` is neither.
        repeatable: several entries may stand at one site.
        lever: the parameter that says where its ``mass`` hangs.
        hinge: its spring is a coordinate of a joint and its numbers are named like the joint's own
            (``joint1.x.stiffness``).
        adds_mode: it brings a mode of its own, which a modal table may leave out.
        sizes: prior deviations of the first scale from which a search far from the truth starts, towards null.
        nodes: fewest nodes with sensors at which it can be told from what is always there.
        ridged: there are ridges between its sizes: near the truth too, first order from none finds no way to them.

    Of motion logs:

    Attributes:
        part: what it is to a drive, where the engine has to write such an entry or take one into account.
        steps: its torque may step where an axis turns back.
        refers: its torque is made of the other torques (load, friction, or all that is recorded).
        linear: its torque is in proportion to its sizes; else only near where a search starts.
        linear_in: parameters in which the torque is linear, whatever the others are: the regressor's columns. The
            torque of an effect without such parameters is taken as described.
        least_zero: of these, the ones that no real robot has below zero.
        leaning: where a joint turns less than once its torque comes near a constant.
        doubt: relative standard deviation of a described number of these.
        doubted: its described numbers, all together, may be off far beyond that.
        refines: the part that it is in a limit. Where there is none, that comes first if it does most of the work.
        memory: it holds its torque through a standstill, as slip does.
        fades_over: the parameter that is the speed over which it fades, for friction that is largest at rest.
        ages: it is a law of the clock: runs kept aside do not hold the same hour.
        waves: its torque is a wave over the joint's angle, for which a vibration in time may pass.
        elements: parameters that are lists of elements in parallel, of which a find may bear more than one.
        profiled: the parameter whose interval is found by fits on either side: slopes know little of it.
        log_tests: recordings that show it, for the next test.
        ordinary: why it is not looked for by its name: each joint has it, and the base model fits it.
        amplitude_law: what it adds to the spring of a joint; required with ``"levels"`` in ``seen_in``.
    """

    name: ClassVar[str]
    sites: ClassVar[tuple[str, ...]]
    parameters: ClassVar[tuple[Parameter, ...]]
    seen_in: ClassVar[frozenset[Literal["hammer", "levels", "log"]]]
    order: ClassVar[int] = 2
    at_drive: ClassVar[bool] = False
    role: ClassVar[Literal["load", "friction", "drive"]] = "drive"
    repeatable: ClassVar[bool] = False
    sprung: ClassVar[bool] = False
    hinge: ClassVar[bool] = False
    lever: ClassVar[str] = ""
    adds_mode: ClassVar[bool] = False
    sizes: ClassVar[tuple[float, ...]] = (-2.5, -1.0, 1.0)
    nodes: ClassVar[int] = 0
    ridged: ClassVar[bool] = False

    # motion logs
    part: ClassVar[Part] = ""
    steps: ClassVar[bool] = True
    refers: ClassVar[bool] = False
    linear: ClassVar[bool] = True
    linear_in: ClassVar[tuple[str, ...]] = ()
    least_zero: ClassVar[tuple[str, ...]] = ()
    leaning: ClassVar[bool] = False
    doubt: ClassVar[float] = 0.5
    doubted: ClassVar[bool] = False
    refines: ClassVar[Part] = ""
    memory: ClassVar[bool] = False
    fades_over: ClassVar[str] = ""
    ages: ClassVar[bool] = False
    waves: ClassVar[bool] = False
    elements: ClassVar[tuple[str, ...]] = ()
    profiled: ClassVar[str] = ""
    log_tests: ClassVar[tuple[Test, ...]] = ()
    ordinary: ClassVar[str] = ""
    # --- force levels: an effect seen in them states its law of amplitude
    amplitude_law: ClassVar["Law | None"] = None

    def check(self, values: Values) -> str | None:
        """What is wrong with the parameters taken together, or ``None``."""
        return None

    def check_axes(self, values: Values, axes: int) -> str | None:
        """Why the values do not fit a robot of so many axes, or ``None``."""
        return None

    def doubts(self, robot: "Robot", site: str, values: Values, weight: "Weight") -> list[tuple[str, str]]:
        """Parameter and question: values that are possible, and hardly meant on a robot of that weight."""
        return []

    def unit(self, name: str, site: str, robot: "Robot") -> str:
        """Of a parameter at a site, or of one number of a list (``friction[1]``)."""
        name, _, index = name.partition("[")
        units = next(p.unit for p in self.parameters if p.name == name).split(", ")
        return unit_at(units[int(index[:-1])] if index and len(units) > 1 else units[0], site, robot)

    def complete(self, robot: "Robot", site: str, given: Values) -> Values:
        """The parameters as given, with those filled in that an entry leaves to the rest of the description."""
        return given

    def nearest(self, robot: "Robot", site: str, values: dict[str, Any]) -> dict[str, Any]:
        """Fitted values as the rest of the description allows them; the same by default."""
        return values

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        """Write the entry into the mechanism, with native MuJoCo elements wherever they exist.

        The default is for effects that MuJoCo does not express: a torque law becomes a passive force, which a replay
        evaluates at every step. Without a torque law nothing is written.
        """
        if self.has_torque:
            mechanism.passive_force(self.name, site, values)

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        """What the entry adds to the recorded drive torque.

        Args:
            motion: the state of all axes over time.
            site: where it acts.
            values: the entry's parameters.

        Returns:
            Zero-based axis → torque (nt,) in N·m at the gear output (N on a linear axis). Empty by default.
        """
        return {}

    def felt(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        """:meth:`torque` as the axes bear it, or the drives, whichever the motion is of, where a coupling turns them.

        What a drive carries follows its rotor, all else its axis.
        """
        own = motion.of_drives if self.at_drive else motion.of_axes
        return motion.spread(self.torque(own, site, values), self.at_drive)

    def record(self, chain: "MeasurementChain", site: str, values: Values) -> None:
        """Change how the motion is recorded (gains, delays, directions). The default changes nothing."""

    def encoder_zero(self, site: str, values: Values) -> dict[int, float]:
        """Zero-based axis → how far it is from where its encoder says, rad (m). Empty by default."""
        return {}

    def gravity(self, gravity: np.ndarray, site: str, values: Values) -> np.ndarray:
        """Gravity (3,) in the frame of the base with the entry, m/s²; the same by default."""
        return gravity

    def typical(self, robot: "Robot", site: str) -> dict[str, Any] | None:
        """What the entry would ordinarily be, in the centre of its prior; ``None`` where it is not looked for.

        Parameters of either sign are centred on no effect at all.
        """
        return None

    def deviation(self, robot: "Robot", site: str, parameter: "Parameter", item: int) -> float:
        """Prior deviation of a number, or of an ``item`` of a list, at a site; what is usual anywhere by default."""
        return parameter.spread

    def given_size(self, robot: "Robot", site: str, size: float) -> dict[str, float]:
        """Usual values of other numbers of an entry whose first parameter is ``size``; of those that depend on it."""
        return {}

    def tolerances(self, robot: "Robot") -> dict[str, float]:
        """By how much its parameters may be off null without a finding, one standard deviation; none by default."""
        return {}

    def leaves_open(self, robot: "Robot", site: str) -> dict[str, dict[str, float]]:
        """``EFFECT@SITE`` → how large its parameters may be, one standard deviation, and still be a part of this one.

        A law that simplifies says so here; what it leaves open is then no second finding beside it.
        """
        return {}

    def variants(self, robot: "Robot", site: str, band_hz: tuple[float, float]) -> list[dict[str, Any]]:
        """Parameters to start a search from, where one typical entry is not enough (a frequency, an axis)."""
        typical = self.typical(robot, site)
        return [] if typical is None else [typical]

    # --- hammer tests -------------------------------------------------------------------------------------------------

    def shown_by(self, brakes: Iterable[str | None]) -> bool:
        """Whether a hammer test could show it, of the brakes' state in every posture ("on", "off" or unknown)."""
        return True

    def companions(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """What it is hard to tell from by mechanics and is judged beside it in any case."""
        return []

    def behind(self, robot: "Robot", number: str) -> list[Companion]:
        """What of this effect may be behind a number of the description that seems off, as ``link5.inertia``."""
        return []

    def parts(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """Simpler things that together do what it does where a recording does not show the rest of it.

        Their values are those that follow from its own.
        """
        return []

    def merged(self, robot: "Robot", site: str, values: Values, other: str, place: str) -> list[Companion]:
        """What it may be as one thing with an ``other`` effect at a ``place``, instead of the two."""
        return []

    def fuller(self, robot: "Robot", site: str, values: Values) -> list[Companion]:
        """The same thing with optional parameters that its ``values`` do not have."""
        return []

    # ------------------------------------------------------------------------------------------------------------------

    def carrier(self, robot: "Robot", site: str) -> int | None:
        """Zero-based link of which the entry's ``mass`` at ``com`` is rigidly a part; ``None`` for anything else."""
        return None

    def unstated(self) -> str | None:
        """What the effect would have to state for a kind of recording in its ``seen_in``; ``None`` where nothing lacks.

        An effect that a recording is said to show and that changes nothing there would be passed over in silence.
        """
        own, base = type(self), Effect
        if not self.sites or not self.parameters:
            return "expected at least one site and one parameter"
        if not self.seen_in <= {"hammer", "levels", "log"}:
            return f"seen_in: expected hammer, levels or log, found {', '.join(sorted(self.seen_in))}"
        written = own.write is not base.write or own.encoder_zero is not base.encoder_zero
        if "hammer" in self.seen_in and not written and own.record is base.record:
            return "seen_in hammer: expected a method write (into the mechanism) or record (of the measurement)"
        if "hammer" in self.seen_in and own.typical is base.typical and own.variants is base.variants:
            return "seen_in hammer: expected a method typical, from which a search starts"
        lacking = self._unstated_in_logs() if "log" in self.seen_in else None
        return lacking or (self._amplitude_unstated() if "levels" in self.seen_in else None)

    # --- force levels ------------------------------------------------------------------------------------------------

    def _amplitude_unstated(self) -> str | None:
        """The same of force levels."""
        law = self.amplitude_law
        if law is None:
            return "seen_in levels: expected an amplitude_law"
        if law.effect != self.name:
            return f"amplitude_law.effect: expected {self.name!r}, found {law.effect!r}"
        if set(self.sites) != {"joint{i}.z"}:
            return f"sites: expected joint{{i}}.z, where laws of amplitude act, found {', '.join(self.sites)}"
        return None

    @property
    def changes_robot(self) -> bool:
        """Whether it is physics of the robot, and not of how that is recorded alone."""
        own = type(self)
        recorded = own.record is not Effect.record or own.encoder_zero is not Effect.encoder_zero
        return not recorded or own.write is not Effect.write

    # --- motion logs -----------------------------------------------------------------------------------------------

    @property
    def has_torque(self) -> bool:
        """Whether it states a torque law."""
        return type(self).torque is not Effect.torque

    @property
    def records_torque(self) -> bool:
        """Whether it acts on the recorded torque as a whole, whichever laws that is the sum of."""
        return "log" in self.seen_in and type(self).record is not Effect.record

    def _unstated_in_logs(self) -> str | None:
        if self.ordinary or self.part == "play":  # looked for in their own way
            return None
        if not (self.has_torque or self.records_torque or type(self).weight is not Effect.weight):
            return "seen_in log: expected a method torque (of the drives), record or weight"
        first = self.parameters[0]
        if type(self).suspected is Effect.suspected and (first.word or first.length):
            return f"seen_in log: expected a number as first parameter, or a method suspected; found {first.name}"
        return None

    def suspected(self, view: LogView) -> list[Suspected]:
        """The ways in which it may be missing at a site of a motion log; none where it cannot be.

        By default the first parameter is the size, and has a normal prior about no effect, as wide as a usual torque at
        the site's axis. The others start from :meth:`variants`, those that have a ``spread`` are fitted, too.
        """
        first, *others = self.parameters
        variants = self.variants(view.robot, view.site, (0.0, view.highest_hz))
        if not variants and others:
            return []
        centre = dict(variants[0]) if variants else {}
        typical = float(centre.get(first.name, first.null))
        unit = typical if typical != first.null else first.null + 1.0
        own = [Prior(first.name, abs(unit - first.null) * view.size({**centre, first.name: unit}), first.null)]
        free = [p for p in others if p.spread and not p.length and not p.word]
        own += [Prior(p.name, p.spread, float(centre[p.name]), p.log) for p in free]
        starts = [[first.null, *(float(values[p.name]) for p in free)] for values in variants or [centre]]
        for k, p in enumerate(free, start=1):
            for sign in (-1, 1):
                start = list(starts[0])
                start[k] = start[k] * float(np.exp(sign * p.spread)) if p.log else start[k] + sign * p.spread
                starts.append(start)
        return [Suspected({**centre, first.name: first.null}, own, starts)]

    def canonical(self, values: np.ndarray) -> np.ndarray:
        """Own numbers (m,) of a suspect that mean the same in the form in which they are told."""
        return values

    def part_of_dry(self, values: Values, velocity: np.ndarray) -> float:
        """What of the entry, N·m (N), is in a joint's dry friction that was found without it.

        That is what friction is at rest by a parabola in speed; ``velocity`` (m,) is of the joint.
        """
        return 0.0

    def turning_under(self, values: Values, motion: "Motion", site: str, dry: float) -> np.ndarray:
        """Dry friction (nt,), N·m (N), that turns round beside ``dry``, the joint's own, by load or time."""
        return np.zeros(len(motion.time))

    def uneven(self, values: Values) -> float:
        """Friction, N·m (N), that does not change sign with the direction but is held at rest, too."""
        return 0.0

    def travel(self, elements: np.ndarray) -> np.ndarray:
        """Over which elements (k, numbers) turn round from one sense of motion to the other (k,), rad (m)."""
        return np.zeros(len(elements))

    def another(self, elements: np.ndarray, factor: float) -> np.ndarray:
        """One more element (numbers,) beside elements (k, numbers), of ``factor`` times the strongest's travel."""
        return elements[0]

    def linear_parts(self, values: Values) -> list[LinearPart]:
        """The numbers in which the torque of an entry is linear; by default those of ``linear_in``."""
        known = {parameter.name: parameter for parameter in self.parameters}
        none = {name: [0.0] * known[name].length if known[name].length else 0.0 for name in self.linear_in}
        parts = []
        for name in self.linear_in:
            parameter, floor = known[name], name in self.least_zero
            unit = [word.strip() for word in parameter.unit.split(",")]
            if not parameter.length:
                parts.append(LinearPart(name, unit[0], float(values[name]), {**values, **none, name: 1.0}, floor))
            for k in range(parameter.length):
                here = {**values, **none, name: np.eye(parameter.length)[k].tolist()}
                parts.append(
                    LinearPart(f"{name}[{k + 1}]", unit[min(k, len(unit) - 1)], float(values[name][k]), here, floor)
                )
        return parts

    def with_linear(self, values: Values, found: list[float]) -> dict[str, Any]:
        """The parameters of an entry whose linear parts have the values found, in their order."""
        known, out = {parameter.name: parameter for parameter in self.parameters}, {}
        at = 0
        for name in self.linear_in:
            parameter = known[name]
            items = found[at : at + (parameter.length or 1)]
            at += len(items)
            if parameter.nonnegative:
                items = [max(item, 0.0) for item in items]
            out[name] = items if parameter.length else items[0]
        return out

    def described_deviation(self, value: float, largest: float) -> float:
        """Prior standard deviation of a linear part as described, beside the ``largest`` of its entry."""
        return self.doubt * abs(value)

    def departure(self, values: Values, orders: int) -> np.ndarray:
        """What the law is off by: prior deviation (orders,) of sines and cosines of the joint's angle, N·m."""
        return np.zeros(orders)

    def weight(self, values: Values) -> dict[str, Any] | None:
        """``mass``, ``com`` and, if it has one, ``inertia`` of the body that it is along a rigid motion, if any."""
        return None

    def carried(
        self, motion: "Motion", site: str, values: Values, given: Values, drive: str, part: Part, amount: float
    ) -> dict[int, np.ndarray]:
        """What a drive's inertia or friction does beyond its own axis, through this entry: axis → torque (nt,).

        Args:
            motion: as in :meth:`torque`.
            site, values, given: of the entry; ``given`` without what is filled in from the rest of the description.
            drive: the joint of the drive.
            part: ``"inertia"``, ``"viscous"`` or ``"dry"``.
            amount: in SI units at the gear output.
        """
        return {}

    def spins(self, site: str, values: Values) -> tuple[int, int, float]:
        """Drive, axis (zero-based) and ratio: how much faster the drive turns per speed of the axis; 0 by default."""
        return 0, 0, 0.0

    def shared_dry(self, values: Values) -> tuple[str, float]:
        """The joint of a drive whose dry friction turns with two axes, and how much of it, N·m; none by default."""
        return "", 0.0

    # --- sites -----------------------------------------------------------------------------------------------------

    def is_site(self, site: str, axes: int) -> bool:
        """Whether ``site`` is one of this effect's sites on a robot with ``axes`` axes."""
        return any(_matches(pattern, site, axes) for pattern in self.sites)

    def fixed_sites(self, axes: int) -> Iterator[str]:
        """The sites that depend only on the number of axes (not those of channels)."""
        for pattern in self.sites:
            if "{i}" in pattern:
                yield from (pattern.replace("{i}", str(i + 1)) for i in range(axes))
            elif not _CHANNEL.search(pattern):
                yield pattern


_CHANNEL = re.compile("LABEL|NODE")


def _matches(pattern: str, site: str, axes: int) -> bool:
    expression = re.escape(pattern).replace(re.escape("{i}"), r"([1-9]\d*)")
    expression = expression.replace("LABEL", r"\d+[XYZ][+-]").replace("NODE", r"\d+")
    found = re.fullmatch(expression, site)
    return found is not None and all(int(number) <= axes for number in found.groups())


def axis_of(site: str) -> int:
    """Zero-based number of the axis or link named in a site: ``joint2.z`` → 1."""
    found = re.match(r"(?:joint|link)(\d+)", site)
    if not found:
        raise ValueError(f"no axis in site {site!r}")
    return int(found.group(1)) - 1


SLIDING = {
    "N·m": "N", "N·m/rad": "N/m", "N·m/rad³": "N/m³", "N·m·s/rad": "N·s/m", "kg·m²": "kg", "rad": "m", "rad/s": "m/s",
}  # fmt: skip


def unit_at(unit: str, site: str, robot: "Robot") -> str:
    """The unit at a site that turns or slides: ``N·m`` is N at a prismatic joint, ``N·m/rad or N/m`` is one of both."""
    turning, _, sliding = unit.partition(" or ")
    joint = re.fullmatch(r"joint(\d+)(\.z)?", site)
    slides = robot.axes[int(joint[1]) - 1].type == "prismatic" if joint else site in ("base.x", "base.y", "base.z")
    return (sliding or SLIDING.get(turning, turning)) if slides else turning


def usual_stiffness(robot: "Robot") -> float:
    """Geometric mean of the described joint stiffnesses, N·m/rad; 5 MN·m/rad where none is described."""
    known = [axis.stiffness for axis in robot.axes if axis.stiffness and axis.type == "revolute"]
    return float(np.exp(np.mean(np.log(known)))) if known else 5e6


def light_damping(stiffness: float) -> float:
    """Damping that gives a spring 1 % of critical at 15 Hz."""
    return 2 * 0.01 * stiffness / (2 * np.pi * 15.0)


def link_end(robot: "Robot", number: int) -> list[float]:
    """Where the next joint (for the last link, the flange) sits in the frame of a zero-based link, m."""
    if number + 1 == robot.axis_count:
        return [float(value) for value in robot.flange.position]
    from twin.robot.frames import axis_placement

    return [float(value) for value in axis_placement(robot.axes[number + 1], 0.0)[0]]
