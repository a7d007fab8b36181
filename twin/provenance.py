"""Where a result comes from: version, hashes of its inputs, options."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import twin
from twin.files import writing


def provenance(inputs: Iterable[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Version of the package, SHA-256 of every input, and the options of a run, as plain data.

    A file is hashed as it is. An object in memory is hashed by its content, under what it calls itself.
    """
    hashes = dict(_hash(item) for item in inputs)
    return {"version": twin.__version__, "inputs": hashes, "options": {k: _plain(v) for k, v in options.items()}}


def write_json(path: str | Path, data: Mapping[str, Any]) -> None:
    """Write plain data as indented JSON, atomically."""
    with writing(path) as stream:
        stream.write(to_json(data) + "\n")


def to_json(data: Mapping[str, Any]) -> str:
    """Plain data as indented JSON."""
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False, default=_path)


def _path(value: object) -> str:
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is no plain data")


def _hash(item: Any) -> tuple[str, str]:
    if isinstance(item, str | Path):
        return str(item), hashlib.sha256(Path(item).read_bytes()).hexdigest()
    found = hashlib.sha256()
    _feed(found, item)
    return str(getattr(item, "source", None) or getattr(item, "name", "in memory")), found.hexdigest()


def _feed(found: Any, value: Any) -> None:
    """Arrays by type, shape and bytes; dataclasses and mappings by name; models of pydantic by their JSON."""
    if isinstance(value, np.ndarray):
        found.update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        for field in fields(value):
            found.update(field.name.encode())
            _feed(found, getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key, item in value.items():
            found.update(str(key).encode())
            _feed(found, item)
    elif isinstance(value, list | tuple):
        for item in value:
            _feed(found, item)
    elif hasattr(value, "model_dump_json"):
        found.update(value.model_dump_json().encode())
    else:
        found.update(repr(value).encode())


def _plain(value: Any) -> Any:
    """An option as JSON has it: a robot by its name, a path by its text."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return str(getattr(value, "source", None) or getattr(value, "name", value))
