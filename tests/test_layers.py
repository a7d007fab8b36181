"""Data flows one way: what predicts and what was recorded know nothing of fits, decisions, reports and commands."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

TWIN = Path(__file__).parents[1] / "twin"
ABOVE = {"identify", "diagnose", "report", "commands", "cli"}
LAYERS = {
    **dict.fromkeys(("robot", "physics", "measure", "model"), ABOVE),
    "identify": ABOVE - {"identify"},
    "diagnose": {"report", "commands", "cli"},
    "milling": {"diagnose", "report", "commands", "cli"},
}


def imported(path: Path) -> Iterator[str]:
    """Rooms of the package that a file imports from, wherever it does."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("twin."):
            yield str(node.module).split(".")[1]


@pytest.mark.parametrize("room", LAYERS)
def test_a_room_imports_nothing_from_those_above_it(room: str) -> None:
    wrong = {
        f"{path.name}: {name}"
        for path in (TWIN / room).rglob("*.py")
        for name in imported(path)
        if name in LAYERS[room]
    }
    assert not wrong
