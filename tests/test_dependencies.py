"""What the package brings along: licences that a closed product may use, and no known vulnerability."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, distribution

import pytest
from packaging.requirements import Requirement

FREE = re.compile(
    r"\b(MIT|MIT-0|MIT-CMU|BSD|0BSD|BSL-1\.0|Apache|ISC|ISCL|PSF-2\.0|Python Software Foundation|Zlib|CC0-1\.0|HPND"
    r"|Unlicense|The Unlicense|FTL|NCSA)\b"
)
WEAK = re.compile(r"\b(MPL|Mozilla Public License|LGPL)")  # of a library that stays a library of its own
UNREACHABLE = re.compile(r"ConnectionError|ConnectTimeout|Max retries|resolve|ServiceError|ProxyError|[45]\d\d .*Error")


def needed(name: str = "twin") -> set[str]:
    """Distributions that an installation without extras brings along, as they are installed here."""
    found: set[str] = set()
    todo = [name]
    while todo:
        for text in distribution(todo.pop()).requires or []:
            need = Requirement(text)
            key = re.sub(r"[-_.]+", "-", need.name).lower()
            if (need.marker is None or need.marker.evaluate({"extra": ""})) and key not in found:
                try:
                    distribution(need.name)
                except PackageNotFoundError:
                    continue
                found.add(key)
                todo.append(need.name)
    return found


def refused(licences: dict[str, str]) -> dict[str, str]:
    """Those that are neither free nor weakly protective."""

    def allowed(text: str) -> bool:
        return any(
            all(FREE.search(part) or WEAK.search(part) for part in re.split(r" AND |; ", choice))
            for choice in text.split(" OR ")
        )

    return {name: text for name, text in licences.items() if not allowed(text)}


def test_the_judgement_of_licences() -> None:
    said = {
        "a": "MIT AND GPL-3.0-only",
        "b": "GPL-3.0-only OR MIT",
        "c": "UNKNOWN",
        "d": "GNU General Public License v3",
    }
    assert set(refused(said)) == {"a", "c", "d"}


def test_every_dependency_has_a_licence_that_products_may_use() -> None:
    pytest.importorskip("piplicenses", reason="""not installed: pip install -e ".[test]" brings it""")
    line = [sys.executable, "-m", "piplicenses", "--format", "json", "--from", "mixed", "--packages", *sorted(needed())]
    found = subprocess.run(line, capture_output=True, text=True, check=True)
    licences = {row["Name"]: row["License"] for row in json.loads(found.stdout)}
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in licences} >= needed() - {"pip", "setuptools"}
    assert refused(licences) == {}


def test_no_dependency_has_a_known_vulnerability(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Asks the advisories of PyPI; without a network the test is skipped, not passed."""
    pytest.importorskip("pip_audit", reason="""not installed: pip install -e ".[test]" brings it""")
    listed = tmp_path_factory.mktemp("audit") / "requirements.txt"
    exact: Callable[[str], str] = lambda name: f"{name}=={distribution(name).version}\n"  # noqa: E731
    listed.write_text("".join(exact(name) for name in sorted(needed())))
    line = [sys.executable, "-m", "pip_audit", "--requirement", str(listed), "--no-deps", "--disable-pip",
            "--progress-spinner", "off", "--timeout", "10"]  # fmt: skip
    try:
        found = subprocess.run(line, capture_output=True, text=True, check=False, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("the vulnerability service does not answer")
    if found.returncode and "Found " not in found.stderr and UNREACHABLE.search(found.stderr):
        pytest.skip(f"the vulnerability service cannot be reached: {found.stderr.strip().splitlines()[-1][:200]}")
    assert found.returncode == 0, found.stdout + found.stderr
