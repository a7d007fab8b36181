"""What the house looks like in numbers: lines, constants, effect names, long functions, circles of imports.

`python -m tools.structure` reads the code of this checkout, or of another one (`--root FOLDER`), so that before and
after are counted alike. With recordings it also diagnoses each and lists the files of `twin/diagnose` and
`twin/identify` that a function call entered, and the share that all recordings have in common.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOMS = ("diagnose", "identify")
LONGEST = 60  # lines of a function, its docstring aside

TRACED = """
import sys, threading
entered = set()
def call(frame, event, argument):
    if event == "call":
        entered.add(frame.f_code.co_filename)
import twin.parallel
twin.parallel.cores = lambda: 1
sys.setprofile(call)
from twin.cli import main
code = 0
try:
    main()
except SystemExit as ended:
    code = ended.code
sys.setprofile(None)
print("\\n".join(sorted(entered)), file=sys.stderr)
sys.exit(code)
"""


def modules(root: Path) -> dict[str, ast.Module]:
    """Dotted name → syntax tree of every module of the package."""
    found = {}
    for path in sorted((root / "twin").rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = ast.parse(path.read_text())
    return found


def lines(root: Path, room: str) -> tuple[int, int]:
    """Lines and files of a room."""
    paths = list((root / "twin" / room).rglob("*.py"))
    return sum(len(path.read_text().splitlines()) for path in paths), len(paths)


def statements(root: Path, room: str) -> int:
    """Lines of a room that hold a statement which is no import: no docstring, comment or blank line."""
    count = 0
    for path in (root / "twin" / room).rglob("*.py"):
        tree, text = ast.parse(path.read_text()), path.read_text().splitlines()
        left: set[int] = set()
        for node in ast.walk(tree):
            told = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            if told or isinstance(node, ast.Import | ast.ImportFrom):
                assert isinstance(node, ast.stmt)
                left |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        count += sum(
            bool(line.strip()) and not line.strip().startswith("#") and number not in left
            for number, line in enumerate(text, 1)
        )
    return count


def constants(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Name and value of the numbers that a module binds in capitals."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                yield from _numbers(target, node.value)


def _numbers(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, str]]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for one, other in zip(target.elts, value.elts, strict=False):
            yield from _numbers(one, other)
    elif isinstance(target, ast.Name) and target.id.strip("_").isupper() and _numeric(value):
        yield target.id, ast.unparse(value)


def _numeric(value: ast.expr) -> bool:
    found = [n.value for n in ast.walk(value) if isinstance(n, ast.Constant)]
    return any(isinstance(x, int | float) and not isinstance(x, bool) for x in found)


def effect_names(root: Path, trees: dict[str, ast.Module]) -> dict[str, int]:
    """Module outside ``twin/physics`` → string literals that name an effect of the vocabulary.

    In ``twin/robot`` a name that is also a field of the description or of a data sheet (a robot's rated payload, a
    drive's rotor inertia) is that field.
    """
    names = {p.stem for p in (root / "twin" / "physics").glob("*.py")}
    names -= {"__init__", "effect", "chain", "motion", "catalogue"}
    fields = {
        node.target.id
        for module, tree in trees.items()
        if ".robot" in module
        for node in ast.walk(tree)
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
    found: dict[str, int] = {}
    for module, tree in trees.items():
        if ".physics" not in module:
            others = names - fields if ".robot" in module else names
            count = sum(isinstance(n, ast.Constant) and n.value in others for n in ast.walk(tree))
            if count:
                found[module] = count
    return found


def long_functions(trees: dict[str, ast.Module]) -> list[tuple[int, str]]:
    """Functions of more than ``LONGEST`` lines without their docstring, longest first."""
    found = []
    for module, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                first = node.body[0]
                told = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
                start = first.end_lineno if told else first.lineno - 1
                length = (node.end_lineno or 0) - (start or 0)
                if length > LONGEST:
                    found.append((length, f"{module}.{node.name}"))
    return sorted(found, reverse=True)


def circles(trees: dict[str, ast.Module]) -> list[list[str]]:
    """Groups of modules that import each other when they are loaded (strongly connected, Tarjan)."""
    edges = {name: set(_imports(name, tree, trees)) for name, tree in trees.items()}
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in edges[name]:
            if other not in index:
                visit(other)
                low[name] = min(low[name], low[other])
            elif other in stack:
                low[name] = min(low[name], index[other])
        if low[name] == index[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                found.append(sorted(group))

    for name in edges:
        if name not in index:
            visit(name)
    return found


def _imports(name: str, tree: ast.Module, trees: dict[str, ast.Module]) -> Iterator[str]:
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                target = whole if whole in trees else node.module
                if target in trees and target != name:
                    yield target


def entered(root: Path, recording: Path) -> set[str]:
    """Files of ``twin/diagnose`` and ``twin/identify`` that a diagnosis of a recording enters."""
    command = [sys.executable, "-c", TRACED, "diagnose", str(recording.resolve()), "--json"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(root)}
    ended = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise SystemExit(f"{recording}: twin diagnose ended with exit code {ended.returncode}")
    rooms = tuple(str(root / "twin" / room) for room in ROOMS)
    return {str(Path(line).relative_to(root)) for line in ended.stderr.splitlines() if line.startswith(rooms)}


def decision_numbers(root: Path) -> int:
    """Numbers in the one file of the decision."""
    path = root / "twin" / "diagnose" / "calibration.yaml"
    return sum(bool(line[:1].strip()) and line[:1] not in "#-" for line in path.read_text().splitlines())


def report(root: Path) -> dict[str, object]:
    """All that is counted without running anything."""
    trees = modules(root)
    inside = {n: t for n, t in trees.items() if n.split(".")[1:2] and n.split(".")[1] in ROOMS}
    values: dict[str, set[str]] = defaultdict(set)
    for tree in inside.values():
        for name, value in constants(tree):
            values[name.strip("_")].add(value)
    named = effect_names(root, trees)
    long = long_functions(trees)
    counted = {room: lines(root, room) for room in (*ROOMS, "model", "physics", "commands")}
    return {
        **{f"lines of {room}": count for room, (count, _) in counted.items()},
        "lines of diagnose and identify": sum(counted[room][0] for room in ROOMS),
        "of them with a statement, imports aside": sum(statements(root, room) for room in ROOMS),
        "files of diagnose and identify": sum(counted[room][1] for room in ROOMS),
        "numeric constants there": sum(len(list(constants(tree))) for tree in inside.values()),
        "constant names with several values there": sorted(n for n, v in values.items() if len(v) > 1),
        "decision numbers in calibration.yaml": decision_numbers(root),
        "effect names outside physics": sum(named.values()),
        "effect names by module": named,
        f"functions above {LONGEST} lines": [f"{name} ({count})" for count, name in long],
        "circles of imports": circles(trees),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path, help="one recording of each kind, diagnosed in turn")
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1], help="a checkout")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    found = report(options.root.resolve())
    if options.recordings:
        sets = {str(path): entered(options.root.resolve(), path) for path in options.recordings}
        together, common = set.union(*sets.values()), set.intersection(*sets.values())
        found["files entered"] = {name: len(files) for name, files in sets.items()}
        found["files in common"] = sorted(common)
        found["share in common, of each"] = {n: round(len(common) / len(s), 2) for n, s in sets.items()}
        found["files of all"] = len(together)
    if options.json:
        print(json.dumps(found, indent=2))
        return
    for name, value in found.items():
        shown = value if not isinstance(value, list) else f"{len(value)}: {', '.join(map(str, value))}"
        print(f"{name:45s} {shown}")


if __name__ == "__main__":
    main()
