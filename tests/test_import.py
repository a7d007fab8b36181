"""Foreign files, written by other libraries, come in as what was recorded; a slip of units is refused by name."""

import csv
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import mcap_ros2.writer
import nptdms
import numpy as np
import pytest
import pyuff
import rosbags.rosbag1
import rosbags.rosbag2
import rosbags.typesys
import scipy.io
import scipy.io.wavfile
from ruamel.yaml import YAML

from twin.commands.example import EXAMPLES
from twin.commands.foreign import guess_map, import_files
from twin.errors import InputError, Told
from twin.importing.build import _axes
from twin.importing.text import read as read_text
from twin.measure.campaign import read_campaign
from twin.measure.motion_log import read_motion_log

CELL = EXAMPLES / "cell"
G, LBF = 9.80665, 4.4482216152605
N = 1500  # samples of the log that are written out
MOTOR = 100.0  # torque per unit of current
POINTS = slice(6, 8)  # hammer points


@dataclass
class Recorded:
    """What the example holds, read without our code."""

    time: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    frequency: np.ndarray
    frf: np.ndarray
    coherence: np.ndarray
    force: np.ndarray
    response: np.ndarray
    rate: float  # of the blows, Hz
    q_deg: list[float]
    nodes: list[dict[str, Any]]
    sensors: list[dict[str, Any]]

    @property
    def axes(self) -> int:
        return self.q.shape[1]


@pytest.fixture(scope="module")
def cell() -> Recorded:
    with h5py.File(CELL / "log.h5") as file, h5py.File(CELL / "campaign.h5") as campaign:
        run, posture = file["runs/run1"], campaign["postures/upright"]

        def points(side: str, some: slice) -> list[dict[str, Any]]:
            group = campaign[side]
            rows = zip(group["label"].asstr()[some], group["body"].asstr()[some], group["position"][some], strict=True)
            return [{"label": label, "body": body, "position": at.tolist()} for label, body, at in rows]

        return Recorded(
            run["time"][:N], run["position"][:N], run["torque"][:N],
            posture["frequency"][()], posture["frf"][:, :, POINTS], posture["coherence"][:, :, POINTS],
            posture["hits/force"][POINTS], posture["hits/response"][POINTS], 256.0, posture.attrs["q_deg"].tolist(),
            points("excitation", POINTS), points("response", slice(None)),
        )  # fmt: skip


def mapped(tmp_path: Path, **content: Any) -> Path:
    path = tmp_path / "map.yaml"
    YAML(typ="safe", pure=True).dump(content, path)
    return path


# --- motion logs ----------------------------------------------------------------------------------------------


def german(path: Path, cell: Recorded) -> dict[str, Any]:
    axes = range(1, cell.axes + 1)
    header = ["Zeit [ms]", *(f"Achse {i} [°]" for i in axes), *(f"Moment {i} [kNm]" for i in axes)]
    rows = np.column_stack([1e3 * cell.time, np.rad2deg(cell.q), cell.tau / 1e3])
    lines = [";".join(header), *(";".join(f"{x:.9f}".replace(".", ",") for x in row) for row in rows)]
    path.write_text("\n".join(lines), encoding="cp1252")
    return {
        "time": {"channels": "Zeit", "unit": "ms"},
        "position": {"channels": "Achse *", "unit": "°"},
        "torque": {"channels": "Moment *", "unit": "kNm"},
    }


def tsv(path: Path, cell: Recorded) -> dict[str, Any]:
    rows = np.column_stack([cell.time, cell.q, cell.tau / LBF / 0.0254])
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, dialect="excel-tab")
        writer.writerow(["t", *(f"{what}{i + 1}" for what in ("q", "tau") for i in range(cell.axes))])
        writer.writerows(rows.tolist())
    return {
        "time": {"channels": "t", "unit": "s"},
        "position": {"channels": "q*", "unit": "rad"},
        "torque": {"channels": "tau*", "unit": "lbf·in"},
    }


def rtde(path: Path, cell: Recorded) -> dict[str, Any]:
    """As the record script of UR's RTDE client writes it; current stands for torque, by a constant per axis."""
    constants = [MOTOR * (i + 1) for i in range(cell.axes)]
    names = ["timestamp", *(f"actual_{what}_{i}" for what in ("q", "current") for i in range(cell.axes))]
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, delimiter=" ")
        writer.writerow(names)
        writer.writerows(np.column_stack([cell.time, cell.q, cell.tau / constants]).tolist())
    return {
        "time": {"channels": "timestamp", "unit": "s"},
        "position": {"channels": "actual_q_*", "unit": "rad"},
        "torque": {"channels": "actual_current_*", "unit": "Nm", "factor": constants},
    }


def krc(path: Path, cell: Recorded) -> dict[str, Any]:
    """A DIAdem header in the layout that KRC4 traces have, numbers beside it."""
    block = np.column_stack([np.rad2deg(cell.q), cell.tau])
    block.astype("<f8").tofile(path.with_suffix(".r64"))
    names = [f"{what}_A{i + 1}" for what in ("Istposition", "Moment") for i in range(cell.axes)]
    head = ["DIAEXTENDED", "#BEGINGLOBALHEADER", "  1,DOS", "112,High -> Low", "#ENDGLOBALHEADER"]
    count = f"220,{len(cell.time)}"
    head += ["#BEGINCHANNELHEADER", "200,Zeit", "202,sec", "210,IMPLIZIT  ", count, f"240,{cell.time[0]}",
             f"241,{cell.time[1] - cell.time[0]!r}", "#ENDCHANNELHEADER"]  # fmt: skip
    for i, name in enumerate(names, 1):
        head += ["#BEGINCHANNELHEADER", f"200,{name}", f"202,{'°' if i <= cell.axes else 'Nm'}", "210,EXPLIZIT",
                 f"211,{path.stem}.r64", "213,BLOCK", "214,REAL64", count, f"221,{i}", "240,0",
                 "241,1.000000e+00", "#ENDCHANNELHEADER"]  # fmt: skip
    path.write_text("\n".join(head).replace("np.float64(", "").replace(")", ""), encoding="cp1252")
    return {
        "time": {"channels": "Zeit", "unit": "s"},
        "position": {"channels": "Istposition_A*", "unit": "deg"},
        "torque": {"channels": "Moment_A*", "unit": "N·m"},
    }


def mat5(path: Path, cell: Recorded) -> dict[str, Any]:
    scipy.io.savemat(path, {"log": {"t": cell.time, "q": cell.q, "tau": cell.tau}, "who": "lab"})
    return {
        "time": {"channels": "log.t", "unit": "s"},
        "position": {"channels": "log.q*", "unit": "rad"},
        "torque": {"channels": "log.tau*", "unit": "Nm"},
    }


def mat73_log(path: Path, cell: Recorded) -> dict[str, Any]:
    with h5py.File(path, "w", userblock_size=512) as file:  # MATLAB writes axes in reverse
        file["t"], file["q"], file["tau"] = cell.time[None], cell.q.T, cell.tau.T
    return {
        "time": {"channels": "t", "unit": "s"},
        "position": {"channels": "q*", "unit": "rad"},
        "torque": {"channels": "tau*", "unit": "Nm"},
    }


def tdms_log(path: Path, cell: Recorded) -> dict[str, Any]:
    properties = {"wf_increment": float(cell.time[1] - cell.time[0])}
    with nptdms.TdmsWriter(path) as writer:
        for name, values, unit in (("q", cell.q, "rad"), ("M", cell.tau, "Nm")):
            for i, column in enumerate(values.T):
                said = {**properties, "unit_string": unit}
                writer.write_segment([nptdms.ChannelObject("log", f"{name}{i}", np.ascontiguousarray(column), said)])
    return {"position": {"channels": "q*", "unit": "rad"}, "torque": {"channels": "M*", "unit": "Nm"}}


JOINT_STATES = {
    "position": {"channels": "position.*", "unit": "rad"},
    "torque": {"channels": "effort.*", "unit": "Nm"},
    "time": {"channels": "time", "unit": "s"},
}


def bag(path: Path, cell: Recorded, plugin: Any = rosbags.rosbag2.StoragePlugin.SQLITE3) -> dict[str, Any]:
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_HUMBLE)
    types = store.types
    with rosbags.rosbag2.Writer(path, version=8, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for t, q, tau in zip(cell.time, cell.q, cell.tau, strict=True):
            ns = round(t * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
            order = [*range(2, cell.axes), *range(min(2, cell.axes))]  # joints come in any order
            message = types["sensor_msgs/msg/JointState"](
                types["std_msgs/msg/Header"](stamp, ""), [f"joint_a{i + 1}" for i in order], q[order], q[:0], tau[order]
            )
            writer.write(topic, ns, store.serialize_cdr(message, topic.msgtype))
    return JOINT_STATES


def bag1(path: Path, cell: Recorded) -> dict[str, Any]:
    """A bag of ROS 1: one file, its messages of another format."""
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS1_NOETIC)
    types = store.types
    names = [f"joint_a{i + 1}" for i in range(cell.axes)]
    with rosbags.rosbag1.Writer(path) as writer:
        topic = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for t, q, tau in zip(cell.time, cell.q, cell.tau, strict=True):
            ns = round(t * 1e9)
            header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9), "")
            message = types["sensor_msgs/msg/JointState"](header, names, q, q[:0], tau)
            writer.write(topic, ns, store.serialize_ros1(message, topic.msgtype))
    return JOINT_STATES


JOINT_STATE_MSG = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


def mcap(path: Path, cell: Recorded) -> dict[str, Any]:
    with path.open("wb") as stream:
        writer = mcap_ros2.writer.Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE_MSG)
        for t, q, tau in zip(cell.time, cell.q, cell.tau, strict=True):
            ns = round(t * 1e9)
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}
            joints = {
                "name": [f"a{i + 1}" for i in range(cell.axes)],
                "position": q.tolist(),
                "velocity": [],
                "effort": tau.tolist(),
            }
            writer.write_message("/joint_states", schema, {"header": header, **joints}, log_time=ns, publish_time=ns)
        writer.finish()
    return JOINT_STATES


LOGS = {
    "german.csv": german,
    "lbf.tsv": tsv,
    "robot_data.csv": rtde,
    "trace.dat": krc,
    "v5.mat": mat5,
    "v73.mat": mat73_log,
    "log.tdms": tdms_log,
    "bag": bag,
    "ros1.bag": bag1,
    "joints.mcap": mcap,
}


@pytest.mark.parametrize("name", LOGS)
def test_a_foreign_log_comes_in_as_it_was_recorded(name: str, cell: Recorded, tmp_path: Path) -> None:
    plan = LOGS[name](tmp_path / name, cell)
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    guess_map([tmp_path / name])
    import_files([tmp_path / name], path, tmp_path / "log.h5")
    with h5py.File(tmp_path / "log.h5") as file:
        (run,) = file["runs"].values()
        np.testing.assert_allclose(run["position"][()], cell.q, atol=1e-8)
        np.testing.assert_allclose(run["torque"][()], cell.tau, rtol=1e-8, atol=1e-5)
        assert run.attrs["sample_rate_hz"] == pytest.approx(250, rel=1e-6)


# --- hammer tests -----------------------------------------------------------------------------------------------


def universal(path: Path, cell: Recorded, binary: bool, response: float = 1.0, force: float = 1.0) -> None:
    """As Testlab exports: no words of ours, nodes in the map alone."""
    si = {"units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0, "temp": 1.0}
    sets = [pyuff.prepare_164(**si, temp_offset=273.15)]
    for e, point in enumerate(cell.nodes):
        for r, sensor in enumerate(cell.sensors):
            for function, data in ((4, cell.frf[:, r, e] * force / response), (6, cell.coherence[:, r, e])):
                sets.append(
                    pyuff.prepare_58(
                        binary=int(binary), func_type=function, id1="Record  1", id2="FRF", id3="12-Mar-24",
                        id4="NONE", id5="NONE", ver_num=0, load_case_id=0, rsp_ent_name="Robot", ref_ent_name="Robot",
                        rsp_node=int(sensor["label"][:-2]), rsp_dir="XYZ".index(sensor["label"][-2]) + 1,
                        ref_node=int(point["label"][:-2]),
                        ref_dir=("XYZ".index(point["label"][-2]) + 1) * (1 if point["label"][-1] == "+" else -1),
                        ord_data_type=6 if function == 4 else 4, num_pts=len(data), abscissa_spacing=1,
                        abscissa_min=cell.frequency[0], abscissa_inc=cell.frequency[1] - cell.frequency[0],
                        z_axis_value=0.0, abscissa_spec_data_type=18, ordinate_spec_data_type=12,
                        orddenom_spec_data_type=13, data=data, x=cell.frequency,
                    )
                )  # fmt: skip
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    if binary:  # pyuff 2.5 states half the bytes of complex numbers, which an analyser does not
        half = re.compile(rb"(?<=    58b)(.{24})%12d(?=.{24}\n(?:[^\n]*\n){6} {9}6)" % (8 * len(cell.frequency)))
        path.write_bytes(half.sub(rb"\g<1>%12d" % (16 * len(cell.frequency)), path.read_bytes()))


def stance(cell: Recorded, **more: Any) -> dict[str, Any]:
    return {"upright": {"q_deg": cell.q_deg, "brakes": "off", **more}}


def nodes(cell: Recorded) -> dict[int, Any]:
    return {int(p["label"][:-2]): {"body": p["body"], "position": p["position"]} for p in cell.nodes + cell.sensors}


@pytest.mark.parametrize("binary", [False, True], ids=["58", "58b"])
@pytest.mark.parametrize(("unit", "response", "force"), [("(m/s²)/N", 1.0, 1.0), ("g/lbf", G, LBF)])
def test_universal_files_without_any_words(
    binary: bool, unit: str, response: float, force: float, cell: Recorded, tmp_path: Path
) -> None:
    universal(tmp_path / "export.unv", cell, binary, response, force)
    plan = mapped(tmp_path, makes="frf-campaign", robot="kr90", postures=stance(cell), nodes=nodes(cell), unit=unit)
    import_files([tmp_path / "export.unv"], plan, tmp_path / "campaign.h5")
    check_campaign_file(tmp_path / "campaign.h5", cell)


def test_universal_files_of_one_point_each_are_one_posture(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    """Files of the same points are postures; a node that the map's ``nodes`` lack is not put at the foot."""
    universal(tmp_path / "all.unv", cell, binary=False)
    again = tmp_path / "again.unv"
    again.write_bytes((tmp_path / "all.unv").read_bytes())
    assert list(guess_map([tmp_path / "all.unv", again])["postures"]) == ["all", "again"]
    whole, files = pyuff.UFF(str(tmp_path / "all.unv")).read_sets(), []
    for blow in sorted({(s["ref_node"], s["ref_dir"]) for s in whole if s["type"] == 58}):
        files.append(tmp_path / f"p{blow[0]}_{blow[1]}.unv")
        some = [s for s in whole if s["type"] != 58 or (s["ref_node"], s["ref_dir"]) == blow]
        pyuff.UFF(str(files[-1])).write_sets(some, mode="overwrite")
    assert len(files) > 1
    found = guess_map(files)
    assert found["postures"] == {"posture": {"q_deg": "ask", "files": "*"}}
    assert set(found["nodes"]) >= {int(p["label"][:-2]) for p in cell.nodes}
    some = {99: nodes(cell)[21]}
    plan = mapped(tmp_path, makes="frf-campaign", postures=stance(cell), nodes=some, unit="m/s²/N")
    refused(twin("import", tmp_path / "all.unv", "--map", plan, "-o", tmp_path / "c.h5"), "expected its body and place",
            tmp_path / "c.h5")  # fmt: skip


def test_blows_of_a_coherence_that_universal_files_do_not_count(cell: Recorded, tmp_path: Path) -> None:
    universal(tmp_path / "export.unv", cell, binary=False)
    said = {"makes": "frf-campaign", "robot": "kr90", "postures": stance(cell), "nodes": nodes(cell), "unit": "m/s²/N"}
    with pytest.warns(Told, match=r"postures.upright: averages: are not stated, .* give them as averages in the map"):
        import_files([tmp_path / "export.unv"], mapped(tmp_path, **said), tmp_path / "campaign.h5")
    import_files([tmp_path / "export.unv"], mapped(tmp_path, **said, averages=5), tmp_path / "campaign.h5")
    (posture,) = read_campaign(tmp_path / "campaign.h5").postures.values()
    assert posture.averages == 5
    assert posture.coherence is not None


def test_what_frfs_do_not_say_of_their_blows(cell: Recorded, tmp_path: Path) -> None:
    """One posture struck at two forces: a file each, and the map says forces, pulse, record and window."""
    forces = {"soft": 100.0, "hard": 600.0}
    for name in forces:
        universal(tmp_path / f"{name}.unv", cell, binary=False)
    levels = {n: {**stance(cell)["upright"], "files": f"{n}.unv", "peak_force_n": f} for n, f in forces.items()}
    blows = {"averages": 3, "pulse_s": 0.004, "record_s": 2.0, "exponential_window_rate": 1.5}
    said = {"makes": "frf-campaign", "robot": "kr90", "nodes": nodes(cell), "unit": "m/s²/N", **blows}
    files = [tmp_path / f"{name}.unv" for name in forces]
    import_files(files, mapped(tmp_path, **said, postures=levels), tmp_path / "campaign.h5")
    read = read_campaign(tmp_path / "campaign.h5").postures
    assert {name: posture.peak_force_n for name, posture in read.items()} == forces
    assert all(getattr(posture, field) == value for posture in read.values() for field, value in blows.items())


def check_campaign_file(path: Path, cell: Recorded, rtol: float = 1e-5) -> None:
    with h5py.File(path) as file:
        assert file["response/label"].asstr()[()].tolist() == [s["label"] for s in cell.sensors]
        assert file["excitation/body"].asstr()[()].tolist() == [p["body"] for p in cell.nodes]
        np.testing.assert_allclose(file["excitation/position"], [p["position"] for p in cell.nodes])
        (posture,) = file["postures"].values()
        lines = np.isin(np.round(posture["frequency"][()], 6), np.round(cell.frequency, 6))
        difference = posture["frf"][lines] - cell.frf[: lines.sum()]
        assert np.linalg.norm(difference) < rtol * np.linalg.norm(cell.frf)


def matlab_frfs(path: Path, cell: Recorded) -> dict[str, Any]:
    """v7.3, in mm/s² per N, by a name that says so."""
    pairs = np.zeros(cell.frf.T.shape, dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"], pairs["imag"] = cell.frf.T.real * 1e3, cell.frf.T.imag * 1e3
    with h5py.File(path, "w", userblock_size=512) as file:
        file["f"], file["H"], file["coh"] = cell.frequency[None], pairs, cell.coherence.T
    return arrays(cell, unit="mm/s²/N")


def matlab5_frfs(path: Path, cell: Recorded) -> dict[str, Any]:
    """v5, in g per N."""
    scipy.io.savemat(path, {"f": cell.frequency, "H": cell.frf / G, "coh": cell.coherence})
    return arrays(cell, unit="g/N")


def arrays(cell: Recorded, unit: str) -> dict[str, Any]:
    return {
        "postures": stance(cell), "excitation": cell.nodes, "response": cell.sensors, "coherence": "coh",
        "averages": 3, "record_s": 4.0, "frf": {"channels": "H", "unit": unit},
        "frequency": {"channels": "f", "unit": "Hz"},
    }  # fmt: skip


@pytest.mark.parametrize("write", [matlab_frfs, matlab5_frfs])
def test_matlab_holds_frfs(write: Callable[..., dict[str, Any]], cell: Recorded, tmp_path: Path) -> None:
    plan = mapped(tmp_path, makes="frf-campaign", robot="kr90", **write(tmp_path / "frf.mat", cell))
    assert guess_map([tmp_path / "frf.mat"])["frf"]["unit"] == "ask"
    import_files([tmp_path / "frf.mat"], plan, tmp_path / "campaign.h5")
    check_campaign_file(tmp_path / "campaign.h5", cell)
    assert [p.record_s for p in read_campaign(tmp_path / "campaign.h5").postures.values()] == [4.0]


def one_record(cell: Recorded, point: int) -> np.ndarray:
    """Force and responses (nt, 4) of all blows at a point, one after another in one record."""
    hits = [np.vstack([cell.force[point, h][None], cell.response[point, h]]) for h in range(cell.force.shape[1])]
    return np.hstack(hits).T


def records(folder: Path, kind: str, cell: Recorded) -> tuple[list[Path], dict[str, Any]]:
    """A file per hammer point, all its blows in one running record; a WAV holds shares of full scale."""
    files = []
    for i in range(len(cell.nodes)):
        record, path = one_record(cell, i), folder / f"point{i}.{kind}"
        if kind == "wav":
            scipy.io.wavfile.write(path, round(cell.rate), (record / [1000, 10, 10, 10]).astype(np.float32))
        else:
            with nptdms.TdmsWriter(path) as writer:
                for name, column in zip(["Hammer", "X", "Y", "Z"], record.T, strict=True):
                    said = {"wf_increment": 1 / cell.rate, "unit_string": "N" if name == "Hammer" else "m/s^2"}
                    writer.write_segment([nptdms.ChannelObject("hits", name, np.ascontiguousarray(column), said)])
        files.append(path)
    names = [f"channel.{i}" for i in range(1, 5)] if kind == "wav" else ["Hammer", "X", "Y", "Z"]
    scale = (1000, 10) if kind == "wav" else (1, 1)
    return files, {
        "postures": stance(cell),
        "force": {"channels": [names[0]], "unit": "N", "factor": scale[0]},
        "response": [{**s, "channel": n, "unit": "m/s²", "factor": scale[1]}
                     for s, n in zip(cell.sensors, names[1:], strict=True)],
        "excitation": [{**p, "files": f"point{i}.{kind}"} for i, p in enumerate(cell.nodes)],
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["wav", "tdms"])
def test_blows_are_found_in_a_running_record(kind: str, cell: Recorded, tmp_path: Path) -> None:
    files, plan = records(tmp_path, kind, cell)
    path = mapped(
        tmp_path, makes="frf-campaign", robot="kr90", record_s=3.9, pretrigger_s=0.05, band_hz=[5, 45], **plan
    )
    import_files(files, path, tmp_path / "campaign.h5")
    with h5py.File(tmp_path / "campaign.h5") as file:
        posture = file["postures/upright"]
        force = posture["hits/force"][()]
        assert force.shape[:2] == (2, 3)
        np.testing.assert_allclose(force.max(axis=2), cell.force.max(axis=2), rtol=1e-5)
        np.testing.assert_allclose(
            np.abs(posture["hits/response"][()]).max(axis=3), np.abs(cell.response).max(axis=3), rtol=1e-5
        )
        assert posture["frequency"][0] >= 5
        assert posture["frequency"][-1] <= 45


def test_a_blow_that_bounced_is_told(cell: Recorded, tmp_path: Path) -> None:
    force = cell.force.copy()
    force[1, 2] += 0.4 * np.roll(force[1, 2], round(0.5 * cell.rate))
    files, plan = records(tmp_path, "wav", replace(cell, force=force))
    path = mapped(tmp_path, makes="frf-campaign", robot="kr90", record_s=3.9, pretrigger_s=0.05, **plan)
    (note,) = import_files(files, path).notes
    assert note == f"upright: blow 3 at {cell.nodes[1]['label']} left out: double hit: the second has 40 % of the first"


# --- slips -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("truly", "declared", "named"),
    [
        ((G, 1), "(m/s²)/N", "looks like g"),
        ((1e-3, 1), "(m/s²)/N", "looks like mm (mm/s²)"),
        ((1, LBF), "(m/s²)/N", "looks like lbf"),
    ],
)
def test_a_slip_of_units_in_frfs_is_named(
    truly: tuple[float, float], declared: str, named: str, cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    universal(tmp_path / "e.unv", cell, True, *truly)
    plan = mapped(tmp_path, makes="frf-campaign", robot="kr90", postures=stance(cell), nodes=nodes(cell), unit=declared)
    refused(twin("import", tmp_path / "e.unv", "--map", plan, "-o", tmp_path / "c.h5"), named, tmp_path / "c.h5")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"position": {"channels": "q*", "unit": "rad", "factor": 57.3}}, "look like degrees"),
        ({"torque": {"channels": "tau*", "unit": "Nm", "factor": 1e3}}, "look like N·mm"),
        ({"torque": {"channels": "tau*", "unit": "Nm", "factor": 1e-4}}, "look like kN·m"),
        ({"torque": {"channels": "tau*", "unit": "kN·m"}}, "look like N·m, declared kN·m"),
        ({"torque": {"channels": "tau*", "unit": "N·mm"}}, "look like N·m, declared N·mm"),
        ({"position": {"channels": "q*", "unit": "deg"}}, "look like rad, declared degrees"),
        ({"torque": {"channels": "tau*", "unit": "N·m"}}, "look like lbf·in, declared N·m"),
        ({"torque": {"channels": "tau*", "unit": "lbf·in", "factor": LBF * 0.0254}}, "look like N·m, declared lbf·in"),
        ({"torque": {"channels": "tau*", "unit": "ask"}}, "never guessed"),
        ({"torque": {"channels": "tau*", "unit": "rad"}}, "expected a unit of torque"),
        ({"torque": {"channels": "moment*", "unit": "Nm"}}, "fits no channel"),
        ({"time": {"channels": "t", "unit": "ms"}, "colour": 1}, "unknown field"),
    ],
)
def test_a_slip_of_units_in_a_log_is_named(
    change: dict[str, Any], named: str, cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    plan = tsv(tmp_path / "l.tsv", cell) | change
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    refused(twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5"), named, tmp_path / "l.h5")


def test_a_clock_in_milliseconds_is_not_taken_for_seconds(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    plan = tsv(tmp_path / "l.tsv", replace(cell, time=1e3 * cell.time))
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    said = twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5")
    refused(said, "are these milliseconds?", tmp_path / "l.h5")


def blows_as_text(folder: Path, cell: Recorded, sign: float = 1.0) -> tuple[list[Path], dict[str, Any]]:
    """A running record per hammer point, as CSV with a clock."""
    files = []
    for i in range(len(cell.nodes)):
        record = one_record(cell, i) * [sign, 1, 1, 1]
        rows = np.column_stack([np.arange(len(record)) / cell.rate, record])
        files.append(folder / f"point{i}.csv")
        header = "Zeit [s],Hammer [N],X [m/s²],Y [m/s²],Z [m/s²]"
        np.savetxt(files[-1], rows, fmt="%.9g", delimiter=",", header=header, comments="", encoding="utf-8")
    return files, {
        "postures": stance(cell),
        "force": {"channels": ["Hammer"], "unit": "N"},
        "response": [{**s, "channel": n, "unit": "m/s²"} for s, n in zip(cell.sensors, "XYZ", strict=True)],
        "excitation": [{**p, "files": f"point{i}*"} for i, p in enumerate(cell.nodes)],
        "record_s": 3.9, "band_hz": [5, 45], "makes": "frf-campaign", "robot": "kr90",
    }  # fmt: skip


def test_blows_are_read_at_the_rate_of_the_clock_in_the_file(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    files, plan = blows_as_text(tmp_path, cell)
    out = tmp_path / "c.h5"
    wrong = mapped(tmp_path, **plan, sample_rate_hz=2 * cell.rate)
    refused(twin("import", *files, "--map", wrong, "-o", out), "by the file's clock 'Zeit'", out)
    longer = mapped(tmp_path, **plan | {"record_s": 1e3})
    refused(twin("import", *files, "--map", longer, "-o", out), "record_s: found 1000 s; expected at most", out)
    said = twin("import", *files, "--map", mapped(tmp_path, **plan), "-o", out)
    assert said.code == 0, said.err
    assert not said.err
    with h5py.File(out) as file:
        assert file["postures/upright/hits"].attrs["sample_rate_hz"] == cell.rate
    lines = files[0].read_text(encoding="utf-8").splitlines()
    again = [line if i < 200 else f"0,{line.partition(',')[2]}" for i, line in enumerate(lines)]
    files[0].write_text("\n".join(again), encoding="utf-8")  # a clock that stands still: no rate, and no contradiction
    refused(twin("import", *files, "--map", mapped(tmp_path, **plan), "-o", tmp_path / "d.h5"), "no even clock",
            tmp_path / "d.h5")  # fmt: skip
    right = mapped(tmp_path, **plan, sample_rate_hz=cell.rate)
    assert twin("import", *files, "--map", right, "-o", tmp_path / "d.h5").code == 0
    guessed = twin("import", files[0], "--guess").out
    assert "channels: [Zeit]" in guessed
    assert "record_s: ask" in guessed
    assert "q_deg: ask" in guessed
    assert "position: ask" in guessed


def test_a_column_of_dates_is_left_out_and_told(tmp_path: Path) -> None:
    """German text: semicolons, decimal commas, a date before the numbers."""
    rows = "".join(f"29.11.2026;{k},5;{2 * k},25\n" for k in range(5))
    (tmp_path / "log.csv").write_text(f"Datum;Zeit [s];Achse1 [rad]\n{rows}")
    with pytest.warns(Told, match="text, no numbers, and left out: 'Datum'"):
        (table,) = read_text(tmp_path / "log.csv")
    assert list(table.channels) == ["Zeit", "Achse1"]
    np.testing.assert_allclose(table.channels["Achse1"].values, 2 * np.arange(5) + 0.25)
    (tmp_path / "words.csv").write_text("a;b;c\n" + "one;two;3\n" * 5)
    with pytest.raises(InputError, match="expected columns of numbers"):
        read_text(tmp_path / "words.csv")


@pytest.mark.parametrize(
    "stamps",
    [
        ["23:59:59.996", "23:59:59.998", "00:00:00.000", "00:00:00.002"],
        ["29.11.2026 23:59:59,996", "29.11.2026 23:59:59,998", "30.11.2026 0:00:00,000", "30.11.2026 0:00:00,002"],
        [
            "2026-11-29T23:59:59.996Z",
            "2026-11-29T23:59:59.998Z",
            "2026-11-30T00:00:00.000Z",
            "2026-11-30T00:00:00.002Z",
        ],
        ["11:59:59.996 PM", "11:59:59.998 PM", "12:00:00.000 AM", "12:00:00.002 AM"],
    ],
)
def test_times_of_day_are_a_clock_that_goes_on_over_midnight(stamps: list[str], tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(f"{stamp};{k},5;{k},25\n" for k, stamp in enumerate(stamps))
    path.write_text(f"Uhrzeit;Achse1 [rad];M1 [Nm]\nhh:mm:ss;;\n{rows}")
    (table,) = read_text(path)
    assert table.channels["Uhrzeit"].unit == "s"
    np.testing.assert_allclose(table.channels["Uhrzeit"].values, 86400 + 0.002 * np.arange(-2, 2), rtol=0, atol=1e-9)
    np.testing.assert_allclose(table.channels["Achse1"].values, np.arange(4) + 0.5)
    assert guess_map([path])["time"] == {"channels": ["Uhrzeit"], "unit": "s"}
    path.write_text("Uhrzeit;Achse1 [rad];M1 [Nm]\n" + "25:99:99;1,0;2,0\n" * 4)
    with pytest.warns(Told, match="text, no numbers, and left out: 'Uhrzeit'"):
        read_text(path)


def test_of_two_clocks_the_finer_one_is_guessed(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("Uhrzeit;t [s];Achse1 [rad]\n" + "".join(f"10:00:00;{k},5;{2 * k},25\n" for k in range(5)))
    assert guess_map([path])["time"] == {"channels": ["t"], "unit": "s"}


@pytest.mark.parametrize(("unit", "what"), [("%", "rated torque over 100"), ("A", "torque constant, N·m/A")])
def test_what_makes_torques_of_a_drive_s_numbers_is_told(tmp_path: Path, unit: str, what: str) -> None:
    rows = "".join(f"{0.01 * k:.2f},{0.1 * k},{k}\n" for k in range(40))
    (tmp_path / "log.csv").write_text(f"t [s],A1 [deg],Torque_A1 [{unit}]\n{rows}")
    with pytest.warns(Told, match=f"torque: is stated in {unit}.*{what}"):
        plan = guess_map([tmp_path / "log.csv"])
    assert plan["torque"]["unit"] == "ask"


def test_a_guessed_map_takes_points_and_units_from_names(tmp_path: Path) -> None:
    """Sensors A1X, A3Y and blows h2Z; an axis' rax_1_trq_Nm beside t_s."""
    rows = "\n".join(f"{0.001 * k},{k % 3},{k % 5},{k % 7}" for k in range(40))
    for name in ("h2Z", "h4X"):
        (tmp_path / f"{name}.csv").write_text(f"time [s],Hammer [N],A1X [g],A3Y [g]\n{rows}\n")
    found = guess_map([tmp_path / "h2Z.csv", tmp_path / "h4X.csv"])
    assert [one["label"] for one in found["response"]] == ["1X+", "3Y+"]
    assert [one["label"] for one in found["excitation"]] == ["2Z+", "4X+"]
    (tmp_path / "log.csv").write_text(f"t_s,rax_1_pos_deg,rax_1_trq_Nm,rax_1_temp\n{rows}\n")
    found = guess_map([tmp_path / "log.csv"])
    assert found["time"] == {"channels": ["t_s"], "unit": "s"}
    assert (found["position"]["unit"], found["torque"]["unit"]) == ("deg", "Nm")
    assert found["torque"]["channels"] == ["rax_1_trq_Nm"]
    (tmp_path / "plain.csv").write_text(f"t [s],A1 [deg],v1 [deg/s],I1 [A]\n{rows}\n")
    found = guess_map([tmp_path / "plain.csv"])  # names that tell nothing, beside units that do
    assert (found["position"]["channels"], found["position"]["unit"]) == (["A1"], "deg")
    assert (found["velocity"]["channels"], found["velocity"]["unit"]) == (["v1"], "deg/s")
    assert (found["torque"]["channels"], found["torque"]["unit"]) == (["I1"], "ask")


def test_a_hammer_of_the_other_sign_is_told(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    files, plan = blows_as_text(tmp_path, cell, sign=-1.0)
    said = twin("import", *files, "--map", mapped(tmp_path, **plan), "-o", tmp_path / "c.h5")
    assert "FRFs have the opposite sign" in said.err


def test_a_node_without_a_place_is_not_put_at_the_foot(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    universal(tmp_path / "e.unv", cell, True)
    lost, *others = nodes(cell)
    plan = {"makes": "frf-campaign", "robot": "kr90", "postures": stance(cell), "unit": "(m/s²)/N"}
    for some in ({n: nodes(cell)[n] for n in others}, {}):
        path = mapped(tmp_path, **plan, nodes=some)
        said = twin("import", tmp_path / "e.unv", "--map", path, "-o", tmp_path / "c.h5")
        refused(said, "expected its body and place", tmp_path / "c.h5")
    assert f"{lost}:\n    body: ask\n    position: ask" in twin("import", tmp_path / "e.unv", "--guess").out


def test_an_unknown_unit_is_left_to_ask_and_those_that_fit_are_listed(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    plan = tsv(tmp_path / "l.tsv", cell) | {"position": {"channels": "q*", "unit": "Grad"}}
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    said = twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5")
    refused(said, "unknown unit 'Grad'; expected one of deg, in, m, mm, rad, rev, um, °", tmp_path / "l.h5")
    german(tmp_path / "g.csv", cell)
    text = (tmp_path / "g.csv").read_text(encoding="cp1252").replace("[°]", "[Grad]")
    (tmp_path / "g.csv").write_text(text, encoding="cp1252")
    assert guess_map([tmp_path / "g.csv"])["position"]["unit"] == "ask"


def test_torque_at_the_motor_is_told(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    """It is less by the gear ratio, which no unit explains: a note, here and wherever the log is compared."""
    plan = tsv(tmp_path / "l.tsv", cell) | {"torque": {"channels": "tau*", "unit": "lbf·in", "factor": 1 / 40}}
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    said = twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5")
    assert said.code == 0
    assert "times the recorded torque: is it the torque at the motor (factor: the gear ratio)" in said.err
    assert "is it the torque at the motor" in twin("compare", tmp_path / "l.h5").out


def test_rad_declared_as_degrees_are_told(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    """Where torques do not say so: no axis moves as far as one would record."""
    other = replace(cell, tau=np.random.default_rng(1).permutation(cell.tau))
    plan = tsv(tmp_path / "l.tsv", other) | {"position": {"channels": "q*", "unit": "deg"}}
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    said = twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5")
    assert "are these rad, declared deg?" in said.err


def test_a_clock_in_another_unit_is_not_called_degrees(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    plan = tsv(tmp_path / "l.tsv", cell) | {"time": {"channels": "t", "unit": "us"}}
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    said = twin("import", tmp_path / "l.tsv", "--map", path, "-o", tmp_path / "l.h5")
    assert (said.code, "degrees" in said.err) == (2, False)
    assert "is the clock in s, and are these positions?" in said.err


def test_an_offset_is_added_after_the_factor(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    """A motor's zero is seldom the robot's. Runs without a clock begin together, which is told; JSON has names."""
    plan = tsv(tmp_path / "a.tsv", cell)
    tsv(tmp_path / "b.tsv", cell)
    shift = [0.1, -0.05, 0.15]
    moved = {**plan["position"], "offset": shift}
    path = mapped(tmp_path, makes="motion-log", sample_rate_hz=250, position=moved, torque=plan["torque"])
    said = twin("import", tmp_path / "a.tsv", tmp_path / "b.tsv", "--map", path, "-o", tmp_path / "l.h5", "--json")
    assert said.code == 0, said.err
    assert {"run": "a", "axes": 3, "samples": N, "sample_rate_hz": 250.0, "start_s": 0.0} in said.json["parts"]
    assert "the clock of every run begins at 0" in said.json["notes"][-1]
    with h5py.File(tmp_path / "l.h5") as file:
        found = file["runs/a/position"][()] - cell.q
    np.testing.assert_allclose(found, np.tile(shift, (N, 1)), atol=1e-7)
    plan["position"]["offset"] = [1.0, 2.0]
    path = mapped(tmp_path, makes="motion-log", **plan)
    refused(twin("import", tmp_path / "a.tsv", "--map", path, "-o", tmp_path / "m.h5"), "offset", tmp_path / "m.h5")


def test_positions_and_torques_of_two_files_are_one_run(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    """The wrist's motor turns with the axis before it: rows of ``factor`` are a matrix. The guess joins the files."""
    turns = np.array([[100.0, 0, 0], [0, 120, 0], [0, 50, 80]])
    for name, values in (("pos", cell.q @ turns.T), ("curr", cell.tau @ np.linalg.inv(turns))):
        header = ",".join(f"Joint_{i + 1}" for i in range(cell.axes))
        np.savetxt(tmp_path / f"{name}_data.csv", values, delimiter=",", header=header, comments="")
    files = tmp_path / "pos_data.csv", tmp_path / "curr_data.csv"
    said = twin("import", *files, "--guess")
    assert said.code == 0, said.err
    guessed = YAML(typ="safe", pure=True).load(said.out)
    assert guessed["runs"] == {"run": ["pos_data", "curr_data"]}
    assert guessed["torque"]["channels"] == [f"curr_data.Joint_{i + 1}" for i in range(cell.axes)]
    plan = {
        "makes": "motion-log", "sample_rate_hz": 250, "runs": {"a": ["pos_*", "curr_*"]},
        "position": {"channels": "pos_data.*", "unit": "rad", "factor": np.linalg.inv(turns).tolist()},
        "torque": {"channels": "curr_data.*", "unit": "N·m", "factor": turns.T.tolist()},
    }  # fmt: skip
    said = twin("import", *files, "--map", mapped(tmp_path, **plan), "-o", tmp_path / "l.h5")
    assert said.code == 0, said.err
    with h5py.File(tmp_path / "l.h5") as file:
        np.testing.assert_allclose(file["runs/a/position"][()], cell.q, atol=1e-6)
        np.testing.assert_allclose(file["runs/a/torque"][()], cell.tau, rtol=1e-6, atol=1e-6)
    rows = {**plan["position"], "factor": [[1.0, 2.0], [3.0, 4.0]]}
    for wrong, word in ({"runs": {"a": "x_*"}}, "runs.a"), ({"position": rows}, "rows of 3"):
        path, out = mapped(tmp_path, **{**plan, **wrong}), tmp_path / "m.h5"
        refused(twin("import", *files, "--map", path, "-o", out), word, out)
    files[1].write_text("\n".join(files[1].read_text().splitlines()[:50]))
    refused(twin("import", *files, "--map", mapped(tmp_path, **plan), "-o", out), "as many samples", out)
    (tmp_path / "b").mkdir()
    same = tmp_path / "b" / "pos_data.csv"  # as folders `pos` and `curr` with a file per run have it
    same.write_text(files[0].read_text())
    refused(twin("import", files[0], same, "--map", path, "-o", out), "two files are called pos_data", out)


def test_places_in_mm_are_named(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    universal(tmp_path / "e.unv", cell, True)
    in_mm = {n: node | {"position": [1e3 * x for x in node["position"]]} for n, node in nodes(cell).items()}
    plan = mapped(tmp_path, makes="frf-campaign", robot="kr90", postures=stance(cell), nodes=in_mm, unit="(m/s²)/N")
    refused(
        twin("import", tmp_path / "e.unv", "--map", plan, "-o", tmp_path / "c.h5"), "look like mm", tmp_path / "c.h5"
    )


def test_a_unit_that_the_file_states_wins_over_a_wrong_map(
    cell: Recorded, tmp_path: Path, twin: Callable[..., Any]
) -> None:
    plan = german(tmp_path / "g.csv", cell)
    plan["position"]["unit"] = "rad"
    path = mapped(tmp_path, makes="motion-log", robot="kr90", **plan)
    refused(twin("import", tmp_path / "g.csv", "--map", path, "-o", tmp_path / "l.h5"), "states '°'", tmp_path / "l.h5")


def refused(said: SimpleNamespace, named: str, written: Path) -> None:
    assert said.code == 2, said.out
    assert named in said.err
    assert said.err.count("\n") == 1
    assert not written.exists()


def test_a_channel_in_amperes_is_taken_with_a_factor(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    constant = 150.0
    plan = german(tmp_path / "g.csv", replace(cell, tau=1e3 * cell.tau / constant))
    text = (tmp_path / "g.csv").read_text(encoding="cp1252")
    (tmp_path / "g.csv").write_text(text.replace("Moment", "Strom").replace("kNm", "A"), encoding="cp1252")
    torque, out = {"channels": "Strom *", "unit": "N·m"}, tmp_path / "log.h5"
    without = mapped(tmp_path, makes="motion-log", **plan | {"torque": torque})
    refused(twin("import", tmp_path / "g.csv", "--map", without, "-o", out), "or give a factor, N·m per A", out)
    path = mapped(tmp_path, makes="motion-log", **plan | {"torque": torque | {"factor": constant}})
    assert twin("import", tmp_path / "g.csv", "--map", path, "-o", out).code == 0
    (run,) = read_motion_log(out).runs.values()
    np.testing.assert_allclose(run.torque, cell.tau, atol=1e-5 * np.abs(cell.tau).max())
    assert "Strom 1" in guess_map([tmp_path / "g.csv"])["torque"]["channels"]


def test_a_guessed_map_is_a_map_but_for_its_units(cell: Recorded, tmp_path: Path, twin: Callable[..., Any]) -> None:
    rtde(tmp_path / "data.csv", cell)
    said = twin("import", tmp_path / "data.csv", "--guess")
    assert said.code == 0, said.err
    assert said.out.count("unit: ask") == 3
    path = tmp_path / "map.yaml"
    path.write_text(said.out)
    out = tmp_path / "log.h5"
    refused(twin("import", tmp_path / "data.csv", "--map", path, "-o", out), "state the robot", out)
    path.write_text(said.out.replace("robot: ask", "robot: kr90")
                    .replace("unit: ask", "unit: s", 1).replace("unit: ask", "unit: rad", 1)
                    .replace("unit: ask\n  factor: 1.0", "unit: Nm\n  factor: [100, 200, 300]", 1))  # fmt: skip
    said = twin("import", tmp_path / "data.csv", "--map", path, "-o", tmp_path / "log.h5")
    assert said.code == 0, said.err
    assert "rate (Hz) 250" in said.out


def test_hinges_and_slides_have_units_of_their_own(tmp_path: Path) -> None:
    """A header with deg and mm was refused whatever the map said."""
    path, rows = tmp_path / "scara.csv", np.linspace(0, 1, 200)
    table = np.stack([rows, 90 * np.sin(6 * rows), 200 * np.cos(6 * rows), np.sin(rows), np.cos(rows)], 1)
    np.savetxt(path, table, delimiter=";", header="Time [s];P1 [deg];P2 [mm];T1 [N·m];T2 [N]", comments="")
    guessed = guess_map([path])
    assert guessed["position"]["unit"] == ["deg", "mm"]
    plan = tmp_path / "map.yaml"
    plan.write_text(
        "makes: motion-log\ntime: {channels: [Time], unit: s}\nposition: {channels: [P1, P2], unit: [deg, mm]}\n"
        "torque: {channels: [T1, T2], unit: [N·m, N]}\n"
    )
    import_files([path], plan, out=tmp_path / "log.h5")
    (run,) = read_motion_log(tmp_path / "log.h5").runs.values()
    np.testing.assert_allclose(run.position, table[:, 1:3] * [np.pi / 180, 1e-3], atol=1e-9)
    plan.write_text(plan.read_text().replace("[deg, mm]", "deg"))
    with pytest.raises(InputError, match="A list of units, one per axis"):
        import_files([path], plan, out=tmp_path / "log.h5")


def test_points_between_thousands_are_told_from_decimal_points(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    head = "Zeit [s];Achse1 [rad];M1 [Nm]\n"
    path.write_text(head + "0,000;0,1;998\n0,004;0,2;1.004\n0,008;0,3;-1.010\n")
    with pytest.warns(Told, match="'1.004' is 1004"):
        (table,) = read_text(path)
    np.testing.assert_allclose(table.channels["M1"].values, [998, 1004, -1010])
    path.write_text(head + "0,000;0,1;1.001,5\n0,004;0,2;1.004,25\n0,008;0,3;999,5\n")
    np.testing.assert_allclose(read_text(path)[0].channels["M1"].values, [1001.5, 1004.25, 999.5])
    path.write_text(head + "0,000;0,1;0.998\n0,004;0,2;1.004\n0,008;0,3;12.5\n")
    np.testing.assert_allclose(read_text(path)[0].channels["M1"].values, [0.998, 1.004, 12.5])
    path.write_text(head + "0,000;0,1;1.001\n0,004;0,2;1.004\n0,008;0,3;1.010\n")
    with pytest.raises(InputError, match=r"line 2.*may be 1001 or 1,001"):
        read_text(path)


def test_quoted_cells_and_windows_text_are_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('"Zeit [s]","Lage 1 [Grad]"\n' + "".join(f'"0,00{k}","{k},5"\n' for k in range(4)))
    (table,) = read_text(path)
    np.testing.assert_allclose(table.channels["Lage 1"].values, np.arange(4) + 0.5)
    assert table.channels["Lage 1"].unit == "Grad"
    path.write_bytes("Zeit in s;Lage 1 in °\n0,0;1,5\n0,1;2,5\n0,2;3,5\n".encode("utf-16"))
    np.testing.assert_allclose(read_text(path)[0].channels["Lage 1"].values, [1.5, 2.5, 3.5])


def test_axes_with_clocks_of_their_own_are_brought_to_one(tmp_path: Path, twin: Callable[..., Any]) -> None:
    """The second axis is recorded 80 ms later: its torque belongs to its own clock."""
    time = 0.004 * np.arange(500)
    rows = "".join(
        f"{t:.3f},{np.sin(t):.9f},{np.cos(t):.9f},{t + 0.08:.3f},{np.sin(t + 0.08):.9f},{np.cos(t + 0.08):.9f}\n"
        for t in time
    )
    (tmp_path / "log.csv").write_text(f"Zeit A1 [s],q1 [rad],M1 [Nm],Zeit A2 [s],q2 [rad],M2 [Nm]\n{rows}")
    plan = guess_map([tmp_path / "log.csv"])
    assert plan["time"] == {"channels": ["Zeit A1", "Zeit A2"], "unit": "s"}
    del plan["robot"]
    done = twin("import", tmp_path / "log.csv", "--map", mapped(tmp_path, **plan), "-o", tmp_path / "log.h5")
    assert done.code == 0
    assert "clocks of their own" in done.out
    (run,) = read_motion_log(tmp_path / "log.h5").runs.values()
    np.testing.assert_allclose(run.position[:, 1], run.position[:, 0], atol=1e-6)
    np.testing.assert_allclose(run.torque[:, 1], run.torque[:, 0], atol=1e-6)
    plan["time"]["channels"] = ["Zeit A1", "Zeit A2", "Zeit A1"]
    refused(twin("import", tmp_path / "log.csv", "--map", mapped(tmp_path, **plan), "-o", tmp_path / "b.h5"),
            "one for each of the 2 axes", tmp_path / "b.h5")  # fmt: skip


def test_a_rate_that_the_clock_contradicts_is_refused_of_a_log_too(tmp_path: Path, twin: Callable[..., Any]) -> None:
    rows = "".join(f"{0.004 * k:.3f},{np.sin(0.02 * k):.6f},{np.cos(0.02 * k):.6f}\n" for k in range(500))
    (tmp_path / "log.csv").write_text(f"Zeit [s],q1 [rad],M1 [Nm]\n{rows}")
    plan = {**guess_map([tmp_path / "log.csv"]), "sample_rate_hz": 25}
    del plan["time"], plan["robot"]
    refused(twin("import", tmp_path / "log.csv", "--map", mapped(tmp_path, **plan), "-o", tmp_path / "a.h5"),
            "found 25 in the map, and 250", tmp_path / "a.h5")  # fmt: skip


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 1, 0), (1, 0, 2)])
def test_axes_of_an_array_of_frfs_are_told_by_their_lengths(order: tuple[int, int, int]) -> None:
    frf = np.random.default_rng(0).normal(size=(7, 3, 2))
    stored = frf.transpose(order)
    found = _axes(stored.shape, frf.shape)
    assert found is not None
    np.testing.assert_array_equal(stored.transpose(found), frf)
    assert _axes((7, 2, 4), frf.shape) is None
    assert _axes((3, 3, 7), (7, 3, 3)) == (2, 0, 1)
    assert _axes((7, 3), (7, 3, 1)) == (0, 1, 2)
