"""Mutations that know the format: YAML by its tree, HDF5 by its objects, XML by its elements, text by its words."""

import copy
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
from ruamel.yaml import YAML

NUMBERS = (0, -1, 1, -0.0, 1e300, -1e300, 1e-300, 1e12, -1e12, 1e6, 1e-9, float("nan"), float("inf"), 2**63, 0.5, 100)
WORDS = (
    "", " ", "\\frac", "$x$", "../../x", "a/b", "\x07", "é" * 5, "x" * 5000, "on", "null", "1e5", "nan", "joint9",
    "link0", "base", "kr90", "c1*q9", "c1/0", "sin", "c9*q1", "(" * 200 + "q1" + ")" * 200, "c1*1e400", "q1**q2**q1",
    "c1*t", "__import__('os')", "9**9**9**9", "1/v1", "exp(exp(exp(q1*1e9)))", "log(v1)",
)  # fmt: skip
SHAPES: tuple[Any, ...] = (None, True, False, [], {}, [[]], [0], {"a": 1}, "word", [1, 2, 3], [1e300] * 6, [None])


def value(rng: random.Random) -> Any:
    """Something that a field might not expect."""
    return copy.deepcopy(rng.choice(rng.choice((NUMBERS, NUMBERS, WORDS, SHAPES))))


def mutate(source: Path, target: Path, rng: random.Random) -> str:
    """Write a mutated copy of a file; returns what was done."""
    binary = dict.fromkeys((".mat", ".tdms", ".mcap", ".wav"), _raw)
    kinds = {".yaml": _yaml, ".h5": _hdf5, ".urdf": _xml, **binary}
    change = kinds.get(source.suffix, _text)
    if rng.random() < 0.08:
        change = _raw
    return change(source, target, rng)


# --- YAML


def _places(data: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [at, *(place for key, item in items for place in _places(item, (*at, key)))]


def _yaml(source: Path, target: Path, rng: random.Random) -> str:
    if rng.random() < 0.05:
        return _yaml_bomb(target, rng)
    data = YAML(typ="safe", pure=True).load(source.read_text())
    said = []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        place = rng.choice(_places(data)[1:])
        holder = data
        for key in place[:-1]:
            holder = holder[key]
        said.append(_change(holder, place[-1], rng, ".".join(map(str, place))))
        if not isinstance(data, dict) or len(_places(data)) < 2:
            break
    writer = YAML(typ="safe", pure=True)
    writer.width = 100000
    with target.open("w", encoding="utf-8") as stream:
        writer.dump(data, stream)
    return "; ".join(said)


def _change(holder: Any, key: Any, rng: random.Random, where: str) -> str:
    kind, old = rng.randrange(7), holder[key]
    if kind == 0:
        del holder[key]
        return f"{where} deleted"
    if kind == 1 and isinstance(holder, dict):
        holder[str(value(rng))[:60]] = holder.pop(key)
        return f"{where} renamed"
    if kind == 2 and isinstance(old, list) and old:
        count = rng.choice((2, 10, 300))
        holder[key] = old * count
        return f"{where} {count} times over"
    if kind == 3 and isinstance(old, int | float) and not isinstance(old, bool):
        factor = rng.choice((-1, 1e-6, 1e-3, 1e3, 1e6, 1e20))
        holder[key] = old * factor
        return f"{where} × {factor:g}"
    new = value(rng)
    holder[key] = new
    return f"{where} = {str(new)[:60]!r}"


def _yaml_bomb(target: Path, rng: random.Random) -> str:
    kind = rng.randrange(4)
    texts = (
        "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 30)),
        "a: &a [*a]\n",
        "name: " + "[" * 3000 + "]" * 3000 + "\n",
        "name: " + "x" * 3_000_000 + "\n",
    )
    target.write_text(texts[kind])
    return f"bomb {kind}"


# --- HDF5


def _hdf5(source: Path, target: Path, rng: random.Random) -> str:
    shutil.copy(source, target)
    said = []
    with h5py.File(target, "r+") as file:
        for _ in range(rng.choice((1, 1, 1, 2))):
            names: list[str] = ["/"]
            file.visit(names.append)
            name = rng.choice(names)
            try:
                item = file[name]
            except (KeyError, OSError, RuntimeError):  # a link of an earlier change, that leads nowhere
                continue
            if len(item.attrs) and rng.random() < 0.4:
                said.append(_attribute(item, rng))
            elif isinstance(item, h5py.Dataset):
                said.append(_dataset(item, rng))
            elif name != "/":
                said.append(_group(file, name, rng))
    return "; ".join(said) or "nothing"


def _attribute(item: Any, rng: random.Random) -> str:
    name = rng.choice(sorted(item.attrs))
    new = value(rng)
    if new is None or isinstance(new, dict) or rng.random() < 0.2:
        del item.attrs[name]
        return f"{item.name}@{name} deleted"
    try:
        item.attrs[name] = h5py.Empty("f8") if rng.random() < 0.05 else new
    except (TypeError, ValueError, OverflowError):
        item.attrs[name] = str(new).replace("\x00", "")
    return f"{item.name}@{name} = {str(new)[:60]!r}"


def _dataset(item: h5py.Dataset, rng: random.Random) -> str:
    if item.shape is None or item.size > 10**8:  # of an earlier change: it is not to be read here
        return f"{item.name} left"
    name, shape, parent = item.name, item.shape, item.parent
    old = item[()]
    base = name.rpartition("/")[2]
    attributes = dict(item.attrs)
    kind = rng.randrange(14)
    numeric = np.asarray(old).dtype.kind in "fc"
    del parent[base]
    ones = np.ones(shape)
    makers: tuple[Callable[[], Any], ...] = (
        lambda: parent.create_dataset(base, (10**12, 6), "f8", chunks=(1000, 6)),
        lambda: parent.create_dataset(base, data=h5py.Empty("f8")),
        lambda: parent.create_dataset(base, shape, [("a", "f8"), ("b", "f8"), ("c", "f8")]),
        lambda: parent.create_dataset(base, data=np.full(shape, np.nan)),
        lambda: parent.create_dataset(base, data=np.zeros(shape)),
        lambda: parent.create_dataset(base, data=ones * rng.choice(NUMBERS[:12])),
        lambda: parent.create_dataset(base, data=old * rng.choice((1e-300, 1e-6, 1e3, 1e200)) if numeric else ones),
        lambda: parent.create_dataset(base, data=np.asarray(old)[..., None]),
        lambda: parent.create_dataset(base, data=np.asarray(old).reshape(-1)[: rng.choice((0, 1, 2, 5))]),
        lambda: parent.create_dataset(base, data=np.asarray(old)[: max(1, len(np.atleast_1d(old)) // 2)]),
        lambda: parent.create_dataset(base, data="text"),
        lambda: parent.__setitem__(base, h5py.SoftLink(rng.choice(("/", "/nowhere", name)))),
        lambda: parent.__setitem__(base, h5py.ExternalLink(rng.choice(("none.h5", "/etc/passwd")), "/x")),
        lambda: None,
    )
    try:
        makers[kind]()
    except (TypeError, ValueError, IndexError):
        kind = 13
    if kind < 11:
        for key, one in attributes.items():
            parent[base].attrs[key] = one
    return f"{name} made into {kind}"


def _group(file: h5py.File, name: str, rng: random.Random) -> str:
    kind = rng.randrange(5)
    parent, _, base = name.rpartition("/")
    holder = file[parent or "/"]
    if kind == 0:
        del file[name]
    elif kind == 1:
        if f"{base}-self" not in holder:  # of an earlier change
            holder[f"{base}-self"] = holder
    elif kind == 2:
        new = rng.choice(("\\frac{", "$x", " ", "..", "x" * 3000, "é\n", "a.b"))
        if new in holder:
            return f"{name} left"
        holder.move(base, new)
        return f"{name} renamed {new[:20]!r}"
    elif kind == 3:
        del file[name]
        holder.create_dataset(base, data=1.0)
    else:
        for k in range(rng.choice((1, 30))):
            if f"{base}{k}" not in holder:
                holder[f"{base}{k}"] = file[name]
    return f"{name} group change {kind}"


# --- XML and text


def _xml(source: Path, target: Path, rng: random.Random) -> str:
    if rng.random() < 0.08:
        return _xml_bomb(source, target, rng)
    tree = ElementTree.parse(source)
    said = []
    for _ in range(rng.choice((1, 1, 2))):
        elements = list(tree.getroot().iter())
        element = rng.choice(elements)
        kind = rng.randrange(4)
        if kind == 0 and len(element):
            element.remove(rng.choice(list(element)))
            said.append(f"child of {element.tag} removed")
        elif kind == 1 and len(element):
            element.extend([copy.deepcopy(rng.choice(list(element))) for _ in range(rng.choice((1, 5)))])
            said.append(f"child of {element.tag} repeated")
        elif element.attrib:
            key = rng.choice(sorted(element.attrib))
            new = rng.choice(
                (str(value(rng)), "0 0 0", "1e300 0 0", "1e-300 1e-300 0", "0", "-1", "base", "upper", "fore")
            )
            element.set(key, new.replace("\x07", ""))
            said.append(f"{element.tag}@{key} = {new[:40]!r}")
    tree.write(target)
    return "; ".join(said) or "nothing"


def _xml_bomb(source: Path, target: Path, rng: random.Random) -> str:
    kind = rng.randrange(5)
    text = source.read_text()
    entities = '<!DOCTYPE robot [<!ENTITY a "xx">' + "".join(
        f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 9}">' for k in range(12)
    )
    fixed = "".join(
        f'<link name="f{k}"/><joint name="x{k}" type="fixed"><parent link="{f"f{k - 1}" if k else "fore"}"/>'
        f'<child link="f{k}"/></joint>'
        for k in range(5000)
    )
    bombs = (
        text.replace("<robot", entities + "]><robot").replace('name="upper"', 'name="&m;"'),
        "<robot>" + "<link>" * 50000 + "</link>" * 50000 + "</robot>",
        text.replace('<?xml version="1.0"?>', '<?xml version="1.0" encoding="nonsense-9"?>'),
        text.replace("</robot>", fixed + "</robot>"),
        text.replace("<robot", '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot').replace(
            "arm", "&a;"
        ),
    )
    target.write_text(bombs[kind])
    return f"bomb {kind}"


def _text(source: Path, target: Path, rng: random.Random) -> str:
    lines = source.read_text(errors="replace").splitlines()
    said = []
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(lines)) if rng.random() < 0.7 else rng.randrange(min(20, len(lines)))
        kind = rng.randrange(5)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines[at:at] = [lines[at]] * rng.choice((1, 50))
        else:
            mark = "," if "," in lines[at] else None
            words = lines[at].split(mark)
            if words:
                words[rng.randrange(len(words))] = str(value(rng))[:200]
            lines[at] = (mark or " ").join(words)
        said.append(f"line {at + 1} change {min(kind, 2)}")
        if len(lines) < 2:
            break
    target.write_text("\n".join(lines) + "\n", errors="replace")
    return "; ".join(said)


def _raw(source: Path, target: Path, rng: random.Random) -> str:
    data = bytearray(source.read_bytes())
    kind = rng.randrange(3)
    if kind == 0:
        del data[rng.randrange(len(data)) :]
    else:
        for _ in range(rng.choice((1, 5, 50))):
            data[rng.randrange(len(data))] = rng.randrange(256)
    target.write_bytes(bytes(data))
    return "cut short" if kind == 0 else "bytes changed"
