"""The robot as validated data: links, axes, drives, flange, test points, and the list of physics entries.

The schema of ``robot.yaml``; its keys, units and defaults are the fields below. ``docs/robot.md`` explains them.
"""

import fnmatch
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    ValidationError,
    model_validator,
)

from twin.errors import InputError, tell
from twin.physics import CATALOGUE
from twin.physics.effect import Effect
from twin.ranges import (
    FARTHEST_M,
    FREE_TURNS,
    HEAVIEST_ROTOR,
    LARGEST_RELATIVE,
    LONGEST_LABEL,
    MOST_AXES,
    RANGES,
    STRONGEST_GRAVITY,
    illegible,
    implausible,
)
from twin.robot.frames import inertia_matrix
from twin.yamlfile import read_yaml, write_yaml


def _is_number(value: Any) -> Any:
    if isinstance(value, bool | str):
        raise ValueError(f"expected a number, found {value!r}")
    return value


def _within(unit: str, scale: bool = False) -> AfterValidator:
    def check(value: float) -> float:
        if problem := implausible(value, unit, scale):
            raise ValueError(problem)
        return value

    return AfterValidator(check)


def _legible(text: str) -> str:
    if problem := illegible(text):
        raise ValueError(problem)
    return text


def _near(value: float) -> float:
    if abs(value) > FARTHEST_M:
        raise ValueError(f"expected metres, up to {FARTHEST_M:g}, found {value:g}; these look like mm")
    return value


def _geared(value: float) -> float:
    if value == 0:
        raise ValueError("expected motor turns per joint turn, found 0; a drive without a gear has 1")
    return value


_Finite = Annotated[float, BeforeValidator(_is_number), Field(allow_inf_nan=False)]
Number = Annotated[_Finite, _within("")]
Positive = Annotated[_Finite, Field(gt=0), _within("", scale=True)]
NonNegative = Annotated[Number, Field(ge=0)]
Mass = Annotated[_Finite, Field(gt=0), _within("kg", scale=True)]
MassIfAny = Annotated[_Finite, Field(ge=0), _within("kg", scale=True)]
Relative = Annotated[Number, Field(ge=0, le=LARGEST_RELATIVE)]
Angle = Annotated[Number, Field(ge=-360, le=360)]  # degrees, of what is fixed
NonNegativeAngle = Annotated[Number, Field(ge=0, le=360)]
Length = Annotated[_Finite, _within("m")]
Place = Annotated[_Finite, AfterValidator(_near)]  # m, in a body's frame
Distance = Annotated[_Finite, Field(ge=0, le=FARTHEST_M)]
Name = Annotated[str, AfterValidator(_legible)]
Moment = Annotated[_Finite, _within("kg·m²")]
Stiffness = Annotated[_Finite, Field(gt=0), _within("N·m/rad", scale=True)]
Damping = Annotated[_Finite, Field(ge=0), _within("N·m·s/rad")]
Speed = Annotated[_Finite, Field(gt=0), _within("rad/s", scale=True)]
SpeedOfSheet = Annotated[_Finite, Field(gt=0), _within("°/s, m/s on a linear axis", scale=True)]
Acceleration = Annotated[_Finite, Field(gt=0), _within("rad/s²", scale=True)]
Torque = Annotated[_Finite, Field(gt=0), _within("N·m", scale=True)]
Density = Annotated[_Finite, Field(ge=1, le=25_000)]  # kg/m³: foam to osmium
Scale = Annotated[_Finite, Field(ge=1e-6, le=1e3)]  # of a mesh, to metres: µm to km
Ratio = Annotated[_Finite, AfterValidator(_geared), _within("motor turns per turn, rad/m on a linear axis", scale=True)]
Coupling = Annotated[_Finite, Field(ge=-1e3, le=1e3)]  # of drives, rad per rad or per m
Vector = tuple[Number, Number, Number]  # a direction
Position = tuple[Place, Place, Place]
Quaternion = tuple[Number, Number, Number, Number]
Inertia = tuple[Moment, Moment, Moment, Moment, Moment, Moment]


class Data(BaseModel):
    """Validated plain data: unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", validate_assignment=True)


class Placement(Data):
    """A frame in another: position in m, unit quaternion (w, x, y, z)."""

    position: Position = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _unit(self) -> Self:
        if abs(np.linalg.norm(self.quaternion) - 1) > 1e-6:
            raise ValueError("quaternion must have unit length, order w x y z")
        return self


def check_inertia(inertia: Sequence[float]) -> None:
    """Raise ``ValueError`` unless a body of positive mass can have this inertia at its centre of mass (kg·m²)."""
    principal = np.linalg.eigvalsh(inertia_matrix(inertia))
    if principal[0] <= 0:
        found = ", ".join(f"{moment:.6g}" for moment in principal)
        raise ValueError(f"inertia must be positive definite; its principal moments are {found} kg·m²")
    if principal[0] + principal[1] < principal[2] * (1 - 1e-9):
        low, middle, high = principal
        raise ValueError(f"inertia violates the triangle inequality: {low:.6g} + {middle:.6g} < {high:.6g} kg·m²")


def check_radius(mass: float, inertia: Sequence[float]) -> None:
    """Raise ``ValueError`` where mass (kg) would have to be farther away than a body reaches for its inertia."""
    far = float(np.sqrt(max(inertia[:3]) / mass))
    if far > FARTHEST_M:
        raise ValueError(
            f"inertia: expected that of {mass:g} kg within {FARTHEST_M:g} m, found a radius of {far:.3g} m"
        )


class Base(Placement):
    """The foot, frame ``base``; ``position`` and ``quaternion`` place the first axis's reference frame in it.

    Its mass takes part only in ``base_compliance``; inertia (xx, yy, zz, xy, xz, yz) at the com, kg·m².
    """

    mass: MassIfAny = 0.0
    com: Position = (0.0, 0.0, 0.0)
    inertia: Inertia = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    mesh: str | None = None
    collision: str | None = None

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if any(self.inertia):
            check_inertia(self.inertia)
            if self.mass:
                check_radius(self.mass, self.inertia)
        return self


class Link(Data):
    """A rigid link in its modified-DH frame: mass kg, com m, inertia (xx, yy, zz, xy, xz, yz) at the com, kg·m².

    A link given only by a ``mesh`` (STL, OBJ, DAE; metres after ``mesh_scale``) and a ``density`` (kg/m³) or a
    ``mass`` gets the rest from the mesh. ``collision`` is the shape that other programs test for contact, in metres.
    """

    name: Name | None = None
    mass: Mass | None = None
    com: Position | None = None
    inertia: Inertia | None = None
    mesh: str | None = None
    mesh_scale: Scale = 1.0
    collision: str | None = None
    density: Density | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.inertia is not None:
            check_inertia(self.inertia)
        if self.inertia is not None and self.mass is not None:
            check_radius(self.mass, self.inertia)
        given = (self.com is not None) + (self.inertia is not None)
        if given == 1 or (given == 2 and self.mass is None):
            raise ValueError("give mass, com and inertia together, or a mesh with a density or a mass")
        if given == 0 and (self.mesh is None or (self.mass is None) == (self.density is None)):
            raise ValueError("needs mass, com and inertia, or a mesh with either a density or a mass")
        return self

    @property
    def inertial(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass kg, centre of mass (3,) m, inertia at it (3, 3) kg·m², once a mesh's share is worked out."""
        if self.mass is None or self.com is None or self.inertia is None:
            raise ValueError("the link is given by a mesh that has not been read; use load_robot")
        return self.mass, np.array(self.com), inertia_matrix(self.inertia)


class Limits(Data):
    """Position (lower, upper) rad or m; largest speed rad/s or m/s, acceleration rad/s² or m/s², torque N·m or N."""

    position: tuple[Length, Length] | None = None
    velocity: Speed | None = None
    acceleration: Acceleration | None = None
    torque: Torque | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.position is not None and self.position[0] >= self.position[1]:
            raise ValueError(f"position limits must increase, found {list(self.position)}")
        return self


class Axis(Data):
    """An axis in modified (Craig) DH: Rx(alpha) Tx(a) Rz(theta) Tz(d) from the frame before it.

    The position q is added to theta (revolute) or d (prismatic). ``stiffness`` (N·m/rad or N/m) and ``damping``
    (N·m·s/rad or N·s/m) are the gear's, about (along) z; without a stiffness the axis is rigid. ``bearing`` is where on
    z the bearing tilts, m from the origin of the link's frame.
    """

    type: Literal["revolute", "prismatic"] = "revolute"
    name: Name | None = None
    alpha_deg: Angle = 0.0
    a: Place = 0.0
    theta_deg: Angle = 0.0
    d: Place = 0.0
    bearing: Place = 0.0
    limits: Limits | None = None
    stiffness: Stiffness | None = None
    damping: Damping = 0.0


class Drive(Data):
    """The motor of an axis: ``gear_ratio`` (motor turns per joint turn; rad/m on a linear axis), rotor inertia kg·m².

    ``rotor_mass`` (kg) sits on the axis, on the link before it; 0 where that link's mass already holds the motor.
    ``coupling`` names axes that turn this motor too: {joint5: 1.0} means motor position/ratio = q_this + 1.0 q₅.
    """

    gear_ratio: Ratio = 1.0
    rotor_inertia: Annotated[Moment, Field(ge=0, le=HEAVIEST_ROTOR)] = 0.0
    rotor_mass: MassIfAny = 0.0
    coupling: dict[str, Coupling] = {}
    mesh: str | None = None


class TestPoint(Data):
    """A hammer or accelerometer point: channel label as in UFF58, body frame, position m, unit direction with sign."""

    __test__ = False  # not a test case

    label: str
    body: str
    position: Position
    direction: Vector

    @model_validator(mode="after")
    def _unit(self) -> Self:
        length = float(np.linalg.norm(self.direction))
        if abs(length - 1) > 1e-3:
            raise ValueError(f"direction must be a unit vector, its length is {length:.4g}")
        return self


class Entry(BaseModel):
    """One physics entry: an effect at a site, with its parameters."""

    model_config = ConfigDict(extra="allow")
    effect: str
    site: str

    @model_validator(mode="before")
    @classmethod
    def _stated(cls, data: Any) -> Any:
        """Without the keys that a file leaves empty: they say what leaving them out says."""
        return {k: v for k, v in data.items() if v is not None} if isinstance(data, Mapping) else data

    @property
    def values(self) -> dict[str, Any]:
        """The parameters, defaults filled in."""
        return _filled(self.effect, self.model_extra or {})


def _filled(effect: str, given: Mapping[str, Any]) -> dict[str, Any]:
    found = {name: value for name, value in given.items() if value is not None}
    for parameter in CATALOGUE[effect].parameters:
        if parameter.optional and parameter.name not in found:
            found[parameter.name] = [parameter.null] * parameter.length if parameter.length > 0 else parameter.null
    return found


class Prior(Data):
    """Log-normal prior on parameters: one standard deviation is ×/÷ ``factor`` about the described value.

    ``parameter`` may hold ``*``: ``joint*.z.stiffness``. The last that matches counts.
    """

    parameter: str
    factor: Annotated[Number, Field(gt=1, le=1e6)]
    source: str = ""


def _names_a_number(pattern: str, axes: int) -> bool:
    """Whether a prior's parameter is a joint's spring or damper, or any number of an effect that there is."""
    effect, at, number = pattern.partition("@")
    if not at:
        elastic = ("stiffness", "damping", "loss_factor")
        springs = [f"joint{i}.{c}.{q}" for i in range(1, axes + 1) for c in "zxy" for q in elastic]
        return bool(fnmatch.filter(springs, pattern))
    numbers = {p.name for name in fnmatch.filter(CATALOGUE, effect) for p in CATALOGUE[name].parameters}
    return bool(fnmatch.filter(numbers, number.rpartition(".")[2].partition("[")[0]))


class Tolerances(Data):
    """One standard deviation of what a description can be wrong by."""

    mass: Relative = 0.03  # relative
    com: Distance = 0.01  # m
    inertia: Relative = 0.03  # relative
    posture_deg: NonNegativeAngle = 0.2
    channel_gain: Relative = 0.01  # relative
    length: Distance = 0.001  # m, of axes
    angle_deg: NonNegativeAngle = 0.1  # twists of axes, zeros of joints, direction of gravity
    position: Distance = 0.005  # m, of sensors and blows
    direction_deg: NonNegativeAngle = 0.1  # of sensors and blows
    torque_gain: Relative = 0.01  # relative, common to all joints
    gear_ratio: Relative = 0.001  # relative


class Assumed(Data):
    """A number or statement of the description that nobody measured.

    ``tolerance``: one standard deviation as a factor (1.5 is ×/÷ 1.5). ``settled_by``: the kind of test that would
    replace it.
    """

    field: str
    value: Number | list[Number] | str
    unit: str = ""
    tolerance: Annotated[Number, Field(ge=1)] | None = None
    source: str
    settled_by: str = ""


class Workspace(Data):
    """Box the flange must stay in, m, in the base frame."""

    x: tuple[Length, Length]
    y: tuple[Length, Length]
    z: tuple[Length, Length]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in ("x", "y", "z"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name} must increase, found {[low, high]}")
        return self


class Robot(Data):
    """A serial chain of revolute or prismatic axes, and the physics modelled beyond links, drives and z-springs."""

    name: Name
    description: str = ""
    gravity: Vector = (0.0, 0.0, -9.81)
    total_mass: Mass | None = None
    base: Base = Base()
    links: list[Link] = Field(min_length=1)
    axes: Annotated[list[Axis], Field(max_length=MOST_AXES)]
    drives: list[Drive] = []
    flange: Placement = Placement()
    workspace: Workspace | None = None
    test_points: list[TestPoint] = []
    accelerometers: list[str] = []
    physics: list[Entry] = []
    priors: list[Prior] = []
    tolerances: Tolerances = Tolerances()
    assumed: list[Assumed] = []
    _path: Path | None = PrivateAttr(None)

    @property
    def path(self) -> Path | None:
        """The file it was loaded from."""
        return self._path

    def __repr__(self) -> str:
        """Its axes, mass and entries; all numbers are in ``model_dump()`` and in the file."""
        mass = sum(link.mass or 0.0 for link in self.links)
        sites: dict[str, list[str]] = {}
        for entry in self.physics:
            sites.setdefault(entry.effect, []).append(entry.site)
        lines = [f"robot {self.name}: {len(self.axes)} axes; links of {mass:.4g} kg in all"]
        return "\n  ".join([*lines, *(f"{effect} at {', '.join(where)}" for effect, where in sites.items())])

    __str__ = __repr__

    def __eq__(self, other: object) -> bool:
        """Whether both say the same, wherever they were read from."""
        return isinstance(other, Robot) and self.__dict__ == other.__dict__

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        n = len(self.axes)
        if (strength := float(np.linalg.norm(self.gravity))) > STRONGEST_GRAVITY:
            raise ValueError(f"gravity: expected m/s², up to {STRONGEST_GRAVITY:g}, found {strength:g}")
        if not self.drives:
            self.__dict__["drives"] = [Drive() for _ in range(n)]
        if not len(self.links) == n == len(self.drives):
            counts = f"{len(self.links)} links, {n} axes, {len(self.drives)} drives"
            raise ValueError(f"needs one link and one drive per axis, found {counts}")
        if not self.test_points:
            self.__dict__["test_points"] = self._flange_points()
            self.__dict__["accelerometers"] = [point.label for point in self.test_points]
        bodies = {"base", *(f"link{i + 1}" for i in range(n))}
        labels = [point.label for point in self.test_points]
        for k, point in enumerate(self.test_points):
            if not re.fullmatch(r"[0-9]+[XYZ][+-]", point.label) or len(point.label) > LONGEST_LABEL:
                found = reprlib.repr(point.label)
                raise ValueError(f"test_points[{k}].label: expected node, axis and sign as in 21Z+, found {found}")
            if point.body not in bodies:
                raise ValueError(
                    f"test_points[{k}].body: unknown body {point.body!r}; bodies are base, link1 … link{n}"
                )
            if point.label in labels[:k]:
                raise ValueError(f"test_points[{k}].label: {point.label!r} appears twice")
        for label in self.accelerometers:
            if label not in labels:
                raise ValueError(f"accelerometers: {label!r} is not the label of a test point")
            if self.accelerometers.count(label) > 1:
                raise ValueError(f"accelerometers: {label!r} appears twice")
        for i, drive in enumerate(self.drives):
            for name in drive.coupling:
                if name not in self.joint_names or name == f"joint{i + 1}":
                    raise ValueError(f"drives[{i}].coupling: {name!r} is not another joint of this robot")
        told = [prior.parameter for prior in self.priors]
        for k, prior in enumerate(self.priors):
            if prior.parameter in told[:k]:
                raise ValueError(f"priors[{k}].parameter: {prior.parameter!r} appears twice")
            if not _names_a_number(prior.parameter, n):
                text = f"{prior.parameter!r} names no number; expected one as joint1.z.stiffness or EFFECT@SITE.number"
                raise ValueError(f"priors[{k}].parameter: {text}")
        seen: set[tuple[str, str]] = set()
        for k, entry in enumerate(self.physics):
            check_entry(entry, n, f"physics[{k}]")
            if (entry.effect, entry.site) in seen and not CATALOGUE[entry.effect].repeatable:
                raise ValueError(f"physics[{k}]: {entry.effect} at {entry.site} appears twice")
            seen.add((entry.effect, entry.site))
        return self

    def _flange_points(self) -> list[TestPoint]:
        """Node 1 at the flange, along the axes of the last link: what a robot without test points is tested at."""
        body, position = f"link{len(self.axes)}", self.flange.position
        directions = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        return [
            TestPoint(label=f"1{letter}+", body=body, position=position, direction=direction)
            for letter, direction in zip("XYZ", directions, strict=True)
        ]

    @property
    def states_points(self) -> bool:
        """Whether test points are described: those of a robot without any say nothing of a recording."""
        return self.test_points != self._flange_points()

    @property
    def axis_count(self) -> int:
        """Number of axes n."""
        return len(self.axes)

    @property
    def joint_names(self) -> list[str]:
        """joint1 … jointN."""
        return [f"joint{i + 1}" for i in range(len(self.axes))]

    def angles(self, q_user: Iterable[float]) -> np.ndarray:
        """Joint positions (n,) in rad (m) from the user's degrees (metres on prismatic axes)."""
        return np.array(
            [np.deg2rad(v) if a.type == "revolute" else v for v, a in zip(q_user, self.axes, strict=True)],
            float,
        )

    def degrees(self, q: Iterable[float]) -> list[float]:
        """The user's degrees (metres on prismatic axes) from joint positions (n,) in rad (m)."""
        return [float(np.rad2deg(v)) if a.type == "revolute" else float(v) for v, a in zip(q, self.axes, strict=True)]

    def check_posture(self, q: Iterable[float], source: str = "posture", field: str = "q_deg") -> np.ndarray:
        """Joint positions (n,) as an array.

        Raises:
            InputError: wrong length, not finite, or outside the axes' limits.
        """
        q = np.array(list(q), float)
        if q.shape != (len(self.axes),):
            raise InputError(source, field, f"expected {len(self.axes)} values for robot {self.name}, found {q.size}")
        if not np.isfinite(q).all():
            raise InputError(source, field, "expected finite numbers")
        for i, (value, axis) in enumerate(zip(q, self.axes, strict=True)):
            most = 2 * np.pi * FREE_TURNS if axis.type == "revolute" else RANGES["m"][1]
            own = axis.limits.position if axis.limits else None
            low, high = own or (-most, most)
            if not low - 1e-9 <= value <= high + 1e-9:
                show, unit = (np.rad2deg, "°") if axis.type == "revolute" else (float, " m")
                what = "its limits" if own else "what an axis moves"
                raise InputError(
                    source, f"{field}[{i}]",
                    f"joint{i + 1} at {show(value):.6g}{unit} is outside {what} "
                    f"{show(low):.6g} … {show(high):.6g}{unit}",
                )  # fmt: skip
        return q

    @property
    def encoder_zeros(self) -> np.ndarray:
        """How far (n,) the axes are from where their encoders say, rad (m)."""
        zeros = np.zeros(len(self.axes))
        for entry in self.physics:
            effect = CATALOGUE[entry.effect]
            if type(effect).encoder_zero is not Effect.encoder_zero:
                for axis, value in effect.encoder_zero(entry.site, entry.values).items():
                    zeros[axis] += value
        return zeros

    @property
    def coupling(self) -> np.ndarray:
        """C (n, n) of θ = C q: motor positions at the gear outputs from joint positions; then τ_q = Cᵀ τ_θ."""
        C = np.eye(len(self.axes))
        for i, drive in enumerate(self.drives):
            for name, ratio in drive.coupling.items():
                C[i, self.joint_names.index(name)] = ratio
        return C

    @property
    def felt_gravity(self) -> np.ndarray:
        """Gravity (3,) in the frame of the base as it stands, m/s²."""
        gravity = np.array(self.gravity, float)
        for entry in self.physics:
            effect = CATALOGUE[entry.effect]
            if type(effect).gravity is not Effect.gravity:
                gravity = effect.gravity(gravity, entry.site, entry.values)
        return gravity

    def values(self, entry: Entry) -> dict[str, Any]:
        """The parameters of an entry: as given, completed from the rest of the description, null where left out."""
        given = {name: value for name, value in (entry.model_extra or {}).items() if value is not None}
        completed = CATALOGUE[entry.effect].complete(self, entry.site, given)
        return _filled(entry.effect, completed)

    def scatter(self, field: str) -> float:
        """Standard deviation of the logarithm of a number that was assumed, from its tolerance; zero of any other."""
        return max((float(np.log(item.tolerance or 1.0)) for item in self.assumed if item.field == field), default=0.0)

    def rotor_scatter(self, number: int) -> float:
        """:meth:`scatter` of a zero-based drive's inertia as its joint feels it: times the square of the gear ratio."""
        drive = f"drives[{number}]"
        return float(np.hypot(self.scatter(f"{drive}.rotor_inertia"), 2 * self.scatter(f"{drive}.gear_ratio")))

    def without(self, removals: Iterable[str]) -> "Robot":
        """A copy without the entries named ``EFFECT`` or ``EFFECT@SITE``.

        Raises:
            InputError: an effect or site that does not exist. Naming an entry that is not there is no error.
        """
        entries = list(self.physics)
        for removal in removals:
            effect, _, site = removal.partition("@")
            try:
                _check_effect(effect)
                if "@" in removal:
                    _check_site(effect, site, len(self.axes))
            except ValueError as error:
                raise InputError("--without", removal, str(error)) from error
            entries = [e for e in entries if not (e.effect == effect and site in ("", e.site))]
        gone = {e.site for e in self.physics} - {e.site for e in entries}
        priors = [prior for prior in self.priors if prior.parameter.rpartition(".")[0] not in gone]
        return self.model_copy(update={"physics": entries, "priors": priors})


def check_entry(entry: Entry, axes: int, where: str) -> None:
    """Raise ``ValueError`` unless the entry names an effect, one of its sites and just its parameters."""
    try:
        _check_effect(entry.effect)
        _check_site(entry.effect, entry.site, axes)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    known = {parameter.name: parameter for parameter in CATALOGUE[entry.effect].parameters}
    given = entry.model_extra or {}
    for name in given:
        if name not in known:
            raise ValueError(f"{where}.{name}: unknown parameter; {entry.effect} takes {', '.join(known)}")
    for name, parameter in known.items():
        if given.get(name) is not None:
            if problem := parameter.check(given[name]):
                raise ValueError(f"{where}.{name}: {problem}")
            others = [f"joint{i + 1}" for i in range(axes) if f"joint{i + 1}" != entry.site]
            if parameter.unit == "joint" and given[name] not in others:
                raise ValueError(f"{where}.{name}: {given[name]!r} is not another joint of this robot")
        elif not parameter.optional:
            raise ValueError(f"{where}: {entry.effect} needs {name} [{parameter.unit}]")
    if problem := CATALOGUE[entry.effect].check(entry.values) or CATALOGUE[entry.effect].check_axes(entry.values, axes):
        raise ValueError(f"{where}.{problem}")


def _check_effect(effect: str) -> None:
    if effect not in CATALOGUE:
        near = get_close_matches(effect, CATALOGUE, n=1)
        raise ValueError(f"unknown effect {effect!r}; {f'did you mean {near[0]}?' if near else 'see docs/robot.md'}")


def _check_site(effect: str, site: str, axes: int) -> None:
    if not CATALOGUE[effect].is_site(site, axes):
        choices = ", ".join(CATALOGUE[effect].sites)
        raise ValueError(f"unknown site {site!r}; {effect} acts at {choices} (i = 1 … {axes})")


def parse_robot(data: dict[str, Any], source: str | Path = "robot") -> Robot:
    """Validate plain data as a robot description.

    Raises:
        InputError: one line that names the field.
    """
    try:
        return Robot.model_validate(data)
    except ValidationError as error:
        where, message = first_problem(error)
        raise InputError(source, where, message) from error


_SHAPES = {
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "string_type": "a word",
}


def first_problem(error: ValidationError) -> tuple[str, str]:
    """Field and message of the first problem that validation found, for one line."""
    first = error.errors()[0]
    place = first["loc"]
    if place and _is_type(place[-1]) and first["type"] != "extra_forbidden":
        place = place[:-1]
    where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        message = "unknown field"
    elif first["type"] == "missing":
        message = "missing"
    elif first["type"] in _SHAPES:
        message = f"expected {_SHAPES[first['type']]}, found {reprlib.repr(first['input'])}"
    elif first["type"] == "string_pattern_mismatch":
        message = f"found {reprlib.repr(first['input'])}, which has letters or signs that are not allowed there"
    elif first["type"] in ("too_long", "too_short"):
        few, many = (first["ctx"].get(f"{bound}_length") for bound in ("min", "max"))
        message = f"expected at {f'most {many}' if many else f'least {few}'}, found {len(first['input'])}"
    elif not first["msg"].startswith("Value error") and not isinstance(first["input"], dict | list):
        message = f"{message[0].lower()}{message[1:]}, found {reprlib.repr(first['input'])}"
    return where, message


def _is_type(part: int | str) -> bool:
    """Whether the end of a place is no field, but the validator's name of one of several types that would fit."""
    return isinstance(part, str) and re.fullmatch(r"str|(list|dict|tuple|literal|function-\w+)\[.*\]", part) is not None


SHIPPED = next(
    folder for folder in (Path(__file__).resolve().parents[level] / "mjcf" for level in (1, 2)) if folder.is_dir()
)
"""Folder of the shipped descriptions: inside an installed package, or at the top of a clone."""


def load_robot(name: "str | Path | Robot", relative_to: str | Path | None = None) -> Robot:
    """Load a shipped description (``kr90``), a ``robot.yaml`` or a URDF.

    Args:
        name: shipped name or path; a robot that is loaded already is returned as it is.
        relative_to: folder that a relative path is looked up in before the working folder.

    Raises:
        InputError: no such robot, or the file breaks the schema.
    """
    if isinstance(name, Robot):
        return name
    candidates = [Path(name)] if relative_to is None else [Path(relative_to) / name, Path(name)]
    path = next((candidate for candidate in candidates if candidate.is_file()), None)
    if path is None:
        if any(candidate.is_dir() for candidate in candidates):
            raise InputError(name, "", "is a folder; expected a robot.yaml or a URDF")
        path = SHIPPED / f"{name}.yaml"
        if Path(name).suffix or len(Path(name).parts) > 1 or not path.is_file():
            shipped = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.yaml")))
            kind = "file" if Path(name).suffix not in ("", ".yaml", ".urdf", ".xml") else "robot"
            raise InputError(name, "", f"no such {kind}; give a robot.yaml, a URDF or one of: {shipped}")
    if path.suffix.lower() in (".urdf", ".xml"):
        from twin.robot.urdf import import_urdf

        robot = import_urdf(path)
        robot._path = path
        return robot
    robot = parse_robot(read_yaml(path), path)
    robot._path = path
    meshes: list[Link | Drive | Base] = [*robot.links, *robot.drives, robot.base]
    for holder in meshes:
        for shape in ("mesh", "collision"):
            if (file := getattr(holder, shape, None)) is not None:
                holder.__dict__[shape] = str(_find_mesh(file, path))
    if any(link.inertia is None for link in robot.links) or robot.total_mass is not None:
        from twin.robot.mesh_inertia import complete_inertias

        complete_inertias(robot, path)
    from twin.robot.doubts import doubts

    for where, text in doubts(robot):
        tell(path, where, text)
    return robot


def _find_mesh(mesh: str, description: Path) -> Path:
    if Path(mesh).suffix.lower() not in (".stl", ".obj", ".dae"):
        raise InputError(description, "mesh", f"{mesh}: expected an STL, OBJ or DAE file")
    for folder in (description.parent, SHIPPED):
        if (folder / mesh).is_file():
            return (folder / mesh).resolve()
    raise InputError(description, "mesh", f"{mesh} not found beside the description")


def save_robot(path: str | Path, robot: Robot) -> None:
    """Write a description that :func:`load_robot` reads back, with every documented key present."""
    data = robot.model_dump(mode="json")
    for entry in data["physics"]:
        for parameter in CATALOGUE[entry["effect"]].parameters:
            entry.setdefault(parameter.name, None)
    for holder in (*data["links"], *data["drives"], data["base"]):
        for shape in ("mesh", "collision"):
            if holder.get(shape):
                mesh = Path(holder[shape])
                holder[shape] = str(mesh.relative_to(SHIPPED) if mesh.is_relative_to(SHIPPED) else mesh)
    write_yaml(path, data)
