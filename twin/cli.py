"""The ``twin`` command: one thin function per command; everything it calls is imported when it is called."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.errors import InputError

# Matrices here are small: threads inside a product cost more than they gain. Parallel work is over records and cases.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

app = typer.Typer(
    help="A MuJoCo digital twin of milling robots: simulate, fit, identify and diagnose soft joints.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

Robot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        help="Shipped name (kr90, kr90_identified), a robot.yaml or a URDF; wins over the robot a file names.",
        show_default="the file's, else kr90",
    ),
]
Without = Annotated[
    list[str] | None,
    typer.Option(
        "--without", metavar="EFFECT[@SITE]", help="Remove physics entries from the robot; may be given several times."
    ),
]
Out = Annotated[Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder for everything that is written.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else on standard output.")]
Seed = Annotated[int, typer.Option("--seed", help="Seed of every random choice.")]


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.", is_eager=True)] = False,
) -> None:
    if version:
        import twin

        print(twin.__version__)
        raise typer.Exit


@app.command()
def simulate(
    posture: Annotated[Path, typer.Argument(help="posture.yaml: robot, posture, hammer, replay.")],
    robot: Robot = None,
    without: Without = None,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """Modes, a hammer test in time and a replay of one posture.

    Prints the modes and writes robot.xml (MJCF for any MuJoCo viewer), hammer.h5 (simulated FRFs), figures, modes.rrd
    (mode animation, see twin view) and simulate.json into the output folder, out/POSTURE by default. With --json,
    files are written only where --out says so. A posture file:

    ```yaml
    robot: kr90                       # or a path, relative to this file
    posture: {name: milling, q_deg: [0, 70, -100], brakes: "on"}
    hammer: {force_n: 300, hits: 3}   # left out: 3 hits; false: modes only
    replay: trajectory.h5             # optional motion log or trajectory
    ```
    """
    from twin.commands.simulate import simulate as run

    if out is None and not json:
        out = Path("out") / posture.stem
    with _progress() as progress:
        found = run(posture, robot=robot, without=without, out=out, seed=seed, progress=progress)
    _show(found, json)


@app.command()
def modal(
    recordings: Annotated[list[Path], typer.Argument(help="measured_frf.h5, or universal files (.uff, .unv).")],
    robot: Robot = None,
    without: Without = None,
    fmin: Annotated[float | None, typer.Option(help="Lower end of the band, Hz.")] = None,
    fmax: Annotated[float | None, typer.Option(help="Upper end of the band, Hz.")] = None,
    max_order: Annotated[int, typer.Option(help="Highest order of the stabilisation chart.")] = 60,
    method: Annotated[str, typer.Option(help="Estimator of the chart: plscf or lsce (the paper's).")] = "plscf",
    out: Out = None,
    json: Json = False,
) -> None:
    """Modes of a measured hammer test, with standard deviations, not told how many.

    Takes one or several postures and force levels. Prints frequencies and damping ratios (exponential windows taken
    out) and writes modes.yaml (modal table), UFF 55 shapes, stabilisation charts, FRF overlays, MAC, shapes on the
    robot and modal.json into the output folder, out/RECORDING by default. What the data do not hold is said to be so.
    """
    from twin.commands.modal import modal as run

    if method not in ("plscf", "lsce"):
        raise InputError("--method", method, "expected plscf or lsce")
    if out is None and not json:
        out = Path("out") / recordings[0].stem
    with _progress() as progress:
        found = run(
            recordings, robot=robot, without=without, fmin=fmin, fmax=fmax, max_order=max_order,
            method="lsce" if method == "lsce" else "plscf", out=out, progress=progress,
        )  # fmt: skip
    _show(found, json)


@app.command()
def view(
    path: Annotated[Path, typer.Argument(help="An output folder, a .rrd, a robot.yaml or URDF, or a recording.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write a .rrd instead of opening a viewer.")
    ] = None,
) -> None:
    """Look at modes, replays and robots in the rerun viewer.

    Opens the animations of an output folder or a .rrd. A robot is shown in its middle posture, moving in its modes.
    """
    from twin.commands.view import view as run

    print(run(path, out))


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str, int], Callable[[int], None]]]:
    """Progress bars on standard error, gone when the work is done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    bars = Progress(*columns, console=Console(stderr=True), transient=True)

    def start(description: str, total: int) -> Callable[[int], None]:
        bars.start()
        task = bars.add_task(description, total=total)
        return lambda count: bars.advance(task, count)

    try:
        yield start
    finally:
        if bars.tasks:
            bars.stop()


def _show(result: Any, json: bool) -> None:
    if json:
        from twin.provenance import to_json

        print(to_json(result.data()))
    else:
        print(result)


def main() -> None:
    """Entry point: bad input ends in one line on standard error and exit code 2."""
    try:
        app()
    except InputError as error:
        print(f"twin: {error}", file=sys.stderr)
        sys.exit(2)
