"""A split on disk: recordings that tell nothing by name, answers kept apart and hashed, results, and who looked when.

SPLIT/manifest.json          case ids, SHA-256 of recordings and answers, what the command is called with
SPLIT/recordings/ID/         what `twin diagnose` is given: frf.h5, log.h5 or both
SPLIT/edit/ID/               the same robot carrying another load, for the edit test
SPLIT/answers/ID.json        the truth; opened by the scorer only
SPLIT/results/ID.json        what the command said
SPLIT/ledger.json            the making of the split and every opening of its answers: when, with which engine
"""

import hashlib
import json
import os
import re
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ENGINE = (
    "twin/diagnose", "twin/identify", "twin/physics", "twin/model", "twin/robot", "twin/measure", "twin/commands",
    "mjcf",
)  # fmt: skip
ROOT = Path(__file__).resolve().parents[2]


def read(path: Path) -> Any:
    return json.loads(path.read_text())


def write(path: Path, content: Any) -> None:
    """Whole or not at all."""
    write_text(path, json.dumps(content, indent=1))


def write_text(path: Path, text: str) -> None:
    """Whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    aside.write_text(text, encoding="utf-8")
    os.replace(aside, path)


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def engine_hash() -> str:
    """One hash of all that decides: code, calibration and robot descriptions."""
    digest = hashlib.sha256()
    for room in ENGINE:
        for file in sorted((ROOT / room).rglob("*")):
            if file.suffix in (".py", ".yaml"):
                digest.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def commit() -> str:
    """The commit of the working tree, marked where it has changes; empty outside a repository."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return found.stdout.strip()


def entered(split: Path, why: str) -> list[dict[str, str]]:
    """Enter one more event into the ledger, and return all of them."""
    path = split / "ledger.json"
    ledger = read(path) if path.exists() else []
    entry = {"engine": engine_hash(), "commit": commit(), "why": why}
    ledger.append({"time": datetime.now(UTC).isoformat(timespec="seconds"), **entry})
    write(path, ledger)
    return list(ledger)


def reading(page: Path, engines: Sequence[str]) -> list[str]:
    """Why answers are wrong, Markdown that somebody wrote: `reading.md` in the folder of the page's name, or nothing.

    The hash in its first line says which engine it is about.
    """
    path = page.with_suffix("") / "reading.md"
    if not path.exists():
        return []
    first, *rest = path.read_text(encoding="utf-8").strip().splitlines()
    about = re.search(r"\b[0-9a-f]{16}\b", first)
    stated = first.strip("<!-> \n") if about else "engine not stated"
    lines = [f"## Reading of the failures: {stated}", ""]
    if about is None or [about[0]] != list(engines):
        lines += [f"**About another engine than this page** ({', '.join(engines)}): cases and numbers differ.", ""]
    return [*lines, *(rest if about else [first, *rest]), ""]


def before(page: Path) -> list[str]:
    """What engines before scored, Markdown that somebody wrote: `before.md` beside `reading.md`, or nothing."""
    path = page.with_suffix("") / "before.md"
    return ["## Engines before", "", path.read_text(encoding="utf-8").strip(), ""] if path.exists() else []


def typeset(page: str) -> str:
    """Markdown with a blank before every percent sign, and minus signs, outside of code."""
    parts = re.split(r"(`[^`]*`)", page)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"(?<=\d)%", " %", re.sub(r"(?<=[\s(\[])-(?=\d)", "−", parts[k]))
    return "".join(parts)
