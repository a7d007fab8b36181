"""Writes the first screen of README.md: what `twin example` and `twin diagnose` print, and the picture.

python -m tools.readme_example        # docs/example.png and the text between the markers
"""

import contextlib
import io
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PICTURE = ROOT / "docs" / "example.png"
COMMANDS = ("twin example", "twin diagnose cell/campaign.h5")
BLOCK = re.compile(r"(?<=<!-- example -->\n```\n).*?(?=```\n<!-- /example -->)", re.DOTALL)


def printed(folder: Path) -> str:
    """The commands and what they print, run in a folder; of a diagnosis the lines that a first reader needs."""
    from twin.cli import main

    said, before, arguments = "", Path.cwd(), sys.argv
    try:
        os.chdir(folder)
        for command in COMMANDS:
            sys.argv, out = command.split(), io.StringIO()
            with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
                main()
            said += f"$ {command}\n{shown(out.getvalue())}"
    finally:
        os.chdir(before)
        sys.argv = arguments
    return said


def shown(text: str) -> str:
    """Without checks, triage and the list of files."""
    return "".join(
        line for line in text.splitlines(keepends=True) if not re.match(r"  (check|edit|triage|wrote|  damping)", line)
    )


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        text = printed(Path(folder))
        shutil.copyfile(Path(folder) / "out" / "campaign" / "overlay.png", PICTURE)
    found = README.read_text(encoding="utf-8")
    README.write_text(BLOCK.sub(lambda _: text, found), encoding="utf-8")


if __name__ == "__main__":
    main()
