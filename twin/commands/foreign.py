"""``twin import``: foreign files become a hammer test or a motion log, or the map for that is guessed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.errors import InputError
from twin.importing.build import Source, build_functions, build_hits, build_log, build_universal
from twin.importing.guess import guess_tables, guess_universal
from twin.importing.map import FunctionsMap, LogMap, UniversalMap, read_map
from twin.importing.plausible import check_campaign_units, check_log
from twin.importing.tables import read_tables
from twin.measure.campaign import Campaign, write_campaign
from twin.measure.motion_log import MotionLog, write_motion_log
from twin.measure.recordings import UFF
from twin.measure.spectra import judge_hits
from twin.measure.units import ASK
from twin.result import Result
from twin.robot.description import load_robot
from twin.table import Table


@dataclass
class Imported(Result):
    """What was read; ``content`` is a :class:`Campaign` or a :class:`MotionLog`, ``file`` where it was written."""

    content: Campaign | MotionLog
    file: Path | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired on reading, and which blows do not count."""
        return self.content.notes if isinstance(self.content, MotionLog) else tuple(_left_out(self.content))

    def data(self) -> dict[str, Any]:
        """As printed with ``--json``."""
        kind = "motion-log" if isinstance(self.content, MotionLog) else "frf-campaign"
        return {"format": kind, "file": self.file, "parts": self._parts(), "notes": self.notes}

    def _parts(self) -> list[dict[str, Any]]:
        """Runs or postures, by field."""
        if isinstance(self.content, MotionLog):
            return [
                {
                    "run": name, "axes": run.position.shape[1], "samples": len(run.time),
                    "sample_rate_hz": run.sample_rate_hz, "start_s": float(run.time[0]),
                }
                for name, run in self.content.runs.items()
            ]  # fmt: skip
        return [
            {
                "posture": name, "q_deg": [float(q) for q in p.q_deg], "responses": p.frf.shape[1],
                "excitations": p.frf.shape[2], "lines": len(p.frequency),
                "band_hz": [float(p.frequency[0]), float(p.frequency[-1])],
            }
            for name, p in self.content.postures.items()
        ]  # fmt: skip

    def tables(self) -> list[Table]:
        """Runs or postures."""
        return [Table(self._header(), self._rows())]

    def _header(self) -> list[str]:
        log = isinstance(self.content, MotionLog)
        return ["run", "axes", "samples", "rate (Hz)"] if log else ["posture", "q (°, m)", "FRFs", "lines (Hz)"]

    def _rows(self) -> list[list[str]]:
        if isinstance(self.content, MotionLog):
            return [
                [name, str(run.position.shape[1]), str(len(run.time)), f"{run.sample_rate_hz:g}"]
                for name, run in self.content.runs.items()
            ]
        return [
            [
                name, ", ".join(f"{q:g}" for q in p.q_deg), f"{p.frf.shape[1]} × {p.frf.shape[2]}",
                f"{len(p.frequency)}, {p.frequency[0]:g} to {p.frequency[-1]:g}",
            ]
            for name, p in self.content.postures.items()
        ]  # fmt: skip

    def __str__(self) -> str:
        header = self._header()
        lines = ["; ".join(f"{h} {cell}" for h, cell in zip(header, row, strict=True) if cell) for row in self._rows()]
        lines += [f"note: {note}" for note in self.notes]
        return "\n".join([*lines, *([f"wrote {self.file}"] if self.file else [])])


def _left_out(campaign: Campaign) -> Iterator[str]:
    """Blows that no FRF is made of, and why."""
    for name, posture in campaign.postures.items():
        for row in judge_hits(posture.hits).rows if posture.hits else ():
            if row.reason:
                point = campaign.excitation.label[row.excitation]
                yield f"{name}: blow {row.hit + 1} at {point} left out: {row.reason}"


def import_files(files: Sequence[str | Path], map_: str | Path, out: str | Path | None = None) -> Imported:
    """Read foreign files as a map says.

    Args:
        files: of one kind: universal files, or any that :mod:`twin.importing` reads.
        map_: ``map.yaml``.
        out: HDF5 file to write, checked as any other recording is.

    Raises:
        InputError: a file, the map, a unit or a magnitude is wrong; nothing is written.
    """
    paths, universal = _given(files)
    if out is not None and Path(out).suffix.lower() != ".h5":
        raise InputError("--out", str(out), "expected the name of a file that ends in .h5")
    plan = read_map(Path(map_), universal)
    if plan.robot == ASK:
        expected = "state the robot: a shipped name or a path relative to the map; without this line, less is checked"
        raise InputError(map_, "robot", expected)
    robot = None if plan.robot is None else load_robot(plan.robot, relative_to=Path(map_).parent)
    content: Campaign | MotionLog
    if isinstance(plan, LogMap):
        if universal:
            raise InputError(map_, "makes", "universal files hold hammer tests: expected frf-campaign")
        content = build_log(_sources(paths), plan)
        check_log(content, robot, plan.position.first_unit, plan.torque.first_unit)
    else:
        if isinstance(plan, UniversalMap):
            content = build_universal(paths, plan)
        elif isinstance(plan, FunctionsMap):
            content = build_functions(_sources(paths), plan)
        else:
            content = build_hits(_sources(paths), plan)
        check_campaign_units(content, robot)
    if out is None:
        return Imported(content)
    if isinstance(content, MotionLog):
        write_motion_log(out, content)
    else:
        write_campaign(out, content)
    return Imported(content, Path(out))


def guess_map(files: Sequence[str | Path]) -> dict[str, Any]:
    """The map that would be used, as plain data; what a file does not say is left to ``ask``.

    Raises:
        InputError: a file cannot be read, or no name tells what it holds.
    """
    paths, universal = _given(files)
    return guess_universal(paths) if universal else guess_tables([source.table for source in _sources(paths)])


def _given(files: Sequence[str | Path]) -> tuple[list[Path], bool]:
    paths = [Path(file) for file in files]
    universal = [path for path in paths if path.suffix.lower() in UFF]
    if not paths:
        raise InputError("FILE", "", "expected at least one")
    if universal and len(universal) < len(paths):
        raise InputError(universal[0], "", "universal files and others are not read together")
    return paths, bool(universal)


def _sources(paths: Sequence[Path]) -> list[Source]:
    return [Source(path, table) for path in paths for table in read_tables(path)]
