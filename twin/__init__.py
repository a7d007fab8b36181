"""A MuJoCo digital twin of milling robots.

Everything a user calls is on this page, by the names of the commands. Each takes objects or paths and returns a result
that prints itself, shows as tables in a notebook and draws its figures on request::

    import twin

    print(twin.diagnose("measured_frf.h5", robot="kr90"))

Data flows one way: description → model → prediction; recording → residual → verdict.
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name → where it lives. Nothing of it is imported before it is asked for.
_HOME = {
    # what goes in
    "load_robot": "twin.robot.description",
    "save_robot": "twin.robot.description",
    "Robot": "twin.robot.description",
    "read_campaign": "twin.measure.recordings",
    "write_campaign": "twin.measure.campaign",
    "Campaign": "twin.measure.campaign",
    "read_log": "twin.measure.recordings",
    "write_log": "twin.measure.recordings",
    "MotionLog": "twin.measure.motion_log",
    "MotionRun": "twin.measure.motion_log",
    "read_modal_table": "twin.measure.modal_table",
    "write_modal_table": "twin.measure.modal_table",
    "ModalTable": "twin.measure.modal_table",
    # what is done, and what comes out
    "describe": "twin.commands.describe",
    "Described": "twin.commands.describe",
    "simulate": "twin.commands.simulate",
    "Simulation": "twin.commands.simulate",
    "modal": "twin.commands.modal",
    "ModalAnalysis": "twin.commands.modal",
    "fit": "twin.commands.fit",
    "FitResult": "twin.commands.fit",
    "excite": "twin.commands.excite",
    "Excitations": "twin.commands.excite",
    "identify": "twin.commands.identify",
    "Identified": "twin.commands.identify",
    "compare": "twin.commands.compare",
    "Compared": "twin.commands.compare",
    "diagnose": "twin.commands.diagnose",
    "Verdict": "twin.diagnose.verdict",
    "lobes": "twin.commands.lobes",
    "StabilityLobes": "twin.commands.lobes",
    "make_map": "twin.commands.map",
    "Map": "twin.commands.map",
    "Cut": "twin.milling.cut",
    "read_cut": "twin.milling.cut",
    "example": "twin.commands.example",
    "Example": "twin.commands.example",
    "import_files": "twin.commands.foreign",
    "Imported": "twin.commands.foreign",
    # what goes wrong, and how far long work has come
    "InputError": "twin.errors",
    "progress": "twin.commands.progress",
}

if TYPE_CHECKING:
    from twin.commands.compare import Compared as Compared
    from twin.commands.compare import compare as compare
    from twin.commands.describe import Described as Described
    from twin.commands.describe import describe as describe
    from twin.commands.diagnose import diagnose as diagnose
    from twin.commands.example import Example as Example
    from twin.commands.example import example as example
    from twin.commands.excite import Excitations as Excitations
    from twin.commands.excite import excite as excite
    from twin.commands.fit import FitResult as FitResult
    from twin.commands.fit import fit as fit
    from twin.commands.foreign import Imported as Imported
    from twin.commands.foreign import import_files as import_files
    from twin.commands.identify import Identified as Identified
    from twin.commands.identify import identify as identify
    from twin.commands.lobes import StabilityLobes as StabilityLobes
    from twin.commands.lobes import lobes as lobes
    from twin.commands.map import Map as Map
    from twin.commands.map import make_map as make_map
    from twin.commands.modal import ModalAnalysis as ModalAnalysis
    from twin.commands.modal import modal as modal
    from twin.commands.progress import progress as progress
    from twin.commands.simulate import Simulation as Simulation
    from twin.commands.simulate import simulate as simulate
    from twin.diagnose.verdict import Verdict as Verdict
    from twin.errors import InputError as InputError
    from twin.measure.campaign import Campaign as Campaign
    from twin.measure.campaign import write_campaign as write_campaign
    from twin.measure.modal_table import ModalTable as ModalTable
    from twin.measure.modal_table import read_modal_table as read_modal_table
    from twin.measure.modal_table import write_modal_table as write_modal_table
    from twin.measure.motion_log import MotionLog as MotionLog
    from twin.measure.motion_log import MotionRun as MotionRun
    from twin.measure.recordings import read_campaign as read_campaign
    from twin.measure.recordings import read_log as read_log
    from twin.measure.recordings import write_log as write_log
    from twin.milling.cut import Cut as Cut
    from twin.milling.cut import read_cut as read_cut
    from twin.robot.description import Robot as Robot
    from twin.robot.description import load_robot as load_robot
    from twin.robot.description import save_robot as save_robot
else:
    # Two rooms are named as the commands are. Importing a package sets its name here, once: it is done now, and undone.
    for _room in ("identify", "diagnose"):
        importlib.import_module(f"twin.{_room}")
        del globals()[_room]
    del _room

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    found = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
