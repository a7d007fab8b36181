"""Where a result comes from: version, hashes of its inputs, options."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import twin
from twin.files import writing


def provenance(inputs: Iterable[str | Path], options: Mapping[str, Any]) -> dict[str, Any]:
    """Version of the package, SHA-256 of every input file, and the options of a run, as plain data."""
    hashes = {str(path): hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in inputs}
    return {"version": twin.__version__, "inputs": hashes, "options": dict(options)}


def write_json(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write plain data as indented JSON, atomically."""
    with writing(path) as stream:
        stream.write(to_json(data) + "\n")


def to_json(data: Mapping[str, Any]) -> str:
    """Plain data as indented JSON."""
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
