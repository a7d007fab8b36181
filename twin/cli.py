"""The ``twin`` command: one thin function per command; everything it calls is imported when it is called."""

import inspect
import io
import math
import os
import sys
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

import twin
from twin.errors import InputError, NumericalError, Told, numbers_of
from twin.memory import keep_memory
from twin.parallel import Progress, silent
from twin.stopping import Stopped, end_after, stoppable

# Matrices here are small: threads inside a product cost more than they gain. Parallel work is over records and cases.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Nothing here draws with MuJoCo: importing it need not look for a display.
os.environ.setdefault("MUJOCO_GL", "disable")

app = typer.Typer(
    help="A MuJoCo digital twin of milling robots: simulate, fit, identify and diagnose soft joints.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _a_folder(out: Path | None) -> Path | None:
    """A folder as asked for: ``-o robot.yaml`` means a file, of which a command writes several."""
    if out is not None and out.suffix in (".yaml", ".yml", ".json", ".h5", ".xml", ".html") and not out.is_dir():
        raise InputError("--out", str(out), "is named like a file; expected a folder, into which all files go")
    return out


def _within(low: float, high: float = math.inf) -> Callable[[Any], Any]:
    """A check that keeps the range out of the help's columns, where it would take the room of the words."""

    def check(value: Any) -> Any:
        if value is not None and not low <= value <= high:
            raise typer.BadParameter(f"{value} is not in the range {low:g} to {high:g}")
        return value

    return check


def _count(*names: str, low: int = 1, **more: Any) -> Any:
    return typer.Option(*names, metavar="N", callback=_within(low), **more)


def _flag(name: str, help: str) -> Any:
    """An option without a value: its help shows none."""
    return typer.Option(name, metavar="", help=help)


Robot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="ROBOT",
        help="Shipped name (kr90, kr90_identified, kr90_six), robot.yaml or URDF. It replaces the robot that a file "
        "names.",
        show_default="the file's, else kr90",
    ),
]
Without = Annotated[
    list[str] | None,
    typer.Option(
        "--without", metavar="EFFECT[@SITE]", help="Take physics entries out of the robot; may be given several times."
    ),
]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="DIR", help="Output folder.", callback=_a_folder),
]  # fmt: skip
Json = Annotated[bool, _flag("--json", "Print the result as JSON, and nothing else on standard output.")]
Seed = Annotated[int, _count("--seed", low=0, help="Seed of all random numbers.")]
NoSeed = Annotated[int, _count("--seed", low=0, help="Without effect: this command draws no random numbers.")]
Timeout = Annotated[
    float | None,
    typer.Option(
        "--timeout", metavar="SECONDS", help="Stop after this time; no file is left half-written.",
        show_default="none", callback=_within(0.001, 1e8),
    ),
]  # fmt: skip


def command(name: str | None = None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function a command, with what all have in common: ``--timeout``, and names for broken numbers."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def run(*, timeout: float | None, **given: Any) -> None:
            end_after(timeout)
            name, files = function.__name__.rstrip("_"), _files(given)
            from twin.effort import expected_s, told  # imports numpy, which must not be before the line on threads

            for file in files:
                if os.path.exists(file) and not os.path.isfile(file) and not os.path.isdir(file):
                    raise InputError(file, "", "is a pipe or a device; expected a file")
            work = f"{name} --as-is" if given.get("as_is") else name
            if (wait := told(expected_s(work, files))) and not _asked("quiet"):
                print(f"twin: {wait} for a recording of this size", file=sys.stderr)
            with numbers_of(", ".join(files) or name):
                function(**given)

        own = inspect.signature(function)
        last = inspect.Parameter("timeout", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Timeout)
        run.__signature__ = own.replace(parameters=[*own.parameters.values(), last])  # type: ignore[attr-defined]
        run.__annotations__ = {**function.__annotations__, "timeout": Timeout}
        return app.command(name=name)(run)

    return register


def _files(given: dict[str, Any]) -> list[str]:
    """The files that a command was given."""
    lists = [value if isinstance(value, list) else [value] for key, value in given.items() if key != "out"]
    return [str(item) for values in lists for item in values if isinstance(item, Path)]


def _beside(file: Path, command: str) -> Path:
    """Where a command writes by default: out/FILE, out/FILE-COMMAND where the file's own folder is that."""
    out = Path("out") / file.stem
    return out.with_name(f"{out.name}-{command}") if out.resolve() == file.parent.resolve() else out


_HOW: ContextVar[str] = ContextVar("how much is said", default="")


def _print_version(asked: bool) -> None:
    if asked:
        print(f"twin {twin.__version__}")
        raise typer.Exit


def _print_docs(asked: bool) -> None:
    """The folder of the guides: inside an installed package, or at the top of a clone."""
    if asked:
        folders = [Path(__file__).resolve().parents[level] / "docs" for level in (0, 1)]
        found = next((folder for folder in folders if (folder / "formats.md").is_file()), None)
        if found is None:
            raise InputError("--docs", "", "this installation has no guides; they are the folder docs of the sources")
        print(found)
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", metavar="", help="Print the version and stop.", is_eager=True, callback=_print_version
        ),
    ] = False,
    docs: Annotated[
        bool,
        typer.Option(
            "--docs",
            metavar="",
            help="Print the folder of the guides and stop: docs/fit.md is its file fit.md.",
            is_eager=True,
            callback=_print_docs,
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", metavar="", help="No progress bars; print only the first line.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", metavar="", help="Also list every file that was written.")
    ] = False,
) -> None:
    if quiet and verbose:
        raise InputError("--quiet", "", "and --verbose exclude each other")
    _HOW.set("quiet" if quiet else "verbose" if verbose else "")


def _asked(how: str) -> bool:
    """Whether the command runs ``quiet`` or ``verbose``."""
    return _HOW.get() == how


def _bars() -> AbstractContextManager[Progress]:
    """Progress bars, unless quiet."""
    return nullcontext(silent) if _asked("quiet") else twin.progress()


@command()
def describe(
    drawing: Annotated[Path, typer.Argument(metavar="URDF|MJCF", help="The robot's links and joints.")],
    sheet: Annotated[
        Path | None, typer.Option(metavar="FILE", help="sheet.yaml: payload, reach, masses, speeds, torques, gears.")
    ] = None,
    tool: Annotated[
        Path | None, typer.Option(metavar="FILE", help="tool.yaml: the tool on the flange, as numbers or as a mesh.")
    ] = None,
    without: Without = None,
    out: Out = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """A robot that can be simulated, fitted and diagnosed, from a URDF or MJCF and a data sheet of a few lines.

    Axes, limits, masses, meshes and collision shapes are kept. Gear ratios, rotors, friction, stiffness and damping
    come from the sheet, or from scaling laws over published robots. The latter are listed as assumed, each with its
    source, its uncertainty and the test that would measure it. Impossible inertias are repaired, side branches are
    welded and closed loops are reduced. Each such change is printed.

    ```yaml
    # sheet.yaml; every key may be left out
    payload: 10                                   # kg
    max_speed: [120, 120, 180, 180, 180, 180]     # °/s, one per axis
    max_torque: [330, 330, 150, 54, 54, 54]       # N·m at the joint
    gear_ratio: [101, 101, 101, 101, 101, 101]    # motor turns per joint turn
    ```

    ```
    twin describe arm.urdf
    twin describe arm.urdf --sheet sheet.yaml --tool tool.yaml -o out/arm
    ```

    Writes robot.yaml, robot.xml (MJCF), meshes, describe.html and describe.json into the output folder, out/DRAWING by
    default. With --json, files are written only where --out says so. docs/describe.md explains every key.
    """
    if out is None and not json:
        out = Path("out") / drawing.stem
    _show(twin.describe(drawing, sheet=sheet, tool=tool, without=without, out=out), json)


@command()
def simulate(
    posture: Annotated[Path, typer.Argument(metavar="POSTURE", help="posture.yaml: robot, posture, hammer, replay.")],
    robot: Robot = None,
    without: Without = None,
    movie: Annotated[bool, _flag("--movie", "Also write the animated modes as modes.gif.")] = False,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """Modes, a hammer test in time and a replay of one posture.

    Prints the modes and writes these files into the output folder, out/FILE by default: simulate.html (the report),
    robot.yaml, robot.xml (MJCF for any MuJoCo viewer), hammer.h5 (simulated FRFs), figures, modes.rrd (animated modes,
    see twin view) and simulate.json. A replay adds replay.h5 (a motion log) and an animation of each run. With --json,
    files are written only where --out says so. A posture file:

    ```yaml
    robot: kr90                       # or a path, relative to this file
    posture: {name: milling, q_deg: [0, 70, -100], brakes: "on"}
    hammer: {force_n: 300, hits: 3}   # the default; false: modes only
    replay: trajectory.h5             # optional: motion log or trajectory
    ```

    ```
    twin simulate posture.yaml
    twin simulate posture.yaml --robot out/fit/robot.yaml -o out/fitted
    ```
    """
    if out is None and not json:
        out = Path("out") / posture.stem
    with _bars() as progress:
        found = twin.simulate(posture, robot=robot, without=without, movie=movie, out=out, seed=seed, progress=progress)
    _show(found, json)


@command()
def modal(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING", help="Hammer tests of the same points (.h5, .uff, .unv).")
    ],
    robot: Robot = None,
    without: Without = None,
    fmin: Annotated[
        float | None, typer.Option(metavar="HZ", help="Lower end of the band, Hz.", show_default="the first line")
    ] = None,
    fmax: Annotated[
        float | None, typer.Option(metavar="HZ", help="Upper end of the band, Hz.", show_default="the last line")
    ] = None,
    max_order: Annotated[int, typer.Option(metavar="N", help="Highest order of the stabilisation chart.")] = 60,
    method: Annotated[
        str, typer.Option(metavar="NAME", help="Estimator of the chart: plscf, or lsce as in the paper.")
    ] = "plscf",
    operational: Annotated[
        bool, _flag("--operational", "The recording holds responses only (needs twin[operational]).")
    ] = False,
    out: Out = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """Modes of a measured hammer or shaker test, with standard deviations. Their number is found, not given.

    It works on any structure: axis positions and a robot are needed only to draw shapes on the robot.

    Takes one or several postures and force levels. Prints frequencies and damping ratios; exponential windows are
    taken out. Remarks say what the data do not determine. Writes these files into the output folder, out/RECORDING by
    default: modal.html (the report), modes.yaml (modal table), POSTURE_modes.unv (shapes, UFF 55), POSTURE_modes.rrd
    (animated shapes, see twin view), figures and modal.json. With --json, files are written only where --out says so.

    With --operational: modes of a structure in operation. It reads universal files with time responses, or
    frf-campaign HDF5 with postures/NAME/running/response. The excitation is not measured, so it must be broadband.

    ```
    twin modal measured_frf.h5 --fmax 60
    twin modal a.unv b.unv -o out/modal
    twin modal running.h5 --operational
    ```
    """
    if method not in ("plscf", "lsce"):
        raise InputError("--method", method, "expected plscf or lsce")
    if out is None and not json:
        out = Path("out") / recordings[0].stem
    with _bars() as progress:
        found = twin.modal(
            recordings, robot=robot, without=without, fmin=fmin, fmax=fmax, max_order=max_order,
            method="lsce" if method == "lsce" else "plscf", operational=operational, out=out, progress=progress,
        )  # fmt: skip
    _show(found, json)


HoldOut = Annotated[
    list[str] | None,
    typer.Option("--hold-out", metavar="NAME", help="Posture or run not used for fitting; may be given several times."),
]


@command()
def fit(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING", help="Hammer tests (.h5, .uff, .unv) or modal tables (.yaml)."),
    ],
    robot: Robot = None,
    without: Without = None,
    hold_out: HoldOut = None,
    leave_one_out: Annotated[
        bool, _flag("--leave-one-out", "Also predict every posture from a fit to the others.")
    ] = False,
    objective: Annotated[
        str,
        typer.Option(metavar="NAME", help="posterior; of modal tables also paper (Eq. 23, weights 100 and 1)."),
    ] = "posterior",
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Frequency band of the lines used, Hz.", metavar="LOW HIGH", show_default="all"),
    ] = None,
    no_tolerances: Annotated[
        bool, _flag("--no-tolerances", "Keep masses, centres of mass, inertias, angles and gains as described.")
    ] = False,
    starts: Annotated[int, _count(help="Number of starting points; their results must agree.")] = 4,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """Joint stiffness and damping from measured FRFs, with intervals, and what the data do not determine.

    Maximum-posterior fit of every spring and damper, over all postures and force levels at once. Masses, centres of
    mass, inertias, posture angles and channel gains are free within the robot's tolerances. Priors and tolerances are
    data in robot.yaml. The fit starts several times, and says if the starts do not agree. With three postures or more
    the last one is held out and predicted. With fewer, every blow is predicted from the others.

    ```
    twin fit measured_frf.h5                     # robot: the file's, else kr90
    twin fit measured_frf.h5 --hold-out upright  # predict that posture instead
    twin fit measured_frf.h5 --leave-one-out     # predict each from the others
    twin fit modes.yaml --objective paper        # the paper's Eq. 23
    ```

    A number in ( ) is not determined by the data: it is a bound, or mostly the prior. docs/fit.md explains every line.
    The command writes these files into the output folder, out/RECORDING by default: fit.html (the report), robot.yaml,
    robot.xml (MJCF), posterior.h5 (how certain the numbers are, for twin lobes and twin map), figures and fit.json.
    With --json, files are written only where --out says so. Next: twin compare judges the new robot on other
    recordings, and twin diagnose looks for physics it lacks.
    """
    if objective not in ("posterior", "paper"):
        raise InputError("--objective", objective, "expected posterior or paper")
    if out is None and not json:
        out = _beside(recordings[0], "fit")
    with _bars() as progress:
        found = twin.fit(
            recordings, robot=robot, without=without, hold_out=hold_out, leave_one_out=leave_one_out,
            objective="paper" if objective == "paper" else "posterior", band_hz=band, tolerances=not no_tolerances,
            starts=starts, out=out, seed=seed, progress=progress,
        )  # fmt: skip
    _show(found, json)


@command()
def excite(
    robot: Robot = None,
    without: Without = None,
    count: Annotated[int, _count(help="Number of different trajectories.")] = 6,
    harmonics: Annotated[int, _count(help="Number of harmonics of the Fourier series.")] = 5,
    base_hz: Annotated[float, typer.Option(metavar="HZ", help="Fundamental frequency, Hz.")] = 0.1,
    rest: Annotated[bool, _flag("--rest", "Start and end at rest, so that a controller can run them.")] = False,
    criterion: Annotated[
        str, typer.Option(metavar="NAME", help="What is optimised: condition (number) or d-optimal.")
    ] = "condition",
    periods: Annotated[int, _count(help="Number of periods in the files.")] = 1,
    sample_rate_hz: Annotated[float, typer.Option(metavar="HZ", help="Sampling rate of the files, Hz.")] = 250.0,
    krl: Annotated[bool, _flag("--krl", "Also write KUKA spline programs; implies --rest.")] = False,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """Trajectories that excite every identifiable parameter, within all limits at all times.

    Fourier series of minimum condition number (or D-optimal). They keep the limits of position, velocity, acceleration
    and workspace that the robot states. Writes excite.html (the report), trajectory.h5, one CSV per trajectory, figures
    and excite.json into the output folder, out/excite by default. With --json, files are written only where --out says
    so. A posture file replays trajectory.h5.

    For a controller add --rest: without it the motion starts at speed. Collisions are not checked, and a robot of
    twin describe states no workspace: try at a tenth of the speed. KUKA programs (.src) hold A = -q, because the axes
    of the shipped robots turn against KUKA's.

    ```
    twin excite --robot kr90 --count 1
    twin excite --robot kr90 --krl
    twin excite --robot out/arm/robot.yaml --rest -o out/motions
    ```
    """
    if criterion not in ("condition", "d-optimal"):
        raise InputError("--criterion", criterion, "expected condition or d-optimal")
    if out is None and not json:
        out = Path("out") / "excite"
    with _bars() as progress:
        found = twin.excite(
            robot=robot, without=without, out=out, count=count, harmonics=harmonics, base_hz=base_hz, rest=rest,
            criterion="d-optimal" if criterion == "d-optimal" else "condition", periods=periods,
            sample_rate_hz=sample_rate_hz, krl=krl, seed=seed, progress=progress,
        )  # fmt: skip
    _show(found, json)


@command()
def identify(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A motion log: HDF5, or CSV with the header time,q1..qn,tau1..taun.")
    ],
    robot: Robot = None,
    without: Without = None,
    hold_out: HoldOut = None,
    low_pass: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="PASS STOP",
            help="Low-pass filter of torques and regressor, Hz. For a log shorter than 40 s, by default the one that "
            "predicts held-out torque best.",
            show_default="3 4",
        ),
    ] = None,
    weighting: Annotated[
        str, typer.Option(metavar="NAME", help="Weights: joint (by the noise of each joint) or none.")
    ] = "joint",
    out: Out = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """Inertial, rotor, friction and compensator parameters from torque logs, with intervals.

    Least squares on base parameters, then the physically consistent set nearest to the description. The robot's physics
    entries say which friction laws, compensators and cables are fitted; --without takes one out. Whole runs are held
    out, or contiguous blocks if there is one run only. Dropped, jittered or saturated samples are repaired with a
    note, or refused. docs/fit.md explains every line. The command writes identify.html (the report), robot.yaml,
    robot.xml (MJCF), figures and identify.json into the output folder, out/LOG by default. With --json, files are
    written only where --out says so.

    ```
    twin identify log.h5
    twin identify log.h5 --robot out/arm/robot.yaml --hold-out run3
    ```
    """
    if weighting not in ("joint", "none"):
        raise InputError("--weighting", weighting, "expected joint or none")
    if out is None and not json:
        out = _beside(log, "identify")
    with _bars() as progress:
        found = twin.identify(
            log, robot=robot, without=without, out=out, hold_out=hold_out, low_pass=low_pass, weighting=weighting,
            progress=progress,
        )  # fmt: skip
    _show(found, json)


@command()
def compare(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING", help="Hammer tests (.h5, .uff, .unv), motion logs (.h5, .csv), modal tables (.yaml)."
        ),
    ],
    robot: Robot = None,
    without: Without = None,
    as_is: Annotated[
        bool,
        _flag(
            "--as-is", "Estimate nothing again, not even posture angles, gains and offsets, and put no channel right."
        ),
    ] = False,
    low_pass: Annotated[
        tuple[float, float], typer.Option(metavar="PASS STOP", help="Low-pass filter of torques, Hz.")
    ] = (
        3.0,
        4.0,
    ),
    stepped: Annotated[bool, _flag("--stepped", "Also replay motion logs in MuJoCo's time stepping.")] = False,
    out: Out = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """The error of a robot on recordings, without fitting it, split by posture or run, channel and band.

    One number per recording: RMS of the residual over RMS of the data. FRF lines are weighted by one over their
    variance. Torques are low-passed and judged joint by joint. Modal tables give relative frequency differences. Only
    what belongs to a recording itself (posture angles, channel gains, torque offsets) is estimated again, within the
    stated tolerances. With --as-is not even that is.

    ```
    twin compare measured_frf.h5 --robot out/measured_frf/robot.yaml
    twin compare log.h5 modes.yaml measured_frf.h5 -o out/compare
    ```

    compare.html (the report), compare.json and figures are written only where --out says so.
    """
    with _bars() as progress:
        found = twin.compare(
            recordings, robot=robot, without=without, out=out, as_is=as_is, low_pass=low_pass, stepped=stepped,
            progress=progress,
        )  # fmt: skip
    _show(found, json)


@command()
def diagnose(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="Hammer tests (.h5, .uff, .unv), motion logs (.h5, .csv), modal tables (.yaml), of one robot.",
        ),
    ],
    robot: Robot = None,
    without: Without = None,
    hold_out: HoldOut = None,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
    minutes: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Minutes after which the search of a hammer test or modal table starts no further round; the answer "
            "says what was left out. For a motion log: minutes after which no wider filter band is tried.",
            show_default="3, more for a large recording",
            callback=_within(0.0, 1e6),
        ),
    ] = None,
) -> None:
    """What physics does a model lack? Finds it, names it, says how sure, and writes it into the model.

    The model is fitted as it is. Then every effect is tried at every site that the recordings can show, and the most
    promising are fitted. Postures or runs that were not used judge them. The verdict is one of

    - **adequate**: nothing is missing that these recordings could show;
    - **named**: each thing missing is one effect at one site, and stands out;
    - **ambiguous**: the recordings cannot tell several answers apart; a test that would is proposed;
    - **located** (motion logs): a law without a name is missing at a known joint; its formula is given;
    - **unexplained**: there is a mismatch beyond noise, and it is none of these.

    Several recordings get one model. The command writes these files into the output folder, out/RECORDING by default:
    diagnosis.html (the report), diagnosis.json, the new robot.yaml and robot.xml (always), figures, and
    modes-before.rrd and modes-after.rrd (see twin view). Hammer tests without a nonlinear answer add posterior.h5, for
    twin lobes and twin map. With --json, files are written only where --out says so. docs/diagnosis.md explains the
    answer.

    ```
    twin diagnose measured_frf.h5
    twin diagnose log.h5 --robot out/arm/robot.yaml --hold-out run3
    twin diagnose measured_frf.h5 log.h5     # one model of both
    ```

    To try it, take an entry out of the robot first: --without transverse_compliance@joint1.x conceals a soft bearing.
    """
    if out is None and not json:
        out = _beside(recordings[0], "diagnose")
    with _bars() as progress:
        found = twin.diagnose(
            recordings, robot=robot, without=without, hold_out=hold_out, out=out, seed=seed, minutes=minutes,
            progress=progress,
        )  # fmt: skip
    _show(found, json)


@command()
def lobes(
    given: Annotated[
        Path,
        typer.Argument(
            metavar="POSTURE|ROBOT|FRF|FOLDER",
            help="posture.yaml, robot.yaml, a hammer test of the tool (.h5, .uff), or a fit's or diagnosis' folder.",
        ),
    ],
    robot: Robot = None,
    without: Without = None,
    cut: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="cut.yaml: tool, coefficients, immersion.",
            show_default="the posture file's, else a usual cut",
        ),
    ] = None,
    q: Annotated[
        str | None,
        typer.Option(
            "--q",
            metavar="Q1,Q2,…",
            help="Posture of a robot, degrees (m on a linear axis).",
            show_default="middle of the limits",
        ),
    ] = None,
    posture: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which posture of a hammer test.", show_default="the first")
    ] = None,
    rpm: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Range of spindle speeds, rpm.", show_default="the cut's"),
    ] = None,
    draws: Annotated[int, _count(low=0, help="Robots drawn from the posterior for the 90 % depth; 0 for none.")] = 100,
    in_time: Annotated[
        int,
        _count("--in-time", low=0, help="Also step the cut in MuJoCo at N speeds, with nonlinear joints."),
    ] = 0,
    blow: Annotated[
        float, typer.Option(metavar="N·S", help="Impulse on the tip before each cut in time, N·s; 0: from rest.")
    ] = 0.0,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """How deep a robot may cut in a posture, at every spindle speed, and how sure.

    Solves the delay equation of milling with the full FRF at the tool tip, all modes and cross terms, by a spectral
    method. Hopf, flip and low-frequency mode coupling are one calculation. For a robot that twin fit or twin diagnose
    wrote, it gives the depth that is stable with 90 % probability, cutting coefficients included. Brakes are off, as in
    a cut: a soft servo counts.

    ```yaml
    # posture.yaml
    robot: out/measured_frf/robot.yaml
    posture: {name: milling, q_deg: [0, 70, -100]}
    cut:                            # or the path of a cut.yaml
      tool: {diameter_m: 0.016, teeth: 2, helix_deg: 30, mass_kg: 12}
      coefficients: aluminium_7075  # or numbers: kt_n_per_m2: 6.0e8 …
      immersion: 0.5                # radial depth over diameter
      milling: down
      feed_per_tooth_m: 1.0e-4
      feed_direction: [1, 0, 0]     # in the robot's base frame
      spindle_rpm: [1000, 12000]
    ```

    ```
    twin lobes posture.yaml
    twin lobes out/measured_frf --q 0,70,-100 --cut cut.yaml
    twin lobes tool_frf.h5 --cut cut.yaml         # a measured FRF, no model
    twin lobes posture.yaml --in-time 3           # with gaps and slip
    twin lobes posture.yaml --in-time 3 --blow 5  # after a blow of 5 N·s
    ```

    Prints limits and writes lobes.html (the report), lobes.json and figures into the output folder, out/GIVEN by
    default. The figures show the chart, the frequency at the limit, the forced vibration and the surface location error
    of the safe cut. With --json, files are written only where --out says so. docs/milling.md explains every number.
    Next: twin map does the same over the workspace.
    """
    if out is None and not json:
        out = Path("out") / (given.stem or given.name)
    with _bars() as progress:
        found = twin.lobes(
            given, robot=robot, without=without, cut=cut, q_deg=None if q is None else _numbers("--q", q, float),
            posture=posture, spindle_rpm=rpm, draws=draws, in_time=in_time, blow_n_s=blow, out=out, seed=seed,
            progress=progress,
        )  # fmt: skip
    _show(found, json)


@command("map")
def map_(
    cut: Annotated[
        Path | None,
        typer.Argument(metavar="CUT", help="cut.yaml: tool, coefficients, immersion.", show_default="a usual cut"),
    ] = None,
    robot: Robot = None,
    without: Without = None,
    random: Annotated[
        int | None, typer.Option("--random", metavar="N", help="Number of random postures.", show_default="1000")
    ] = None,
    grid: Annotated[
        tuple[int, int, int] | None,
        typer.Option(
            "--grid", metavar="NX NY NZ", help="Instead: a grid of tip positions in --box.", show_default=False
        ),
    ] = None,
    posture_grid: Annotated[
        str | None,
        typer.Option(
            "--posture-grid", metavar="N1,N2,…", help="Instead: so many positions of each axis.", show_default=False
        ),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option("--path", metavar="FILE", help="Instead: a tool path (.csv, G-code or APT).", show_default=False),
    ] = None,
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            "--box",
            metavar="SIX NUMBERS",
            help="Region of --grid in the base frame, m: x0 x1 y0 y1 z0 z1.",
            show_default="the robot's workspace",
        ),
    ] = None,
    place: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--place", metavar="X Y Z", help="Origin of the path in the base frame, m.", show_default="0 0 0"),
    ] = None,
    place_turn_deg: Annotated[float, typer.Option(metavar="DEG", help="Rotation of the path about z, degrees.")] = 0.0,
    near: Annotated[
        str | None,
        typer.Option("--near", metavar="Q1,Q2,…", help="Find postures near this one, degrees.", show_default=False),
    ] = None,
    spacing: Annotated[float, typer.Option(metavar="M", help="Distance between points of a path, m.")] = 0.01,
    spindle_rpm: Annotated[
        float | None,
        typer.Option(
            metavar="RPM", help="Spindle speed of the closed form, rpm.", show_default="the least depth of all speeds"
        ),
    ] = None,
    lobes: Annotated[
        int, typer.Option(metavar="N", help="Full lobes at N spindle speeds instead of the closed form; 0 for none.")
    ] = 0,
    draws: Annotated[int, typer.Option(metavar="N", help="Robots drawn from the posterior; 0 for none.")] = 50,
    processes: Annotated[int | None, _count(help="Number of processes.", show_default="cores of this machine")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Of a Dask scheduler: tcp://HOST:8786.", show_default="none"),
    ] = None,
    out: Out = None,
    json: Json = False,
    seed: Seed = 0,
) -> None:
    """How deep the robot may cut, where, and how sure: modes, compliance and depth over its workspace or a tool path.

    With a robot.yaml that twin fit or twin diagnose wrote (posterior.h5 beside it), every depth comes with the one
    that is stable with 90 % probability. Robots of up to four axes keep the position of the tip. Robots of five or
    more axes keep the direction of the tool too; its free rotation about the tool axis is chosen for the best depth.

    ```
    twin map cut.yaml                          # 1000 random postures
    twin map cut.yaml --grid 30 1 20 --spindle-rpm 3000
    twin map cut.yaml --path part.nc --place 1.6 0 0.9
    twin map cut.yaml --robot out/frf/robot.yaml
    twin map cut.yaml --random 200 --lobes 60  # full lobes
    ```

    Writes map.html (the report), map.h5, figures, map.rrd (see twin view) and map.json into the output folder, out/map
    by default. With --json, files are written only where --out says so. The same command continues an interrupted map.
    docs/map.md explains every number.
    """
    from twin.commands.map import make_map as run

    if out is None and not json:
        out = Path("out") / "map"
    counts = None if posture_grid is None else _numbers("--posture-grid", posture_grid, int)
    with _bars() as progress:
        found = run(
            cut, robot=robot, without=without, random=random, grid=grid, posture_grid=counts, path=path, box=box,
            place=place, place_turn_deg=place_turn_deg,
            near_deg=None if near is None else _numbers("--near", near, float), spacing=spacing,
            spindle_rpm=spindle_rpm, lobes=lobes, draws=draws, processes=processes,
            scheduler=scheduler, out=out, seed=seed, progress=progress,
        )  # fmt: skip
    _show(found, json)


def _numbers(option: str, text: str, kind: type[int] | type[float]) -> list[Any]:
    """Numbers joined by commas."""
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(option, text, "expected numbers joined by commas") from error


@command()
def view(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="An output folder, a .rrd, a robot or a recording.")],
    robot: Robot = None,
    without: Without = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write this .rrd instead of opening a viewer.")
    ] = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """Look at modes, replays and robots in the rerun viewer.

    Opens the animations of an output folder or a .rrd. A robot is shown in the middle of its limits. A hammer test or
    a modal table is shown in its first posture, moving in the modes of the model. A motion log is replayed. Of a robot
    or a recording, out/NAME.rrd is written first, or the file that --out names.

    ```
    twin view out/milling
    twin view out/campaign                # models before and after
    twin view out/arm/robot.yaml -o arm.rrd
    ```
    """
    from twin.commands.view import view as run

    said = run(path, out, robot=robot, without=without)
    if json:
        from twin.provenance import to_json

        said = to_json({"shown": said})
    print(said)


@command("import")
def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Files of one kind, or bags (folders).")],
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="map.yaml: channels and their units.")
    ] = None,
    guess: Annotated[bool, _flag("--guess", "Print a map made from the channel names, to be corrected.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="File to write: campaign.h5 or log.h5.")
    ] = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """Foreign recordings: UFF, MATLAB, CSV, WAV, TDMS, KUKA traces, UR RTDE, ROS bags, MCAP.

    A map says which channel becomes what, and in which unit. Units are declared, never guessed. docs/import.md explains
    every field.

    ```
    twin import trace.dat --guess > map.yaml  # then replace every `ask`
    twin import trace.dat --map map.yaml -o log.h5
    ```
    """
    from twin.commands.foreign import guess_map, import_files
    from twin.provenance import to_json

    if guess == (map_file is not None):
        raise InputError("--map", "", "expected either --map FILE or --guess, which prints one")
    if guess:
        found = guess_map(files)
        if json:
            print(to_json(found))
        else:
            from twin.yamlfile import dump_yaml

            dump_yaml(found, sys.stdout)
        return
    if out is None and not json:
        raise InputError("--out", "", "expected the file to write, as -o campaign.h5")
    assert map_file is not None
    _show(import_files(files, map_file, out), json)


@command()
def example(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which one: cell or arm.")] = "cell",
    out: Out = None,
    json: Json = False,
    seed: NoSeed = 0,
) -> None:
    """Recordings to try everything on: a robot with a concealed fault.

    Writes a folder of the example's name. cell: a hammer test with raw hits, a motion log and posture files of the
    KR90. arm: a URDF of a small arm and two records of its controller. An independent code simulated the robot;
    answer.json says what was concealed.

    ```
    twin example
    twin diagnose cell/campaign.h5
    ```
    """
    from twin.commands.example import example as run

    _show(run(name, out), json)


def _show(result: Any, json: bool) -> None:
    if json:
        from twin.provenance import to_json

        print(to_json(result.data()))
        return
    print(str(result).partition("\n")[0] if _asked("quiet") else result)
    if _asked("verbose"):
        print(*getattr(result, "files", []), sep="\n")


def main() -> None:
    """Entry point: bad input ends in one line on standard error and exit code 2."""
    keep_memory()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without Greek letters is no reason to lose a result
    sys.exit(_run())


def _run() -> int:
    """The exit code: 2 for bad input, 3 for numbers that break a calculation, 124 for time that is up."""
    told: list[str] = []  # once the command has a result: a refusal is one line
    try:
        with stoppable(), warnings.catch_warnings():
            if not sys.warnoptions:
                warnings.simplefilter("ignore")  # of libraries; what matters is in the result
            warnings.simplefilter("always", Told)
            warnings.showwarning = _collecting(told, warnings.showwarning)
            code = app(standalone_mode=False) or 0
        for line in dict.fromkeys(told):
            _say(f"note: {line}", 0)
        return code
    except Stopped as stop:
        return _say(str(stop), stop.code)
    except InputError as error:
        return _say(str(error), 2)
    except NumericalError as error:
        return _say(str(error), 3)
    except MemoryError as error:
        return _say(f"system: not enough memory for input of this size ({error})", 2)
    except OSError as error:
        return _say(f"{error.filename or 'system'}: {error.strerror or error}", 2)
    except Exception as error:
        if not hasattr(error, "format_message"):  # of the command line's parser
            raise
        return _usage(error)


def _collecting(told: list[str], otherwise: Callable[..., None]) -> Callable[..., None]:
    """How a warning is shown: what is told of the input goes to a list."""

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, Told):
            told.append(str(message))
        else:
            otherwise(message, category, *where, **more)

    return show


def _usage(error: Any) -> int:
    """One line for an argument that is missing or makes no sense; the help where nothing was asked."""
    if error.ctx is not None and len(sys.argv) < 2:
        error.show()
    else:
        option = getattr(getattr(error, "param", None), "opts", None) or ["arguments"]
        _say(f"{option[-1]}: {' '.join(error.format_message().split())}", 2)
    return int(error.exit_code)


def _say(line: str, code: int) -> int:
    print(f"twin: {line}", file=sys.stderr)
    return code
