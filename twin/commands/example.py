"""``twin example``: recordings of a robot with a concealed fault, to try everything on."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.commands.outputs import Outputs, check_out
from twin.errors import InputError
from twin.result import Result
from twin.robot.description import SHIPPED
from twin.table import Table

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
WHAT = {
    "cell": {
        "campaign.h5": "hammer test, five postures, raw hits included",
        "log.h5": "motion log of the same robot, two runs",
        "milling.yaml": "a posture, as twin simulate takes it",
        "upright.yaml": "another",
        "rigid.yaml": "another",
        "answer.json": "what was concealed: look last",
    },
    "arm": {
        "arm.urdf": "drawing of a six-axis arm: axes, masses, limits",
        "run1.csv": "its controller's record, positions and currents",
        "run2.csv": "another",
        "answer.json": "what was concealed: look last",
    },
}
NEXT = {"cell": "twin diagnose {0}/campaign.h5", "arm": "twin describe {0}/arm.urdf"}


@dataclass
class Example(Result):
    """The folder that was written, and its files."""

    name: str
    folder: Path

    @property
    def files(self) -> list[str]:
        """Paths of the files."""
        return [str(self.folder / name) for name in WHAT[self.name]]

    def data(self) -> dict[str, Any]:
        """As printed with ``--json``."""
        return {"name": self.name, "folder": self.folder, "files": self.files}

    def tables(self) -> list[Table]:
        """File and content."""
        return [Table(["file", "holds"], [[name, what] for name, what in WHAT[self.name].items()])]

    def __str__(self) -> str:
        files = WHAT[self.name]
        width = max(map(len, files))
        lines = [f"  {name:<{width}}  {what}" for name, what in files.items()]
        return "\n".join([f"wrote {self.folder}/", *lines, f"next: {NEXT[self.name].format(self.folder)}"])


def example(name: str = "cell", out: str | Path | None = None) -> Example:
    """Write an example's files into a folder, ``name`` by default.

    Raises:
        InputError: no such example, or the folder cannot be written.
    """
    if name not in WHAT:
        raise InputError("NAME", name, f"no such example; expected {' or '.join(WHAT)}")
    folder = Path(out if out is not None else name)
    check_out(folder)
    with Outputs(folder, "example") as target:
        for path in (EXAMPLES / name, SHIPPED / "postures"):
            for file in sorted(path.iterdir()):
                if file.name in WHAT[name]:
                    shutil.copyfile(file, target(file.name))
    return Example(name, folder)
