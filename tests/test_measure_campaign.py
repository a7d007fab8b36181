"""The frf-campaign file: what is written comes back, and what breaks its contract is refused in one line."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import twin
from twin.errors import InputError, Told
from twin.measure.campaign import (
    Campaign,
    Channels,
    Hits,
    PostureFRF,
    as_quantity,
    convert,
    dead_channels,
    frf_variance,
    read_campaign,
    write_campaign,
)
from twin.measure.hdf5 import check_unit
from twin.measure.spectra import driving_pairs

NR, NE, NF, NH, NT = 3, 2, 40, 4, 64


def campaign(seed: int = 0) -> Campaign:
    rng = np.random.default_rng(seed)
    frf = rng.normal(size=(NF, NR, NE)) + 1j * rng.normal(size=(NF, NR, NE))
    hits = Hits(rng.normal(size=(NE, NH, NT)), rng.normal(size=(NE, NH, NR, NT)), 512.0, 0.02, True, 0.5)
    posture = PostureFRF(
        name="milling",
        q_deg=np.array([0.0, 70.0, -100.0]),
        brakes="on",
        frequency=np.arange(1, NF + 1) * 0.5,
        frf=frf,
        quantity="accelerance",
        coherence=rng.uniform(0.5, 1, size=(NF, NR, NE)),
        averages=3,
        peak_force_n=300.0,
        exponential_window_rate=0.5,
        hits=hits,
        pulse_s=0.0081,
        record_s=12.5,
    )
    return Campaign(
        Channels(("21X+", "21Y+", "21Z-"), ("link3",) * 3, rng.normal(size=(3, 3)), np.diag([1.0, 1.0, -1.0])),
        Channels(("21X+", "4Y-"), ("link3", "link1"), rng.normal(size=(2, 3)), np.array([[1.0, 0, 0], [0, -1, 0]])),
        {"milling": posture, "milling@100N": replace(posture, name="milling@100N", brakes=None, hits=None)},
        robot="kr90",
        comment="three sensors, two blows",
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_campaign(tmp_path / "test.h5", campaign())
    return tmp_path / "test.h5"


def assert_equal(a: object, b: object) -> None:
    if hasattr(a, "__dataclass_fields__"):
        for name in set(a.__dataclass_fields__) - {"source"}:  # where it was read from, for messages
            assert_equal(getattr(a, name), getattr(b, name))
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_equal(a[key], b[key])
    else:
        np.testing.assert_array_equal(a, b)


def test_what_is_written_is_read_back_whole(path: Path) -> None:
    assert_equal(campaign(), read_campaign(path))


def test_a_file_by_another_program_with_bytes_arrays_and_compound_complex_is_read(path: Path) -> None:
    """MATLAB and older writers store bytes, 1×1 arrays and {real, imag} records."""
    with h5py.File(path, "a") as file:
        file.attrs["format"] = np.bytes_(b"frf-campaign")
        file.attrs["version"] = np.array([1.0])
        del file.attrs["comment"], file.attrs["robot"]
        posture = file["postures/milling"]
        posture.attrs["brakes"] = np.array([b"on"])
        frf = posture["frf"][()]
        pairs = np.zeros(frf.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
        pairs["real"], pairs["imag"] = frf.real, frf.imag
        del posture["frf"]
        posture.create_dataset("frf", data=pairs).attrs["quantity"] = np.array([b"accelerance"], dtype="S20")
        label = [text.encode() for text in ("21X+", "21Y+", "21Z-")]
        del file["response/label"]
        file["response/label"] = np.array(label, dtype="S8")
        del posture["hits"], posture["coherence"]
    read = read_campaign(path)
    np.testing.assert_array_equal(read.postures["milling"].frf, campaign().postures["milling"].frf)
    assert read.response.label == ("21X+", "21Y+", "21Z-")
    assert (read.postures["milling"].brakes, read.robot, read.comment) == ("on", None, "")


def _set(name: str, key: str, value: object) -> Callable[[h5py.File], None]:
    return lambda file: file[name].attrs.__setitem__(key, value)


def _data(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[h5py.File], None]:
    def apply(file: h5py.File) -> None:
        new, attrs = change(file[name][()]), dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, data=new).attrs.update(attrs)

    return apply


def _put(index: tuple[int, ...], value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return change


M = "postures/milling"
REFUSED: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "unit g/N": (_set(f"{M}/frf", "unit", "g/N"), r"frf: unit: expected \(m/s\^2\)/N, found 'g/N'"),
    "unit mm": (_set(f"{M}/frf", "unit", "(mm/s²)/N"), "frf: unit"),
    "unit disagrees with quantity": (_set(f"{M}/frf", "unit", "m/N"), "frf: unit"),
    "response in g": (_set(f"{M}/hits/response", "unit", "g"), "hits/response: unit"),
    "force in lbf": (_set(f"{M}/hits/force", "unit", "lbf"), "hits/force: unit"),
    "position in mm": (_set("response/position", "unit", "mm"), "response/position: unit"),
    "quantity inertance": (_set(f"{M}/frf", "quantity", "inertance"), "quantity: expected one of receptance"),
    "no quantity": (lambda f: f[f"{M}/frf"].attrs.__delitem__("quantity"), "quantity: .* missing"),
    "NaN in frf": (_data(f"{M}/frf", _put((3, 1, 1), np.nan)), "frf: expected finite"),
    "NaN in coherence": (_data(f"{M}/coherence", _put((3, 1, 1), np.nan)), "coherence: expected finite"),
    "NaN in hits": (_data(f"{M}/hits/force", _put((0, 1, 1), np.inf)), "hits/force: expected finite"),
    "uneven frequency": (_data(f"{M}/frequency", _put((-1,), 30.0)), "frequency: expected even spacing"),
    "unsorted frequency": (_data(f"{M}/frequency", lambda a: a[::-1]), "frequency: .*increasing"),
    "negative frequency": (_data(f"{M}/frequency", lambda a: a - 5), "frequency: expected Hz from 0"),
    "coherence above 1": (
        _data(f"{M}/coherence", _put((0, 0, 0), 1.01)),
        "coherence: expected values from 0 to 1",
    ),
    "frf transposed": (_data(f"{M}/frf", lambda a: a.swapaxes(1, 2)), r"frf: expected shape \(40, 3, 2\)"),
    "frf real": (_data(f"{M}/frf", lambda a: a.real), "frf: expected complex"),
    "short coherence": (_data(f"{M}/coherence", lambda a: a[1:]), "coherence: expected shape"),
    "hits of one sensor": (
        _data(f"{M}/hits/response", lambda a: a[:, :, :1]),
        "hits/response: expected shape",
    ),
    "direction not unit": (_data("response/direction", lambda a: a * 2), "direction: expected unit vectors"),
    "position 2-D": (_data("excitation/position", lambda a: a[:, :2]), "excitation/position: expected shape"),
    "label without sign": (_data("excitation/label", lambda a: np.array([b"21X", b"4Y-"])), "label: .*'21X'"),
    "label twice": (
        _data("excitation/label", lambda a: np.array([b"4Y-", b"4Y-"])),
        "label: labels must be unique",
    ),
    "body missing": (lambda f: f.__delitem__("response/body"), "response/body: expected a dataset"),
    "no postures": (lambda f: f.__delitem__("postures"), "postures: expected a group"),
    "no q_deg": (lambda f: f[M].attrs.__delitem__("q_deg"), "q_deg must have one length"),
    "q_deg of another robot": (_set(M, "q_deg", [0.0, 1.0]), "q_deg must have one length"),
    "brakes true": (_set(M, "brakes", True), 'brakes: expected "on" or "off"'),
    "averages 0": (_set(f"{M}/coherence", "averages", 0), "averages: expected 1 or more"),
    "averages beyond count": (_set(f"{M}/coherence", "averages", 10**12), "averages: expected 1 or more, up to"),
    "no coherence anywhere": (_data(f"{M}/coherence", lambda a: 0 * a), "coherence: expected values above 0"),
    "blows without force": (_data(f"{M}/hits/force", lambda a: 0 * a), "hits/force: expected blows"),
    "silent": (_data(f"{M}/frf", lambda a: 0 * a), "frf: expected a response, every channel is zero"),
    "frf of no machine": (_data(f"{M}/frf", lambda a: 1e-12 * a), "frf: expected a peak from"),
    "frf a million times": (_data(f"{M}/frf", lambda a: 1e9 * a), "frf: expected a peak from"),
    "negative window rate": (_set(M, "exponential_window_rate", -1.0), "exponential_window_rate: expected"),
    "window rate in words": (
        _set(M, "exponential_window_rate", "none"),
        "exponential_window_rate: expected a number",
    ),
    "force level 0": (_set(M, "peak_force_n", 0.0), "peak_force_n: expected newtons"),
    "other format": (_set("/", "format", "motion-log"), 'format: expected "frf-campaign"'),
    "version 2": (_set("/", "version", 2), "version: expected 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_broken_contract_is_one_line_naming_file_field_and_remedy(path: Path, case: str) -> None:
    spoil, message = REFUSED[case]
    with h5py.File(path, "a") as file:
        spoil(file)
    with pytest.raises(InputError, match=message) as error:
        read_campaign(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_no_file_and_no_hdf5_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is none"):
        read_campaign(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("frequency,frf")
    with pytest.raises(InputError, match="expected an HDF5 file"):
        read_campaign(tmp_path / "text.h5")


def test_a_campaign_that_would_be_refused_is_not_written_nor_half_written(path: Path) -> None:
    before = path.read_bytes()
    good = campaign()
    bad = replace(good.postures["milling"], frf=good.postures["milling"].frf * np.nan)
    with pytest.raises(InputError, match="finite"):
        write_campaign(path, replace(good, postures={"milling": bad}))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    "unit", ["m/s^2/N", "(m/s²)/N", "m/(s²·N)", "m s^-2 N^-1", "m/s**2/N", "1/kg", "kg^-1", "m/s2/N"]
)
def test_every_spelling_of_the_si_unit_is_the_si_unit(unit: str) -> None:
    check_unit("file", "frf", unit, "(m/s^2)/N")


@pytest.mark.parametrize(
    "unit", ["g/N", "G/N", "mm/s^2/N", "m/s^2/kN", "in/s^2/lbf", "m/N", "m/s^2", "dB", "1/g", "m/s^2/N)"]
)
def test_no_other_unit_is(unit: str) -> None:
    with pytest.raises(InputError):
        check_unit("file", "frf", unit, "(m/s^2)/N")


def test_accelerance_of_a_free_mass_is_one_over_the_mass() -> None:
    frequency = np.arange(1, 5) * 2.0
    receptance = (-1 / (7.0 * (2 * np.pi * frequency) ** 2)).astype(complex)
    np.testing.assert_allclose(convert(receptance, frequency, "receptance", "accelerance"), 1 / 7.0)
    back = convert(convert(receptance, frequency, "receptance", "mobility"), frequency, "mobility", "receptance")
    np.testing.assert_allclose(back, receptance)


def test_stated_variance_is_that_of_repeated_h1_estimates() -> None:
    """White force, independent response noise: the scatter of H1 over 400 repeats is what coherence says."""
    rng = np.random.default_rng(1)
    n, repeats, frequency = 8, 400, np.arange(1, 61) * 0.5
    truth = 1 / (1 - (frequency / 14.3) ** 2 + 0.02j * frequency / 14.3)
    complex_normal = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    force = complex_normal(repeats, n, frequency.size)
    response = truth * force + 1.5 * complex_normal(repeats, n, frequency.size)
    sff, sxx = (np.mean(np.abs(a) ** 2, axis=1) for a in (force, response))
    sfx = np.mean(force.conj() * response, axis=1)
    h1 = sfx / sff
    coherence = np.abs(sfx) ** 2 / sff / sxx
    posture = replace(
        campaign().postures["milling"],
        frequency=frequency,
        frf=h1.T[:, :, None],
        coherence=coherence.T[:, :, None],
        averages=n,
        exponential_window_rate=0.0,
    )
    stated = frf_variance(posture)
    assert stated is not None
    measured = 0.5 * np.var(h1, axis=0)
    ratio = np.median(stated[:, :, 0].mean(axis=1) / measured)
    assert ratio == pytest.approx(1.0, abs=0.25)


def test_variance_does_not_collapse_where_the_response_does() -> None:
    posture = replace(campaign().postures["milling"], exponential_window_rate=0.0)
    frf = posture.frf.copy()
    frf[20] = 1e-12
    frf[:, 2, 1] = 0.0
    spoilt = replace(posture, frf=frf)
    variance = frf_variance(spoilt)
    assert variance is not None
    expected = np.zeros((NR, NE), dtype=bool)
    expected[2, 1] = True
    np.testing.assert_array_equal(dead_channels(spoilt), expected)
    assert np.isinf(variance[:, 2, 1]).all()
    assert (variance[20, :2] > 0.1 * np.median(variance[:, :2], axis=0)).all()


def test_weighted_data_are_the_same_in_every_quantity() -> None:
    posture = replace(campaign().postures["milling"], exponential_window_rate=0.0)
    receptance = as_quantity(posture, "receptance")
    a, b = frf_variance(posture), frf_variance(receptance)
    assert a is not None
    assert b is not None
    np.testing.assert_allclose(np.abs(posture.frf) ** 2 / a, np.abs(receptance.frf) ** 2 / b)


def test_one_average_has_no_variance() -> None:
    assert frf_variance(replace(campaign().postures["milling"], averages=1)) is None


@pytest.mark.parametrize("lines", [slice(None), slice(None, None, 6)])
def test_frfs_of_the_other_sign_of_time_are_told_and_conjugated(tmp_path: Path, lines: slice) -> None:
    """Four modes between 12 and 60 Hz with noise, all lines or one in six: e^{−iωt} is seen, e^{+iωt} is left alone."""
    rng = np.random.default_rng(3)
    s = 2j * np.pi * np.arange(1, 401)[lines, None] * 0.25
    w = 2 * np.pi * np.array([12.0, 19, 33, 60])
    shapes = rng.normal(size=(4, NR, NE))
    frf = np.einsum("fm,mre->fre", s**2 / (s**2 + 0.04 * w * s + w**2), shapes)
    frf += 0.3 * (rng.normal(size=frf.shape) + 1j * rng.normal(size=frf.shape))
    one = replace(
        campaign().postures["milling"], frequency=s[:, 0].imag / (2 * np.pi), frf=frf, coherence=None, averages=None,
        hits=None,
    )  # fmt: skip
    write_campaign(tmp_path / "right.h5", replace(campaign(), postures={"milling": one}))
    write_campaign(tmp_path / "turned.h5", replace(campaign(), postures={"milling": replace(one, frf=frf.conj())}))
    right = twin.read_campaign(tmp_path / "right.h5")
    with pytest.warns(Told, match=r"turned.h5: frf: responses come before their blows"):
        turned = twin.read_campaign(tmp_path / "turned.h5")
    for found in (right, turned):
        np.testing.assert_array_equal(found.postures["milling"].frf, frf)


def test_nodes_without_a_place_are_not_one_point() -> None:
    """They all lie at the foot's origin; the same node still is a driving point."""
    along = np.array([[0.0, 0, 1]] * 2)
    nowhere = Channels(("1Z+", "2Z+"), ("base",) * 2, np.zeros((2, 3)), along)
    assert [pair[:2] for pair in driving_pairs(replace(campaign(), response=nowhere, excitation=nowhere))] == [
        (0, 0), (1, 1),
    ]  # fmt: skip
