"""Pages of the site that are made when it is built, so that they are never stale: effects, commands, Python reference.

mkdocs runs this file (plugin `gen-files` in mkdocs.yml).
"""

import html
import inspect
import re
import tempfile
from pathlib import Path
from typing import Any

import mkdocs_gen_files
import typer
from typer.main import get_command

import twin
from tools import effect_pages
from twin.cli import app

ROOT = Path(__file__).parents[1]


def effects() -> None:
    """A page per effect, with its picture."""
    with tempfile.TemporaryDirectory() as folder:
        effect_pages.write(Path(folder))
        for path in sorted(Path(folder).iterdir()):
            with mkdocs_gen_files.open(f"effects/{path.name}", "wb") as stream:
                stream.write(path.read_bytes())


def commands() -> str:
    """What `twin COMMAND --help` says, in Markdown."""
    root = get_command(app)
    context = typer.Context(root, info_name="twin")
    general = (
        "`twin COMMAND --help` says the same. `twin -q COMMAND` prints one line, `twin -v COMMAND` every file it "
        "wrote. `twin --docs` prints the folder of these pages as files. `twin --install-completion` makes your shell "
        "complete commands. Bad input ends in one line and exit code 2."
    )
    parts = ["# Commands", general]
    for name, command in root.commands.items():  # type: ignore[attr-defined]
        said = re.sub(r"\bdocs/([\w-]+\.md)", r"[\1](\1)", inspect.cleandoc(command.help or ""))
        parts += [f"## twin {name}", said]
        records = [(p, record) for p in command.params if (record := p.get_help_record(context))]
        rows = [f"| <code>{_written(_called(p, name))}</code> | {_cell(said)} |" for p, (name, said) in records]
        parts.append("\n".join(["| argument or option | meaning |", "|---|---|", *rows]))
    return "\n\n".join(parts) + "\n"


def reference() -> str:
    """Every public name of the package, from its docstring."""
    parts = ["# Python, every function", "Made from the docstrings. [api.md](api.md) shows how they work together."]
    for name in twin._HOME:
        there = getattr(twin, name)  # under the name that it has at home
        parts.append(
            f"::: {there.__module__}.{there.__qualname__}\n    options:\n      heading: twin.{name}\n"
            f"      toc_label: {name}"
        )
    return "\n\n".join(parts) + "\n"


def changelog() -> str:
    """The file of the repository."""
    return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


KINDS = {"int range": "N", "int": "N", "float": "NUMBER", "str": "TEXT", "path": "PATH", "list[Path]": "PATH"}


def _called(parameter: Any, name: str) -> str:
    """An argument by its name alone, an option with the kind of its value."""
    return (parameter.param_type_name == "argument" and parameter.metavar) or name


def _written(option: str) -> str:
    """An option with the kind of its value in plain words, for a code element: a bar splits no cell there."""
    option = re.sub(r"<([^>]+)>", lambda kind: KINDS.get(kind[1], kind[1]), option)
    return html.escape(option).replace("|", "&#124;")


def _cell(text: str) -> str:
    text = re.sub(r" \[[\d.e+]+<=x<=[\d.e+]+\]", "", " ".join(text.split()))
    text = re.sub(
        r" \[default: \((.*)\)\]$| \[default: (.*)\]$", lambda value: f" Default: {value[1] or value[2]}.", text
    )
    return text.replace(" [required]", " Required.").replace("|", "\\|")


def write() -> None:
    """All of them."""
    effects()
    for name, page in {"commands.md": commands, "reference.md": reference, "changelog.md": changelog}.items():
        with mkdocs_gen_files.open(name, "w", encoding="utf-8") as stream:
            stream.write(page())


write()
