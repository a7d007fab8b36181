"""YAML 1.2 in and out: ``6.1e6`` and ``2e-4`` are numbers, ``on`` is a word; files are written whole or not at all."""

from itertools import accumulate
from pathlib import Path
from typing import Any, TextIO

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.scalarstring import DoubleQuotedScalarString

from twin.errors import InputError
from twin.files import writing
from twin.ranges import MOST_CHARACTERS, MOST_NESTED, MOST_NODES

# Words that YAML 1.1 readers would take for booleans; quoted on writing so that every reader agrees.
_YAML_1_1_BOOLEANS = {"on", "off", "yes", "no", "y", "n", "true", "false"}


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML 1.2 mapping.

    Raises:
        InputError: the file is missing, is not YAML, or is not a mapping.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        if max(accumulate((c in "[{") - (c in "]}") for c in text if c in "[]{}"), default=0) > 4 * MOST_NESTED:
            raise InputError(path, "", f"expected at most {MOST_NESTED} levels of brackets")
        data = YAML(typ="safe", pure=True).load(text)
    except OSError as error:
        raise InputError(path, "", f"cannot be read ({error.strerror})") from error
    except (YAMLError, UnicodeDecodeError) as error:
        problem = getattr(error, "problem", None) or "not text in UTF-8"
        mark = getattr(error, "problem_mark", None)
        raise InputError(path, f"line {mark.line + 1}" if mark else "", f"not valid YAML: {problem}") from error
    except (RecursionError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise InputError(path, "", "not valid YAML: nested without end, or a value that is none") from error
    if not isinstance(data, dict):
        raise InputError(path, "", "expected a mapping of keys to values at the top level")
    if problem := _too_large(data):
        raise InputError(path, "", problem)
    return data


def _too_large(data: Any) -> str | None:
    """Why data is too much to work with: anchors can make a small file huge, or hold itself."""
    level, count = [data], 0
    for _ in range(MOST_NESTED):
        below: list[Any] = []
        for item in level:
            if isinstance(item, str) and len(item) > MOST_CHARACTERS:
                return f"expected texts of at most {MOST_CHARACTERS} characters, found {len(item)}"
            if isinstance(item, dict):
                below.extend(item)
                below.extend(item.values())
            elif isinstance(item, list | set | tuple):
                below.extend(item)
            count += 1
            if count + len(below) > MOST_NODES:
                return f"expected at most {MOST_NODES} values; do anchors repeat each other?"
        if not below:
            return None
        level = below
    return f"expected at most {MOST_NESTED} levels; does an anchor hold itself?"


def write_yaml(path: str | Path, data: dict[str, Any]) -> None:
    """Write plain data (dicts, lists, numbers, strings, ``None``) as YAML 1.2, atomically.

    Lists of scalars and mappings inside lists that hold only scalars stay on one line.
    """
    with writing(path) as stream:
        dump_yaml(data, stream)


def dump_yaml(data: dict[str, Any], stream: TextIO) -> None:
    """The same to an open stream."""
    writer = YAML()
    writer.width = 110
    writer.default_flow_style = False
    writer.indent(mapping=2, sequence=4, offset=2)
    writer.representer.add_representer(float, _represent_float)
    writer.representer.add_representer(type(None), _represent_none)
    writer.dump(_styled(data), stream)


def _styled(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _styled(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        items = CommentedSeq(_styled(item) for item in value)
        if all(not isinstance(item, dict | list) for item in value):
            items.fa.set_flow_style()
        return items
    if isinstance(value, str):
        return DoubleQuotedScalarString(value) if value.lower() in _YAML_1_1_BOOLEANS else value
    if isinstance(value, bool) or value is None or isinstance(value, int):
        return value
    return float(value)


def _represent_float(representer: Any, value: float) -> Any:
    text = repr(value)
    mantissa, _, exponent = text.partition("e")
    if exponent and "." not in mantissa:  # readers of YAML 1.1 need the point to see a number
        text = f"{mantissa}.0e{exponent}"
    text = {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}.get(text, text)
    return representer.represent_scalar("tag:yaml.org,2002:float", text)


def _represent_none(representer: Any, _: None) -> Any:
    return representer.represent_scalar("tag:yaml.org,2002:null", "null")
