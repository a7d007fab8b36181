"""A torque law found in data that no other effect explains: a formula of the motion, with its coefficients."""

import ast
import re
import reprlib
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import NumericalError
from twin.physics.effect import Effect, Parameter, Values, axis_of
from twin.physics.statements import LogView, Prior, Suspected
from twin.ranges import implausible

if TYPE_CHECKING:
    from twin.physics.motion import Motion
    from twin.robot.mechanism import Mechanism

LONGEST_FORMULA = 2000  # characters
DEEPEST_FORMULA = 40  # levels
FUNCTIONS = {"sin": np.sin, "cos": np.cos, "exp": np.exp, "tanh": np.tanh, "abs": np.abs}
_OPERATORS = {ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power}
_NAME = re.compile(r"([cqva]|load)([1-9]\d*)|t")


class Discovered(Effect):
    """Written as a passive force; there accelerations are zero.

    ``formula`` is arithmetic (+ − * / **) over numbers, the coefficients c1, c2 …, the state of any axis (q1 position,
    v1 velocity, a1 acceleration, load1 torque through the gear), t the campaign's clock in s, and sin, cos, exp, tanh,
    abs, sign.
    """

    name = "discovered"
    sites = ("joint{i}",)
    parameters = (Parameter("formula", "an expression", word=True), Parameter("coefficients", "N·m", length=-1))
    seen_in = frozenset({"log"})
    part = "law"
    log_tests = ("speeds",)
    order = 3
    repeatable = True

    def check(self, values: Values) -> str | None:
        formula = str(values["formula"])
        if len(formula) > LONGEST_FORMULA:
            return f"formula: expected at most {LONGEST_FORMULA} characters, found {len(formula)}"
        try:
            tree = ast.parse(formula.strip(), mode="eval").body
        except (SyntaxError, ValueError, MemoryError, RecursionError):
            return f"formula: {reprlib.repr(formula)} is not an expression"
        problem = _problem(tree, len(values["coefficients"]), DEEPEST_FORMULA)
        if problem:
            return f"formula: {problem}"
        used = max((int(name[2]) for name in _NAME.finditer(formula) if name[1] == "c"), default=0)
        if len(values["coefficients"]) > used:
            return f"coefficients: expected those of the formula, {used}, found {len(values['coefficients'])}"
        return None

    def check_axes(self, values: Values, axes: int) -> str | None:
        named = _NAME.finditer(str(values["formula"]))
        most = max((int(found[2]) for found in named if found[1] not in (None, "c")), default=0)
        return f"formula: expected axes 1 to {axes}, found {most}" if most > axes else None

    def write(self, mechanism: "Mechanism", site: str, values: Values) -> None:
        mechanism.passive_force(self.name, site, values)

    def suspected(self, view: LogView) -> list[Suspected]:
        """Friction that rises ever faster with speed, as of churned oil: a nameless rival to what falls with speed."""
        v = f"v{view.axis + 1}"
        law = {"formula": f"c1*abs({v})*{v}"}
        usual = Prior("coefficients[0]", view.size({**law, "coefficients": [1.0]}))
        return [Suspected({**law, "coefficients": [0.0]}, [usual], [[0.0]], passive=True)]

    def torque(self, motion: "Motion", site: str, values: Values) -> dict[int, np.ndarray]:
        with np.errstate(all="ignore"):
            torque = _compiled(str(values["formula"]))(motion, values["coefficients"])
        if not np.isfinite(torque).all():
            raise NumericalError(f"{self.name}@{site}", "formula", "is not finite in this motion; change the formula")
        return {axis_of(site): np.broadcast_to(np.asarray(torque, float), motion.time.shape).copy()}


def _problem(node: ast.AST, coefficients: int, levels: int) -> str | None:
    """Why a part of a formula, or what is in it, cannot be evaluated."""
    parts: list[ast.expr] = []
    match node:
        case _ if levels < 0:
            return f"expected at most {DEEPEST_FORMULA} levels"
        case ast.Name(id=name):
            found = _NAME.fullmatch(name)
            if not found:
                return f"unknown {name!r}; expected c1, q1, v1, a1, load1, t, {', '.join(FUNCTIONS)} or sign"
            if found[1] == "c" and int(found[2]) > coefficients:
                return f"{name} is missing among the coefficients"
        case ast.Constant(value=value):
            if isinstance(value, bool) or not isinstance(value, int | float) or implausible(value):
                return f"expected a plausible number, found {reprlib.repr(value)}"
        case ast.Call(func=function, args=[argument], keywords=[]):
            if not isinstance(function, ast.Name) or function.id not in (*FUNCTIONS, "sign"):
                return f"expected {', '.join(FUNCTIONS)} or sign before a bracket"
            parts = [argument]
        case ast.Call():
            return "a function takes one argument"
        case ast.BinOp(left=left, op=op, right=right):
            if type(op) not in _OPERATORS:
                return "expected + - * / or **"
            if isinstance(op, ast.Div) and isinstance(right, ast.Constant) and not right.value:
                return "divides by zero"
            parts = [left, right]
        case ast.UnaryOp(op=op, operand=operand):
            if not isinstance(op, ast.USub | ast.UAdd):
                return "expected + or - before a term"
            parts = [operand]
        case _:
            return f"expected arithmetic, found {type(node).__name__}"
    return next((problem for part in parts if (problem := _problem(part, coefficients, levels - 1))), None)


Law = Callable[["Motion", list[float]], Any]  # of a motion and coefficients


@lru_cache(maxsize=64)
def _compiled(formula: str) -> Law:
    """A formula as a function: time stepping evaluates it at every step."""
    return _law(ast.parse(formula.strip(), mode="eval").body)


def _law(node: ast.expr) -> Law:
    match node:
        case ast.Constant(value=value):
            number = float(value)  # type: ignore[arg-type]
            return lambda motion, c: number
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            inner = _law(operand)
            return lambda motion, c: -inner(motion, c)
        case ast.UnaryOp(operand=operand):
            return _law(operand)
        case ast.BinOp(left=left, op=op, right=right):
            first, second, operator = _law(left), _law(right), _OPERATORS[type(op)]
            return lambda motion, c: operator(first(motion, c), second(motion, c))
        case ast.Call(func=ast.Name(id="sign"), args=[argument]):
            inner = _law(argument)
            return lambda motion, c: motion.sign(inner(motion, c))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            inner, function = _law(argument), FUNCTIONS[name]
            return lambda motion, c: function(inner(motion, c))
        case ast.Name(id="t"):
            return lambda motion, c: motion.time
        case ast.Name(id=name):
            return _state(name)
    raise TypeError(f"{ast.dump(node)} is not a formula")  # `check` refuses it before


def _state(name: str) -> Law:
    """A coefficient, or the state of an axis."""
    kind, number = _NAME.fullmatch(name).groups()  # type: ignore[union-attr]
    at = int(number) - 1
    if kind == "c":
        return lambda motion, c: c[at]
    series = {"q": "position", "v": "velocity", "a": "acceleration", "load": "load"}[kind]

    def state(motion: "Motion", c: list[float]) -> Any:
        of_axes = getattr(motion, series)
        if at >= of_axes.shape[1]:
            raise ValueError(f"{name}: the robot has {of_axes.shape[1]} axes")
        return of_axes[:, at]

    return state
