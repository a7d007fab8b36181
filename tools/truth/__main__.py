"""Command line of the truth code: `python -m tools.truth campaign | log | effects`."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from tools.truth.chain import Chain, Tolerances, kr90
from tools.truth.effects import EFFECTS, TruthError, parse
from tools.truth.motion import Log, Run, draw_fourier, read_positions, sampled, write_log
from tools.truth.recording import (
    HammerTest,
    Posture,
    check,
    draw_postures,
    draw_truth,
    streams,
    write_campaign,
)

EXAMPLES = """
examples:
  A robot near the KR90, hammer tests in eight postures, a foundation that tilts:
    python -m tools.truth campaign --out c.h5 --seed 1 --postures 8 --effect base_compliance@base.rx
  A gap in joint 1 of given size, two force levels:
    python -m tools.truth campaign --out c.h5 --effect backlash@joint1.z:gap=5e-5 --force-levels 100 600
  The nominal KR90, without noise:
    python -m tools.truth campaign --out c.h5 --nominal --noise 0 --scatter 0
  Four one-minute motions with standstills, friction with memory, a payload:
    python -m tools.truth log --out l.h5 --seed 1 --runs 4 --dwells 3 --friction slip --effect payload@flange
The truth (parameters, effects with their sizes, errors) goes to --answer, by default OUT with .truth.json.
An effect is KIND@SITE[:name=value,...], a list's items joined by |; what is not given is drawn from the seed.
`python -m tools.truth effects` lists kinds, sites, parameters and usual ranges.
"""


def main(arguments: list[str] | None = None) -> int:
    parser = build_parser()
    options = parser.parse_args(arguments)
    try:
        options.run(options)
    except (TruthError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def build_parser() -> argparse.ArgumentParser:
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m tools.truth",
        description="Recordings of a robot whose truth is known, by code that shares nothing with the twin.",
        epilog=EXAMPLES,
        formatter_class=shape,
    )
    commands = parser.add_subparsers(required=True, metavar="campaign | log | effects")
    _campaign(
        commands.add_parser("campaign", help="hammer tests (frf-campaign)", epilog=EXAMPLES, formatter_class=shape)
    )
    _log(commands.add_parser("log", help="motion logs (motion-log)", epilog=EXAMPLES, formatter_class=shape))
    listing = commands.add_parser("effects", help="list what can be concealed")
    listing.set_defaults(run=list_effects)
    return parser


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, help="file to write (.h5)")
    parser.add_argument("--answer", type=Path, help="JSON with the truth (default: beside OUT, .truth.json)")
    parser.add_argument("--seed", type=int, default=0, help="decides robot, sizes, postures, noise (default 0)")
    parser.add_argument("--effect", action="append", default=[], metavar="KIND@SITE[:…]", help="conceal it; repeatable")
    parser.add_argument("--nominal", action="store_true", help="the described robot exactly, no tolerances")
    parser.add_argument(
        "--hinges", type=int, choices=(1, 3), default=3, help="soft axes per joint (default 3: z, x, y)"
    )
    parser.add_argument("--robot", default="kr90", help="name written into the file; '' for none")


def _campaign(parser: argparse.ArgumentParser) -> None:
    _common(parser)
    default = HammerTest()
    parser.add_argument("--postures", type=int, default=3, help="how many: the paper's three, then drawn (default 3)")
    parser.add_argument(
        "--posture", action="append", default=[], metavar="NAME=Q1,Q2,Q3", help="degrees; replaces --postures"
    )
    parser.add_argument("--brakes", choices=("on", "off", "unknown"), default="off", help="(default off, as the paper)")
    parser.add_argument(
        "--no-sag", action="store_true", help="springs referenced so that the posture is the equilibrium"
    )
    parser.add_argument("--start-hz", type=float, default=default.start_hz)
    parser.add_argument("--spacing-hz", type=float, default=default.spacing_hz, help="record length is its inverse")
    parser.add_argument("--lines", type=int, default=default.lines)
    parser.add_argument("--averages", type=int, default=default.averages)
    parser.add_argument("--noise", type=float, default=default.noise, help="sensor noise, m/s²/√Hz (default 3e-5)")
    parser.add_argument(
        "--scatter", type=float, default=default.scatter, help="relative spread of one hit (default 0.005)"
    )
    parser.add_argument(
        "--coherence",
        choices=("expected", "estimated"),
        default=default.coherence,
        help="from the noise level, or scattered as an analyser estimates it from the averages",
    )
    parser.add_argument("--peak-n", type=float, default=default.peak_n, help="hammer's peak force (default 300)")
    parser.add_argument("--force-levels", type=float, nargs="+", default=[], metavar="N", help="one group per level")
    parser.add_argument(
        "--spread", type=float, default=0.0, help="the hits averaged differ in force by this share (±; default 0)"
    )
    parser.add_argument(
        "--window", type=float, help="exponential window left in the FRFs, 1/s (default none; levels: 5/T)"
    )
    parser.add_argument("--hits", type=int, default=0, help="write raw hits, this many per point")
    parser.add_argument("--double-hits", type=float, default=0.0, help="share of raw hits that bounce")
    parser.set_defaults(run=campaign)


def _log(parser: argparse.ArgumentParser) -> None:
    _common(parser)
    default = Log()
    parser.add_argument("--runs", type=int, default=1, help="random Fourier motions (default 1)")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of a run (default 60)")
    parser.add_argument("--dwells", type=int, default=0, help="standstills of one second in a run")
    parser.add_argument("--positions", type=Path, help="CSV (time,q1..qn) or HDF5 (runs/*/time, position) to follow")
    parser.add_argument("--rate-hz", type=float, default=default.rate_hz)
    parser.add_argument("--white", type=float, default=default.white, help="torque noise, N·m (default 10)")
    parser.add_argument("--coloured", type=float, default=default.coloured, help="coloured part, N·m (default 5)")
    parser.add_argument("--ripple", type=float, default=default.ripple, help="low-order ripple as a nuisance, N·m")
    parser.add_argument(
        "--counts", type=int, default=default.counts, help="encoder counts per motor turn (default 4096)"
    )
    parser.add_argument("--friction", choices=("coulomb", "lugre", "slip"), default=default.friction)
    parser.add_argument("--compensator", choices=("series", "gas"), default=default.compensator)
    parser.add_argument("--link-encoder", action="store_true", help="record link_position; the gears are elastic")
    parser.set_defaults(run=log)


def _setting(options: argparse.Namespace) -> tuple[Chain, Tolerances, Path]:
    chain = kr90()
    if options.hinges == 1:
        stiffness = chain.stiffness.copy()
        stiffness[:, 1:] = np.inf
        chain = replace(chain, stiffness=stiffness)
    tolerances = Tolerances.none() if options.nominal else Tolerances()
    return chain, tolerances, options.answer or options.out.with_suffix(".truth.json")


def campaign(options: argparse.Namespace) -> None:
    chain, tolerances, answer = _setting(options)
    brakes = None if options.brakes == "unknown" else options.brakes
    postures = tuple(_posture(text, chain.n) for text in options.posture)
    postures = postures or draw_postures(options.postures, streams(options.seed)[1], chain)
    postures = tuple(replace(p, brakes=brakes) for p in postures)
    test = HammerTest(
        options.start_hz, options.spacing_hz, options.lines, options.averages, options.noise, options.scatter,
        options.coherence, options.peak_n, levels_n=tuple(options.force_levels), window=options.window,
        spread=options.spread, hits=options.hits, double_hits=options.double_hits,
    )  # fmt: skip
    effects = tuple(parse(text) for text in options.effect)
    truth = draw_truth(options.seed, effects, postures, tolerances, chain=chain, sag=not options.no_sag)
    check(truth, test)
    write_campaign(
        options.out, truth, postures, test, streams(options.seed)[3], robot=options.robot or None, answer=answer
    )


def _posture(text: str, n: int) -> Posture:
    name, _, angles = text.partition("=")
    try:
        q = tuple(float(x) for x in angles.split(","))
    except ValueError:
        q = ()
    if not name or len(q) != n:
        raise TruthError(f"--posture {text!r}: expected NAME=Q1,…,Q{n} in degrees")
    return Posture(name, q)


def log(options: argparse.Namespace) -> None:
    chain, tolerances, answer = _setting(options)
    effects = tuple(parse(text) for text in options.effect)
    truth = draw_truth(options.seed, effects, (), tolerances, chain=chain, log=True)
    settings = Log(
        options.rate_hz, options.white, options.coloured, ripple=options.ripple, counts=options.counts,
        friction=options.friction, compensator=options.compensator, link_encoder=options.link_encoder,
    )  # fmt: skip
    motions, start, runs = streams(options.seed)[4], 0.0, []
    if options.positions:
        given = []
        for name, time, q in read_positions(options.positions):
            if q.shape[1] != chain.n or len(time) < 6 or np.any(np.diff(time) <= 0):
                raise TruthError(f"{options.positions}: {name}: expected rising time and {chain.n} columns of angles")
            given.append((name, time - time[0], sampled(time - time[0], q)))
        moves = [(name, float(time[-1]), trajectory) for name, time, trajectory in given]
    else:
        moves = [
            (f"run{i + 1}", options.seconds, draw_fourier(chain, motions, options.seconds, options.dwells))
            for i in range(options.runs)
        ]
    for name, length, trajectory in moves:
        time = np.arange(int(length * options.rate_hz)) / options.rate_hz
        runs.append(Run(name, trajectory, time, start))
        start += length + 5.0
    write_log(
        options.out, truth, tuple(runs), settings, streams(options.seed)[3], robot=options.robot or None, answer=answer
    )


def list_effects(_: argparse.Namespace) -> None:
    shown = {
        "frf": "hammer tests",
        "levels": "hammer tests over force levels",
        "chain": "measurement chain",
        "log": "motion logs",
        "both": "hammer tests and motion logs",
    }
    for kind, spec in EFFECTS.items():
        print(f"{kind}@{spec.site}  [{shown[spec.shows]}]")
        for name, (low, high) in spec.ranges.items():
            print(f"    {name}: " + (f"±{high / 10:g} to ±{high:g}" if low < 0 else f"{low:g} to {high:g}"))
        if spec.optional:
            print(f"    may be given: {', '.join(spec.optional)}")


if __name__ == "__main__":
    sys.exit(main())
