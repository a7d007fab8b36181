"""``twin modal`` on measurements that maintained packages ship, beside the figures that these packages print.

    pip download --no-deps --no-binary :all: modalyzer==1.2.2 -d FOLDER       (MIT licence)
    pip download --no-deps vibration_toolbox==0.6.10 -d FOLDER                (MIT licence)
    python -m tools.real_tests FOLDER

``modalyzer`` holds a minute of the LUMO mast in the wind (Wernitz and others 2021, doi 10.25835/0027803) and a notebook
with what its estimators found. ``vibration_toolbox`` holds two FRFs of one channel; docstrings state one frequency of
each.
Nothing is unpacked or installed, and no figure of the packages is kept here.
"""

import io
import json
import re
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from twin.measure.campaign import PostureFRF
from twin.measure.modal import ModalResult, identify_modes
from twin.measure.operational import Running, identify_running

NO_AXES = np.zeros(0)
MAST = "modalyzer-1.2.2/Examples/Example 4 - LUMO/"
MAST_HZ, MAST_CHANNELS = 1651.0, 18  # as its notebook has it; strain and temperature come after
NEAR = 0.015  # of a frequency: what one and another estimator found is one mode


def stated(notebook: str) -> dict[str, np.ndarray]:
    """Heading → (n, 2) frequencies in Hz and damping ratios in % of every table of results in a notebook."""
    found, heading = {}, ""
    for cell in json.loads(notebook)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            heading = source.splitlines()[-1].strip("# ") if source else heading
        elif "results_table(" in source:
            text = "".join(line for out in cell["outputs"] for line in out.get("data", {}).get("text/plain", []))
            rows = re.findall(r"^\d+ +([\d.e+-]+) +([\d.e+-]+)$", text, flags=re.MULTILINE)
            found[heading] = np.array(rows, dtype=float) * (1, 100)
    return found


def mast(archive: Path) -> None:
    """The mast: modes found with default options and up to 110 Hz, beside what the notebook's estimators found."""
    with tarfile.open(archive) as packed:
        record, notebook = (packed.extractfile(MAST + name) for name in ("data_lumo.csv", "CaseStudy_LUMO.ipynb"))
        assert record is not None
        assert notebook is not None
        y = np.loadtxt(record, delimiter=",")[:, :MAST_CHANNELS].T
        others = stated(notebook.read().decode())
    labels = tuple(str(n) for n in range(1, MAST_CHANNELS + 1))
    for fmax in (None, 110.0):
        found = identify_running("mast", Running(NO_AXES, y, MAST_HZ), labels, fmax=fmax)
        print(found)
        for name, table in others.items():
            print(f"  {name}:", *(beside(found, f, zeta) for f, zeta in table), sep="\n    ")


def beside(found: ModalResult, frequency: float, zeta: float) -> str:
    """What another estimator found, and the nearest mode."""
    nearest = min(found.modes, key=lambda m: abs(m.frequency_hz - frequency))
    apart = nearest.frequency_hz / frequency - 1
    if abs(apart) > NEAR:
        return f"{frequency:9.3f} Hz {zeta:7.3f} %   not found"
    return (
        f"{frequency:9.3f} Hz {zeta:7.3f} %   {nearest.frequency_hz:9.3f} Hz ({100 * apart:+.2f} %)"
        f" {nearest.damping_percent:7.3f} ± {nearest.damping_std_percent:.2g} %"
    )


def cases(archive: Path) -> None:
    """The two FRFs of one channel, and the lines of the docstrings that state a frequency."""
    with zipfile.ZipFile(archive) as packed:
        source = packed.read("vibration_toolbox/ema.py").decode()
        for name in ("case1", "case2"):
            held = loadmat(io.BytesIO(packed.read(f"vibration_toolbox/data/{name}.mat")))
            frf = PostureFRF(
                name,
                NO_AXES,
                None,
                held["Freq_domain"].ravel().astype(float),
                held["Hf_chan_2"][:, :, None],
                "accelerance",
            )
            print(identify_modes(frf))
            said = re.search(name + r"\.mat.*?>>> nf\s+([\d.]+)", source, flags=re.DOTALL)
            print(f"  stated: {said[1] if said else 'nothing'} Hz")


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    for pattern, shown in (("vibration_toolbox-0.6.10*.whl", cases), ("modalyzer-1.2.2.tar.gz", mast)):
        archive = next(folder.glob(pattern), None)
        if archive is None:
            sys.exit(f"{folder}: expected {pattern}, download it as the head of this file says")
        shown(archive)
