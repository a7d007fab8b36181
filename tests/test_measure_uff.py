"""Universal files: what goes out comes back, also as another exporter writes it."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff

from twin.errors import InputError
from twin.measure.campaign import Campaign, Channels, PostureFRF
from twin.measure.modal import identify_modes
from twin.measure.uff import Point, read_uff, write_uff, write_uff_modes

NF = 50


def campaign(quantity: str = "accelerance") -> Campaign:
    rng = np.random.default_rng(3)
    frequency = np.arange(2, NF + 2) * 0.5
    postures = {}
    for name, q in (("milling", [0.0, 70.0, -100.0]), ("upright@100N", [0.0, 135.0, -100.5])):
        postures[name] = PostureFRF(
            name,
            np.array(q),
            "off",
            frequency,
            rng.normal(size=(NF, 3, 2)) + 1j * rng.normal(size=(NF, 3, 2)),
            quantity,  # type: ignore[arg-type]
            rng.uniform(0.6, 1, size=(NF, 3, 2)),
            5,
            100.0,
            0.25,
        )
    sensor = np.array([[0.5, 0.1, -0.2]] * 3)
    return Campaign(
        Channels(("21X+", "21Y+", "21Z-"), ("link3",) * 3, sensor, np.diag([1.0, 1.0, -1.0])),
        Channels(
            ("21X+", "4Y-"),
            ("link3", "link1"),
            np.array([sensor[0], [0.25, 0, 0.5]]),
            np.array([[1.0, 0, 0], [0, -1, 0]]),
        ),
        postures,
        robot="kr90",
    )


@pytest.mark.parametrize("quantity", ["accelerance", "mobility", "receptance"])
def test_a_round_trip_keeps_labels_directions_units_window_and_numbers(tmp_path: Path, quantity: str) -> None:
    before = campaign(quantity)
    write_uff(tmp_path / "test.uff", before)
    after = read_uff(tmp_path / "test.uff")
    assert list(tmp_path.iterdir()) == [tmp_path / "test.uff"]
    for side in ("response", "excitation"):
        a, b = getattr(before, side), getattr(after, side)
        assert a.label == b.label
        assert a.body == b.body
        np.testing.assert_allclose(a.position, b.position, rtol=1e-5)
        np.testing.assert_array_equal(a.direction, b.direction)
    assert list(after.postures) == list(before.postures)
    assert after.robot == "kr90"
    for name, a in before.postures.items():
        b = after.postures[name]
        np.testing.assert_allclose(a.frf, b.frf, rtol=1e-10)
        np.testing.assert_allclose(a.coherence, b.coherence, rtol=1e-10)
        np.testing.assert_allclose(a.frequency, b.frequency, rtol=1e-6)
        np.testing.assert_array_equal(a.q_deg, b.q_deg)
        for attribute in ("quantity", "averages", "brakes", "peak_force_n", "exponential_window_rate"):
            assert getattr(a, attribute) == getattr(b, attribute)


def foreign_text(response: str, reference: str, h: np.ndarray, unit: str = "m/s^2", kind: int = 12) -> str:
    """Data set 58 the way a commercial exporter writes it: single precision, no words in the ID lines, real title."""
    node = lambda label: (int(label[:-2]), ("XYZ".index(label[-2]) + 1) * (1 if label[-1] == "+" else -1))  # noqa: E731
    (rn, rd), (en, ed) = node(response), node(reference)
    lines = [
        f"{-1:6d}",
        f"{58:6d}",
        "Robot arm, hammer survey",
        "NONE",
        "12-MAR-19 10:42:17",
        "NONE",
        "NONE",
        f"{4:5d}{0:10d}{1:5d}{0:10d} {'TIP':>10s}{rn:10d}{rd:4d} {'ARM':>10s}{en:10d}{ed:4d}",
        f"{5:10d}{h.size:10d}{1:10d}{0.5:13.5e}{0.5:13.5e}{0.0:13.5e}",
        f"{18:10d}{0:5d}{0:5d}{0:5d} {'Frequency':<20s} {'Hz':<20s}",
        f"{kind:10d}{0:5d}{0:5d}{0:5d} {'Acceleration':<20s} {unit:<20s}",
        f"{13:10d}{0:5d}{0:5d}{0:5d} {'Force':<20s} {'N':<20s}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {'NONE':<20s}",
    ]
    values = np.stack([h.real, h.imag], axis=1).ravel()
    lines += ["".join(f"{v:13.5e}" for v in values[i : i + 6]) for i in range(0, values.size, 6)]
    return "\n".join([*lines, f"{-1:6d}", ""])


def test_a_text_file_of_another_exporter_keeps_the_sign_on_the_blow(tmp_path: Path) -> None:
    """Two blows on the same spot from opposite sides have FRFs of opposite sign, and directions that say so."""
    rng = np.random.default_rng(0)
    h = rng.normal(size=NF) + 1j * rng.normal(size=NF)
    one, other = tmp_path / "plus.unv", tmp_path / "minus.unv"
    one.write_text(foreign_text("21Z+", "4Y+", h))
    other.write_text(foreign_text("21Z+", "4Y-", -h))
    points = {4: Point("link1", np.array([0.1, 0.2, 0.3])), 21: Point("link3", np.zeros(3))}
    read = read_uff([one, other], q_deg=np.array([0.0, 70.0, -100.0]), points=points)
    assert read.excitation.label == ("4Y+", "4Y-")
    assert read.excitation.body == ("link1", "link1")
    np.testing.assert_array_equal(read.excitation.direction, [[0, 1, 0], [0, -1, 0]])
    frf = read.postures["plus"].frf
    np.testing.assert_allclose(frf[:, 0, 0], h, rtol=1e-4)
    signed = frf[:, 0] * read.excitation.direction[:, 1]
    np.testing.assert_allclose(signed[:, 0], signed[:, 1], rtol=1e-12)
    assert read.postures["plus"].quantity == "accelerance"
    np.testing.assert_allclose(read.postures["plus"].frequency, 0.5 * np.arange(1, NF + 1))


def test_a_big_endian_binary_file_of_another_exporter_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    h = rng.normal(size=NF) + 1j * rng.normal(size=NF)
    lines = foreign_text("21Z-", "4Y+", h).split("\n")[:13]
    lines[1] = f"{58:6d}b{2:6d}{2:6d}{11:12d}{8 * NF:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    values = np.stack([h.real, h.imag], axis=1).ravel()
    body = struct.pack(f">{2 * NF}f", *values)
    (tmp_path / "b.unv").write_bytes(("\n".join(lines) + "\n").encode() + body + f"\n{-1:6d}\n".encode())
    read = read_uff(tmp_path / "b.unv", q_deg=np.zeros(3))
    assert read.response.label == ("21Z-",)
    np.testing.assert_array_equal(read.response.direction, [[0, 0, -1]])
    np.testing.assert_allclose(read.postures["b"].frf[:, 0, 0], h, rtol=1e-6)


def test_what_pyuff_writes_by_itself_is_read(tmp_path: Path) -> None:
    h = np.exp(1j * np.linspace(0, 3, NF))
    base = {
        "binary": 0,
        "func_type": 4,
        "rsp_node": 7,
        "rsp_dir": 2,
        "ref_node": 7,
        "ref_dir": -2,
        "data": h,
        "x": np.arange(NF) * 0.5,
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 18,
        "ordinate_spec_data_type": 8,
        "orddenom_spec_data_type": 13,
    }
    pyuff.UFF(str(tmp_path / "p.uff")).write_sets({"type": 58, **base}, "overwrite")
    read = read_uff(tmp_path / "p.uff", q_deg=np.zeros(1))
    assert read.postures["p"].quantity == "receptance"
    assert (read.response.label, read.excitation.label) == (("7Y+",), ("7Y-",))
    np.testing.assert_allclose(read.postures["p"].frf[:, 0, 0], h)


def test_g_per_newton_velocity_per_volt_doubles_and_holes_are_refused(tmp_path: Path) -> None:
    h = np.ones(NF) + 1j
    path = tmp_path / "x.unv"

    def refused(text: str, message: str) -> None:
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_uff(path, q_deg=np.zeros(3))

    good = foreign_text("21Z+", "4Y+", h)
    refused(
        foreign_text("21Z+", "4Y+", h, unit="g"),
        r"21Z\+/4Y\+.*unit: expected m/s\^2, found .g.; `twin import` takes it",
    )
    refused(foreign_text("21Z+", "4Y+", h, unit="g/N"), "unit")
    refused(foreign_text("21Z+", "4Y+", h, kind=1), "type 8, 11 or 12")
    refused(good + good, "every channel pair once")
    refused(good + foreign_text("21X+", "4X+", h), r"expected the FRF 21Z\+/4X\+")
    refused(good + foreign_text("21X+", "4Y+", h[:-5]), "one frequency axis")
    refused(good.replace(f"{4:10d}{2:4d}", f"{4:10d}{5:4d}"), "direction from 1 to 3")
    refused("not a universal file", "expected data sets 58")
    path.write_text(good)
    assert read_uff(path).postures["foreign"].q_deg.size == 0 if path.stem == "foreign" else True


def test_modes_come_back_from_data_set_55(tmp_path: Path) -> None:
    """Frequency, damping and shape, with the sign of the blow undone: components are along the positive axes."""
    rng = np.random.default_rng(2)
    f, zeta, phi = np.array([10.0, 17.0]), np.array([0.01, 0.02]), rng.normal(size=(4, 2))
    frequency = np.arange(1, 121) * 0.25
    s, w = 2j * np.pi * frequency[:, None], 2 * np.pi * f
    frf = np.einsum("or,ir,fr->foi", phi, phi[:1], s**2 / (s**2 + 2 * zeta * w * s + w**2))
    posture = PostureFRF("p", np.zeros(3), None, frequency, frf, "accelerance")
    labels = ("1X+", "1Y-", "2Z+", "3X+")
    result = identify_modes(posture, labels=(labels, ("1X+",)))
    write_uff_modes(tmp_path / "m.uff", result)
    modes = pyuff.UFF(str(tmp_path / "m.uff")).read_sets()
    np.testing.assert_allclose([abs(m["eig"]) / (2 * np.pi) for m in modes], f, rtol=1e-5)
    np.testing.assert_allclose([-m["eig"].real / abs(m["eig"]) for m in modes], zeta, rtol=1e-4)
    for mode, column in zip(modes, phi.T, strict=True):
        assert [int(n) for n in mode["node_nums"]] == [1, 2, 3]
        shape = np.array([mode["r1"][0], -mode["r2"][0], mode["r3"][1], mode["r1"][2]])
        np.testing.assert_allclose(shape, column / column[np.argmax(np.abs(column))], atol=1e-4)
    with pytest.raises(InputError):
        write_uff_modes(tmp_path / "none.uff", replace(result, response_label=()))


@pytest.mark.parametrize("binary", [False, True])
def test_a_file_cut_short_is_refused_wherever_the_cut_falls(tmp_path: Path, binary: bool) -> None:
    """A cut between two data sets leaves a whole file: what it lacks then is a channel pair or a coherence."""
    write_uff(tmp_path / "text.uff", campaign())
    sets = pyuff.UFF(str(tmp_path / "text.uff")).read_sets()
    pyuff.UFF(str(tmp_path / "whole.uff")).write_sets([{**s, "binary": int(binary)} for s in sets], mode="overwrite")
    data = (tmp_path / "whole.uff").read_bytes()
    for share in (0.02, 0.2, 0.5, 0.77, 0.9, 0.999):
        (tmp_path / "cut.uff").write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError, match=r"cut\.uff: (ends inside|data set|expected|posture)") as found:
            read_uff(tmp_path / "cut.uff")
        assert len(str(found.value).splitlines()) == 1


def test_a_data_set_holds_as_many_values_as_it_states(tmp_path: Path) -> None:
    write_uff(tmp_path / "whole.uff", campaign())
    lines = (tmp_path / "whole.uff").read_text().splitlines(keepends=True)
    at = max(n for n, line in enumerate(lines) if line.strip() == "-1") - 2
    (tmp_path / "less.uff").write_text("".join(lines[:at] + lines[at + 1 :]))
    with pytest.raises(InputError, match=r"less\.uff"):
        read_uff(tmp_path / "less.uff")
