"""Universal files: FRFs and coherence as data set 58 (text or binary), mode shapes as data set 55, through pyuff.

The moving hammer is the reference of data set 58, the sensor its response. The sign of a direction belongs to the
label, and the stored direction carries it. So FRFs are taken over as they are. What data set 58 has no field for
(posture, window, averages, brakes, force level, bodies) travels as ``key=value`` words in its ID lines.
"""

import re
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from twin.errors import InputError
from twin.files import replacing
from twin.measure.campaign import (
    Campaign,
    Channels,
    FloatArray,
    PostureFRF,
    Quantity,
    check_campaign,
)
from twin.measure.hdf5 import check_unit
from twin.measure.modal import ModalResult
from twin.measure.units import frf_factor, same

TIME_FUNCTION, FRF_FUNCTION, COHERENCE_FUNCTION = 1, 4, 6
ACCELERATION_DATA, TIME_DATA = 12, 17
MARK = re.compile(rb"    -1(?=[\r\n]|\Z| {74})")  # begins and ends a data set
NEWLINE = b"\n"
FREQUENCY_DATA = 18
FORCE_DATA = (9, 13)  # reaction and excitation force
ORDINATE: dict[int, tuple[Quantity, str]] = {
    8: ("receptance", "m"),
    11: ("mobility", "m/s"),
    12: ("accelerance", "m/s^2"),
}
STATE = {  # words that are fields of a posture
    "averages": int, "peak_force_n": float, "exponential_window_rate": float, "pulse_s": float, "record_s": float,
}  # fmt: skip
NO_TEXT = ("", "NONE", "UNKNOWN")


@dataclass(frozen=True)
class Point:
    """Where a node is: the body it is fixed to and its position (3,) in m in that body's frame."""

    body: str
    position: FloatArray


@dataclass
class _Functions:
    """FRFs and coherence of one posture as they come, by (response, excitation) label."""

    words: dict[str, str]
    bodies: dict[int, str] = field(default_factory=dict)
    frf: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    coherence: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)


# --- reading ----------------------------------------------------------------------------------------------


def read_uff(
    paths: str | Path | Sequence[str | Path],
    *,
    q_deg: FloatArray | None = None,
    points: dict[int, Point] | None = None,
    robot: str | None = None,
    unit: str | None = None,
    placed: bool = False,
) -> Campaign:
    """Read FRFs, and coherence where there is one, from one universal file or many that belong together.

    Data sets of one posture are told by their ``posture=`` word. Without it, all data sets are one posture, which has
    the name of the first file.

    Args:
        paths: files.
        q_deg: axis positions, for files that do not say; of what is no robot there are none.
        points: nodes by number. Without them, nodes are taken from data sets 15 or 2411. A node that is in neither has
            the body ``base`` and lies at the origin.
        robot: name for the campaign.
        unit: of the FRFs, as ``g/lbf``, where it is not SI; what the file states must agree.
        placed: every node must have a place, as on a robot.

    Raises:
        InputError: for what is not SI and was not said to be, no FRF, incomplete, doubled, or breaks the contract of a
            campaign.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    source = files[0]
    groups: dict[str, _Functions] = {}
    nodes = dict(points or {})
    lines: list[tuple[int, ...]] = []
    for file in files:
        for number, dataset in _datasets(file).items():
            if dataset.get("type") in (15, 2411) and points is None:
                nodes |= _points(file, number, dataset)
            elif dataset.get("type") == 82:
                lines += _polylines(dataset["nodes"])
            elif dataset.get("type") == 164 and unit is None:
                _check_units(file, dataset)
            elif dataset.get("type") == 58 and int(dataset["func_type"]) in (FRF_FUNCTION, COHERENCE_FUNCTION):
                words = _words(dataset)
                _state(file, f"data set {number}", words)
                group = groups.setdefault(words.get("posture", source.stem), _Functions(words))
                for word in ("q_deg", "brakes"):
                    if word in words and words[word] != group.words.get(word, words[word]):
                        text = f"expected {word}={group.words[word]} as before in this posture, found {words[word]}"
                        raise InputError(file, f"data set {number}", text)
                for side, node in (("response", "rsp_node"), ("excitation", "ref_node")):
                    if f"{side}_body" in words:
                        group.bodies[int(dataset[node])] = words[f"{side}_body"]
                _take(
                    file, f"data set {number}", dataset if unit is None else _in_si(file, number, dataset, unit), group
                )
    if not any(group.frf for group in groups.values()):
        raise InputError(source, "", "expected data sets 58 with frequency response functions, there is none")
    response, excitation = _labels(groups.values(), 0), _labels(groups.values(), 1)
    bodies = {node: body for group in groups.values() for node, body in group.bodies.items()}
    if points is None and (lost := sorted(set(bodies) - set(nodes))):
        problem = "expected its coordinates in a data set of nodes (15 or 2411), they are missing"
        raise InputError(source, f"node {lost[0]}", problem)
    for one, body in bodies.items():
        if points and one in points and points[one].body != body:
            text = f"expected one body, found {body} in the file and {points[one].body} in the map"
            raise InputError(source, f"node {one}", text)
    if placed and (lost := sorted({int(label[:-2]) for label in (*response, *excitation)} - set(nodes))):
        problem = "expected its body and place, in `nodes` of the map or in a data set 15 or 2411 of the file"
        raise InputError(source, f"node {lost[0]}", problem)
    nodes |= {n: Point(bodies[n], nodes[n].position if n in nodes else np.zeros(3)) for n in bodies if points is None}
    campaign = Campaign(
        _channels(response, nodes),
        _channels(excitation, nodes),
        {name: _posture(source, name, group, response, excitation, q_deg) for name, group in groups.items()},
        robot=robot or next(iter(groups.values())).words.get("robot"),
        source=str(source),
        lines=tuple(lines),
    )
    check_campaign(source, campaign)
    return campaign


def read_uff_responses(
    paths: Sequence[Path],
) -> tuple[Channels, str | None, tuple[tuple[int, ...], ...], dict[str, tuple[FloatArray, FloatArray, float]]]:
    """Read time responses (58, function type 1), acceleration in m/s², from universal files that belong together.

    Returns:
        channels, robot, polylines over nodes, and posture → axis positions (n,), records (nr, nt), sampling rate in Hz.

    Raises:
        InputError: no time response, another quantity or unit, channels that differ in length or rate.
    """
    nodes: dict[int, Point] = {}
    lines: list[tuple[int, ...]] = []
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for file in paths:
        for number, dataset in _datasets(file).items():
            if dataset.get("type") in (15, 2411):
                nodes |= _points(file, number, dataset)
            elif dataset.get("type") == 82:
                lines += _polylines(dataset["nodes"])
            elif dataset.get("type") == 164:
                _check_units(file, dataset)
            elif dataset.get("type") == 58 and int(dataset["func_type"]) == TIME_FUNCTION:
                label = _label(file, f"data set {number} response", dataset["rsp_node"], dataset["rsp_dir"])
                _check_time_response(file, f"data set {number} ({label})", dataset)
                channels = found.setdefault(_words(dataset).get("posture", paths[0].stem), {})
                if label in channels:
                    raise InputError(file, f"data set {number} ({label})", "expected every channel once")
                channels[label] = dataset
    if not found:
        raise InputError(paths[0], "", "expected data sets 58 with time responses (type 1), there is none")
    labels = tuple(next(iter(found.values())))
    records, robot = {}, None
    for name, channels in found.items():
        if set(channels) != set(labels):
            raise InputError(paths[0], f"posture {name}", "expected the same channels in every posture")
        first = channels[labels[0]]
        sizes = {(len(d["data"]), round(float(d["x"][1] - d["x"][0]), 12)) for d in channels.values()}
        if len(sizes) > 1:
            raise InputError(paths[0], f"posture {name}", "expected records of one length and sampling rate")
        words = _words(first)
        q_deg, _ = _state(paths[0], f"posture {name}", words)
        rate = 1 / float(first["x"][1] - first["x"][0])
        records[name] = q_deg, np.stack([np.asarray(channels[x]["data"], dtype=np.float64) for x in labels]), rate
        robot = robot or words.get("robot")
    return _channels(labels, nodes), robot, tuple(lines), records


def _check_time_response(path: Path, where: str, dataset: dict[str, Any]) -> None:
    kind, unit = int(dataset["ordinate_spec_data_type"]), str(dataset.get("ordinate_axis_units_lab", "")).strip()
    if kind not in (0, 1, ACCELERATION_DATA):
        raise InputError(path, where, f"expected an acceleration (type 12), found {kind}")
    if unit.upper() not in NO_TEXT:
        check_unit(path, where, unit, "m/s^2")
    if int(dataset["abscissa_spec_data_type"]) not in (0, 1, TIME_DATA) or len(dataset["data"]) < 2:
        raise InputError(path, where, "expected two samples or more over time (type 17)")
    if np.iscomplexobj(dataset["data"]):
        raise InputError(path, where, "expected real data, found complex")


def _points(file: Path, number: int, dataset: dict[str, Any]) -> dict[int, Point]:
    """Nodes of data set 15 or 2411."""
    columns = [dataset[k] for k in ("node_nums", "x", "y", "z")]
    if len({len(column) for column in columns}) > 1:
        raise InputError(file, f"data set {number}", "expected x, y and z of every node, one is cut short")
    return {int(n): Point("base", np.array([x, y, z], dtype=np.float64)) for n, x, y, z in zip(*columns, strict=True)}


def placed_nodes(path: str | Path) -> set[int]:
    """Nodes of a universal file that have coordinates."""
    some = [(number, d) for number, d in _datasets(Path(path)).items() if d.get("type") in (15, 2411)]
    return {node for number, dataset in some for node in _points(Path(path), number, dataset)}


def stated_unit(path: str | Path) -> str | None:
    """Unit of the FRFs, as ``g/N``, where the axis labels of a universal file state it."""
    for dataset in _datasets(Path(path)).values():
        if dataset.get("type") == 58 and int(dataset["func_type"]) == FRF_FUNCTION:
            response, force = (
                str(dataset.get(f"{side}_axis_units_lab", "")).strip() for side in ("ordinate", "orddenom")
            )
            if response.upper() not in NO_TEXT and force.upper() not in NO_TEXT:
                return f"{response}/{force}"
    return None


def _datasets(path: Path) -> dict[int, dict[str, Any]]:
    """Data sets of the types that are used, by their number in the file, from 1."""
    if not path.is_file():
        raise InputError(path, "", "expected a file, there is none")
    try:
        with redirect_stdout(StringIO()):
            file = pyuff.UFF(str(path))
            kinds = file.get_set_types()
    except Exception as error:
        raise InputError(path, "", f"expected a universal file: {error}") from None
    found = {}
    for number, kind in enumerate(kinds, 1):
        if kind in (15, 55, 58, 82, 164, 2411):
            try:
                with redirect_stdout(StringIO()):
                    found[number] = file.read_sets(number - 1)
            except Exception:  # the library's own text does not say what is wrong
                text = f"its lines are not as type {kind} lays down: one is damaged, missing or doubled"
                raise InputError(path, f"data set {number}{_from_line(path, number)}", text) from None
    if untold := [n for n, kind in enumerate(kinds, 1) if kind < 1]:
        raise InputError(path, f"data set {untold[0]}", "expected its type on the first line, a number as 58")
    _check_whole(path, found)
    return found


def _from_line(path: Path, number: int) -> str:
    """Where a data set begins."""
    data = path.read_bytes()
    marks = [mark.end() for mark in MARK.finditer(data)]
    at = 2 * (number - 1)
    return f" from line {1 + data.count(NEWLINE, 0, marks[at])}" if at < len(marks) else ""


def _check_whole(path: Path, found: dict[int, dict[str, Any]]) -> None:
    """A file that ends inside a data set was cut short; a data set 58 holds as many values as it states."""
    if len(MARK.findall(path.read_bytes())) % 2:
        raise InputError(path, "", "ends inside a data set: the file is cut short; expected it whole")
    for number, dataset in found.items():
        if dataset.get("type") == 58 and int(dataset["num_pts"]) != len(dataset["data"]):
            held, stated = len(dataset["data"]), int(dataset["num_pts"])
            raise InputError(path, f"data set {number}", f"expected the {stated} values it states, found {held}")


def _polylines(nodes: Iterable[float]) -> list[tuple[int, ...]]:
    """Trace lines of data set 82; node 0 lifts the pen."""
    strips: list[list[int]] = [[]]
    for node in nodes:
        if int(node):
            strips[-1].append(int(node))
        else:
            strips.append([])
    return [tuple(strip) for strip in strips if len(strip) > 1]


def _words(dataset: dict[str, Any]) -> dict[str, str]:
    text = " ".join(str(dataset.get(f"id{n}", "")) for n in range(1, 6))
    return dict(word.split("=", 1) for word in text.split() if "=" in word)


def _state(source: Path, where: str, words: dict[str, str]) -> tuple[FloatArray, dict[str, Any]]:
    """Axis positions and what else of a posture the ID lines state."""
    try:
        q_deg = np.array([float(q) for q in words["q_deg"].split(",")] if words.get("q_deg") else [])
        return q_deg, {name: kind(words[name]) for name, kind in STATE.items() if name in words}
    except ValueError as error:
        raise InputError(source, where, f"expected numbers in the ID lines: {error}") from None


def _check_units(path: Path, dataset: dict[str, Any]) -> None:
    factors = [float(dataset.get(name, 1.0)) for name in ("length", "force")]
    if not np.allclose(factors, 1.0):
        found = f"code {dataset['units_code']} with factors {factors[0]:g} (length), {factors[1]:g} (force)"
        expected = f"expected SI units, code 1 with factors 1, found {found}; `twin import` takes other units"
        raise InputError(path, "data set 164", expected)


def _in_si(path: Path, number: int, dataset: dict[str, Any], unit: str) -> dict[str, Any]:
    """An FRF in a declared unit as SI; the file's own labels must not say otherwise."""
    if int(dataset["func_type"]) != FRF_FUNCTION:
        return dataset
    where = f"data set {number}: unit"
    try:
        quantity, scale = frf_factor(unit)
    except ValueError as error:
        raise InputError(path, where, str(error)) from error
    response, _, force = unit.rpartition("/")
    for label, declared in (("ordinate_axis_units_lab", response), ("orddenom_axis_units_lab", force)):
        stated = str(dataset.get(label, "")).strip()
        if stated.upper() not in NO_TEXT and not any(same(stated, one) for one in (declared, unit)):
            raise InputError(path, where, f"the file states {stated!r}, the map {unit!r}: correct the map")
    kind = int(dataset["ordinate_spec_data_type"])
    if kind in ORDINATE and ORDINATE[kind][0] != quantity:
        raise InputError(path, where, f"the file holds {ORDINATE[kind][0]}, {unit!r} is one of {quantity}")
    silent = dict.fromkeys(("ordinate_axis_units_lab", "orddenom_axis_units_lab"), "NONE")
    return {**dataset, **silent, "data": np.asarray(dataset["data"]) * scale}


def _label(path: Path, where: str, node: Any, direction: Any) -> str:
    direction = int(direction)
    if not 1 <= abs(direction) <= 3:
        raise InputError(path, where, f"expected a direction from 1 to 3 or -1 to -3, found {direction}")
    return f"{int(node)}{'XYZ'[abs(direction) - 1]}{'+' if direction > 0 else '-'}"


def _take(path: Path, where: str, dataset: dict[str, Any], group: _Functions) -> None:
    """File one data set 58 under its channel pair."""
    pair = (
        _label(path, f"{where} response", dataset["rsp_node"], dataset["rsp_dir"]),
        _label(path, f"{where} reference", dataset["ref_node"], dataset["ref_dir"]),
    )
    where = f"{where} ({'/'.join(pair)})"
    if int(dataset["func_type"]) == FRF_FUNCTION:
        kind = int(dataset["ordinate_spec_data_type"])
        if kind not in ORDINATE:
            raise InputError(
                path, where, f"expected a response of type 8, 11 or 12 (displacement to acceleration), found {kind}"
            )
        denominator = int(dataset["orddenom_spec_data_type"])
        if denominator not in FORCE_DATA:
            raise InputError(path, where, f"expected a reference of type 13 (excitation force), found {denominator}")
        unit = str(dataset.get("ordinate_axis_units_lab", "")).strip()
        if unit.upper() not in NO_TEXT:
            expected = ORDINATE[kind][1]
            _check_si(path, where, unit, f"({expected})/N" if "N" in unit or unit.startswith("1/") else expected)
        unit = str(dataset.get("orddenom_axis_units_lab", "")).strip()
        if unit.upper() not in NO_TEXT:
            _check_si(path, where, unit, "N")
        if not np.iscomplexobj(dataset["data"]):
            raise InputError(path, where, "expected complex data, found real")
    abscissa = int(dataset["abscissa_spec_data_type"])
    if abscissa not in (0, 1, FREQUENCY_DATA):
        raise InputError(path, where, f"expected an abscissa of type 18 (frequency), found {abscissa}")
    kept = group.frf if int(dataset["func_type"]) == FRF_FUNCTION else group.coherence
    if pair in kept:
        raise InputError(path, where, "expected every channel pair once")
    kept[pair] = dataset


def _check_si(path: Path, where: str, unit: str, expected: str) -> None:
    """Raise :class:`InputError` where a label states another unit; a map for ``twin import`` takes it."""
    try:
        check_unit(path, where, unit, expected)
    except InputError as error:
        raise InputError(path, error.field, f"{error.expected}; `twin import` takes it (`unit: g/N`, say)") from error


def _labels(groups: Iterable[_Functions], side: int) -> tuple[str, ...]:
    """Labels of one side, in the order of the files."""
    return tuple(dict.fromkeys(pair[side] for group in groups for pair in group.frf))


def _channels(labels: tuple[str, ...], nodes: dict[int, Point]) -> Channels:
    origin = Point("base", np.zeros(3))
    parts = [_parts(label) for label in labels]
    return Channels(
        labels,
        tuple(nodes.get(node, origin).body for node, _ in parts),
        np.array([nodes.get(node, origin).position for node, _ in parts]),
        np.array([np.sign(direction) * np.eye(3)[abs(direction) - 1] for _, direction in parts]),
    )


def _parts(label: str) -> tuple[int, int]:
    """Node and signed direction 1 … 3 of a label."""
    node, axis, sign = label[:-2], label[-2], label[-1]
    return int(node), ("XYZ".index(axis) + 1) * (1 if sign == "+" else -1)


def _posture(
    source: Path,
    name: str,
    group: _Functions,
    response: tuple[str, ...],
    excitation: tuple[str, ...],
    q_deg: FloatArray | None,
) -> PostureFRF:
    """Assemble one posture; every channel pair must be there, on one frequency axis, in one quantity."""
    where = f"posture {name}"
    for pair in ((r, e) for r in response for e in excitation):
        if pair not in group.frf:
            raise InputError(source, where, f"expected the FRF {'/'.join(pair)}, it is missing")
    first = next(iter(group.frf.values()))
    frequency = np.asarray(first["x"], dtype=np.float64)
    kinds = {int(dataset["ordinate_spec_data_type"]) for dataset in group.frf.values()}
    if len(kinds) > 1:
        raise InputError(source, where, f"expected FRFs of one quantity, found types {sorted(kinds)}")
    for pair, dataset in [*group.frf.items(), *group.coherence.items()]:
        x = np.asarray(dataset["x"])
        if x.shape != frequency.shape or not np.allclose(x, frequency, rtol=1e-5, atol=1e-9):
            raise InputError(source, where, f"expected one frequency axis, {'/'.join(pair)} has another")
    if group.coherence and set(group.coherence) != set(group.frf):
        raise InputError(source, where, "expected the coherence of every FRF or of none")

    def stacked(functions: dict[tuple[str, str], dict[str, Any]]) -> Any:
        return np.stack([[functions[r, e]["data"] for e in excitation] for r in response]).transpose(2, 0, 1)

    words = group.words
    stated, state = _state(source, where, words)
    coherence = np.asarray(stacked(group.coherence).real, dtype=np.float64) if group.coherence else None
    return PostureFRF(
        name, stated if q_deg is None else np.asarray(q_deg, dtype=np.float64), words.get("brakes"), frequency,  # type: ignore[arg-type]
        np.asarray(stacked(group.frf), dtype=np.complex128), ORDINATE[kinds.pop()][0], coherence, **state,
    )  # fmt: skip


# --- writing ----------------------------------------------------------------------------------------------


def write_uff(path: str | Path, campaign: Campaign) -> None:
    """Write FRFs and coherence of all postures as data sets 58, as text, with units and nodes.

    Directions are kept as signed axes and node positions to six digits, which is what the format holds; time records
    are not part of it.
    """
    check_campaign(path, campaign)
    sets = [_units(), _nodes(path, campaign)]
    for posture in campaign.postures.values():
        for e, excitation in enumerate(campaign.excitation.label):
            for r, response in enumerate(campaign.response.label):
                common = _common(campaign, posture, r, e, response, excitation)
                kind = next(k for k, (quantity, _) in ORDINATE.items() if quantity == posture.quantity)
                what = {
                    "ordinate_spec_data_type": kind,
                    "ordinate_axis_units_lab": ORDINATE[kind][1],
                    "orddenom_spec_data_type": FORCE_DATA[1],
                    "orddenom_axis_lab": "Force",
                    "orddenom_axis_units_lab": "N",
                }
                sets.append({**common, "func_type": FRF_FUNCTION, "data": posture.frf[:, r, e], **what})
                if posture.coherence is not None:
                    nothing = {"ordinate_spec_data_type": 0, "orddenom_spec_data_type": 0}
                    data = posture.coherence[:, r, e]
                    sets.append({**common, "func_type": COHERENCE_FUNCTION, "data": data, **nothing})
    _write_sets(path, sets)


def _write_sets(path: str | Path, sets: list[dict[str, Any]]) -> None:
    with replacing(path) as scratch, redirect_stdout(StringIO()):
        pyuff.UFF(str(scratch)).write_sets(sets, mode="overwrite")


def _units() -> dict[str, Any]:
    return dict(
        pyuff.prepare_164(
            units_code=1, units_description="SI", temp_mode=2, length=1.0, force=1.0, temp=1.0, temp_offset=273.15
        )
    )


def _nodes(path: str | Path, campaign: Campaign) -> dict[str, Any]:
    """Data set 15; every node in the frame of its body."""
    position: dict[int, FloatArray] = {}
    for channels in (campaign.response, campaign.excitation):
        for label, at in zip(channels.label, channels.position, strict=True):
            node = _parts(label)[0]
            if np.linalg.norm(position.setdefault(node, at) - at) > 1e-3:
                raise InputError(path, label, f"expected one position for all channels of node {node}")
    xyz = np.array(list(position.values()))
    zeros = [0] * len(position)
    return dict(
        pyuff.prepare_15(
            node_nums=list(position), def_cs=zeros, disp_cs=zeros, color=zeros, x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2]
        )
    )


def _common(campaign: Campaign, posture: PostureFRF, r: int, e: int, response: str, excitation: str) -> dict[str, Any]:
    """Every field that FRF and coherence share; pyuff fills in the others."""
    state = {
        name: None if (value := getattr(posture, name)) is None else f"{value:.9g}"
        for name in ("exponential_window_rate", "averages", "peak_force_n", "pulse_s", "record_s")
    }
    length = {name: state.pop(name) for name in ("pulse_s", "record_s")}
    lines: list[dict[str, Any]] = [
        {"posture": posture.name, "robot": campaign.robot},
        {"q_deg": ",".join(f"{q:.10g}" for q in posture.q_deg) or None},
        {"response_body": campaign.response.body[r], "excitation_body": campaign.excitation.body[e], **length},
        {"brakes": posture.brakes, **state},
    ]
    ids = [" ".join(f"{k}={v}" for k, v in words.items() if v is not None)[:80] or "NONE" for words in lines]
    (response_node, response_direction), (node, direction) = _parts(response), _parts(excitation)
    frequency = posture.frequency
    return {
        "type": 58, "binary": 0, "id1": ids[0], "id2": ids[1], "id4": ids[2], "id5": ids[3],
        "rsp_node": response_node, "rsp_dir": response_direction, "ref_node": node, "ref_dir": direction,
        "abscissa_spacing": 1, "abscissa_spec_data_type": FREQUENCY_DATA, "abscissa_axis_lab": "Frequency",
        "abscissa_axis_units_lab": "Hz", "abscissa_min": float(frequency[0]),
        "abscissa_inc": float(frequency[1] - frequency[0]), "num_pts": frequency.size, "x": frequency,
    }  # fmt: skip


def write_uff_modes(path: str | Path, result: ModalResult) -> None:
    """Write the mode shapes of one posture as data sets 55 (complex modes) over the nodes of its labels."""
    if not result.shape_label or not result.modes:
        raise InputError(path, result.name, "expected modes with channel labels")
    parts = [_parts(label) for label in result.shape_label]
    nodes = sorted({node for node, _ in parts})
    sets = []
    for number, (mode, shape) in enumerate(zip(result.modes, result.shapes, strict=True), 1):
        at = np.zeros((3, len(nodes)), dtype=complex)
        for (node, direction), value in zip(parts, shape, strict=True):
            at[abs(direction) - 1, nodes.index(node)] = np.sign(direction) * value
        ratio = mode.damping_percent / 100
        eigenvalue = 2 * np.pi * mode.frequency_hz * complex(-ratio, np.sqrt(1 - ratio**2))
        sets.append(
            pyuff.prepare_55(
                id1=f"posture={result.name}"[:80],
                id2=f"frequency_hz={mode.frequency_hz:.9g} damping_percent={mode.damping_percent:.9g}",
                id3="NONE", id4="NONE", id5="NONE", model_type=1, analysis_type=3, data_ch=2, spec_data_type=8,
                data_type=5, n_data_per_node=3, load_case=1, mode_n=number, eig=eigenvalue, modal_a=0j, modal_b=0j,
                node_nums=nodes, r1=at[0], r2=at[1], r3=at[2],
            )
        )  # fmt: skip
    _write_sets(path, sets)
