"""Trials with concealed physics: `python -m tools.trials make | run | refer | score | prove | calibrate | real`."""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tools.trials import arms_score, ask, make, real, reference, score, store, wrong, wrong_score
from tools.trials.cases import RECORDINGS, SIZES
from tools.trials.report import page
from twin.diagnose.calibration import calibration
from twin.errors import InputError

DEVELOPMENT_SEED = 20
EXAMPLES = """
  make       record the cases of a split and seal the answers
  run        put every recording to `twin diagnose`
  refer      open the answers, refit the true models of hammer tests: what held-out errors are compared to
  score      open the answers, write the page
  prove      all three
  calibrate  open the answers, print the temperature under which stated probabilities mean what they say
  real       put measured recordings to `twin diagnose`, write their page

With --world wrong the description or the recording of every case is wrong beyond what it says of itself; with --world
regression they are the cases that were once told wrongly. With --world arms they are whole arms of six and seven axes,
as described. What is written by hand in the folder of a page's name (reading.md, before.md) is taken into the page.

Every step goes on where it was interrupted; a result of another version of the engine is asked for again. The
development split has a fixed seed; the seed of a sealed split is drawn in secret, and its making and every opening of
its answers are entered in its ledger with the hash of the engine.

  python -m tools.trials prove --split development --cases 60
  python -m tools.trials prove --split sealed --cases 240 --page docs/proof.md
  python -m tools.trials prove --split sealed --cases 240 --minutes 70      # report on what was done by then
  python -m tools.trials prove --split small --recordings hammer levels --each 6 --sizes 2 6   # every effect six times
  python -m tools.trials run --split sealed --scheduler tcp://HOST:8786  # needs twin[distributed]
  python -m tools.trials prove --world wrong --split sealed-wrong --cases 240 --page docs/proof-wrong.md
  python -m tools.trials real recordings.yaml --page docs/proof-real.md     # see tools/trials/real.py
"""


@contextmanager
def executor(processes: int, scheduler: str | None) -> Iterator[Executor]:
    """Processes of this machine, or a Dask cluster, behind one interface."""
    if scheduler is None:
        with ProcessPoolExecutor(processes) as pool:
            yield pool
        return
    try:
        from distributed import Client
    except ImportError:
        sys.exit('--scheduler: expected Dask; pip install "twin[distributed]"')
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        sys.exit(f"--scheduler {scheduler}: expected the address of a running Dask scheduler ({error})")
    with client:
        yield client.get_executor(pure=False)


def every(title: str, pool: Executor, function: Any, jobs: list[tuple[Any, ...]]) -> list[Any]:
    """Results of function(*job) in the order of the jobs, with progress; a failed job stops all but loses nothing."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bars:
        task = bars.add_task(title, total=len(jobs))
        futures = {pool.submit(function, *job): k for k, job in enumerate(jobs)}
        found: list[Any] = [None] * len(jobs)
        try:
            for future in as_completed(futures):
                found[futures[future]] = future.result()
                bars.advance(task)
        except BaseException:
            for future in futures:
                future.cancel()
            raise
    return found


def _positive(kind: type[int] | type[float]) -> Callable[[str], float]:
    """A number above zero, for the parser."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = kind()
        if not 0 < value < float("inf"):
            raise argparse.ArgumentTypeError(f"expected a number above 0, found {text!r}")
        return value

    return parse


def main(arguments: list[str] | None = None) -> None:
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m tools.trials", description=__doc__, epilog=EXAMPLES, formatter_class=shape
    )
    parser.add_argument("step", choices=("make", "run", "refer", "score", "prove", "calibrate", "real"))
    parser.add_argument("recordings", nargs="?", type=Path, help="list of measured recordings, for `real`")
    parser.add_argument("--out", type=Path, help="folder of the splits (default out/trials)")
    parser.add_argument("--split", default="development", help="development, or any name for a sealed one")
    parser.add_argument(
        "--world", choices=("described", "wrong", "regression", "arms"), default="described", help="for `make`"
    )
    parser.add_argument("--cases", type=_positive(int), default=240)
    parser.add_argument(
        "--each", type=_positive(int), help="every effect so often alone, others in proportion, instead of --cases"
    )
    parser.add_argument("--recordings", dest="kinds", nargs="+", choices=tuple(RECORDINGS), default=tuple(RECORDINGS))
    parser.add_argument(
        "--sizes",
        nargs=2,
        type=_positive(float),
        default=SIZES,
        metavar=("LEAST", "LARGEST"),
        help="multiples of the smallest visible size (default %(default)s)",
    )
    parser.add_argument("--processes", type=_positive(int), default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="address of a Dask scheduler that sees the same folder")
    parser.add_argument("--minutes", type=_positive(float), help="begin no diagnosis later than this after the start")
    parser.add_argument(
        "--limit", type=_positive(float), default=ask.LIMIT_S, help="seconds per case (default %(default)g)"
    )
    parser.add_argument("--page", type=Path, help="Markdown page to write (default: in the split's folder)")
    options = parser.parse_args(arguments)
    if options.sizes[0] > options.sizes[1]:
        parser.error("--sizes: expected the smaller first")
    if (options.step == "real") != (options.recordings is not None):
        parser.error("expected a list of recordings after `real`, and after nothing else")
    try:
        if options.step == "real":
            target = options.page or Path("proof-real.md")
            store.write_text(target, real.page(real.asked(options.recordings, options.limit)))
            print(f"wrote {target}")
            return
    except InputError as error:
        parser.exit(2, f"{error}\n")
    deadline = None if options.minutes is None else time.time() + 60 * options.minutes
    split = ((options.out or Path("out/trials")) / options.split).resolve()
    if options.step not in ("make", "prove") and not (split / "manifest.json").exists():
        parser.exit(2, f"{split}: no split of this name has been made; make it first, or say where it is by --out\n")
    if options.step in ("make", "run", "prove"):
        with executor(options.processes, options.scheduler) as pool:
            if options.step != "run":
                seed = DEVELOPMENT_SEED if "development" in options.split else None
                if options.world != "described":
                    _make_wrong(split, pool, options.cases, seed, options.world)
                else:
                    _make(split, pool, options.cases, seed, options.kinds, options.each or 0, tuple(options.sizes))
            if options.step != "make":
                _run(split, options.limit, deadline, pool)
    if options.step == "refer":
        with executor(options.processes, options.scheduler) as pool:
            _refer(split, pool)
    if options.step == "calibrate":
        _calibrate(split)
    if options.step in ("score", "prove"):
        _score(split, options.page or split / "proof.md")


def _make(split: Path, pool: Executor, *drawn: Any) -> None:
    """Record what `make.prepare` draws."""
    new = not (split / "answers" / "plan.json").exists()
    jobs = [(split, *case) for case in make.prepare(split, *drawn)]
    if new:
        store.entered(split, f"{len(jobs)} cases drawn")
    else:
        print(f"{split}: the {len(jobs)} cases drawn before stay; another --split for others", file=sys.stderr)
    lines = every("record", pool, make.record, jobs)
    store.write(
        split / "manifest.json", {"format": "twin-trials", "version": 2, "sizes": list(jobs[0][-1]), "cases": lines}
    )


def _make_wrong(split: Path, pool: Executor, count: int, seed: int | None, world: str) -> None:
    """Record what `wrong.prepare` draws."""
    new = not (split / "answers" / "plan.json").exists()
    jobs = [(split, *case) for case in wrong.prepare(split, count, seed, world)]
    if new:
        store.entered(split, f"{len(jobs)} cases drawn")
    else:
        print(f"{split}: the {len(jobs)} cases drawn before stay; another --split for others", file=sys.stderr)
    lines = every("record", pool, wrong.make, jobs)
    store.write(split / "manifest.json", {"format": "twin-trials", "version": 2, "world": world, "cases": lines})


def _run(split: Path, limit_s: float, deadline: float | None, pool: Executor) -> None:
    if not (split / "manifest.json").exists():
        sys.exit(f"{split}: no cases yet; make first")
    engine = store.engine_hash()

    def missing(name: str) -> bool:
        path = split / "results" / f"{name}.json"
        return not path.exists() or store.read(path)["engine"] != engine

    todo = [c for c in store.read(split / "manifest.json")["cases"] if missing(c["id"])]
    # The slow first, so that no process is left with one at the end; where time may run out, in the order of the
    # names, which know nothing of the cases.
    todo.sort(key=lambda c: (-len(c["files"]), *sorted(c["files"])) if deadline is None else (c["id"],))
    asked = every(
        "diagnose", pool, ask.ask, [(split, c["id"], c["without"], limit_s, deadline, c.get("robot")) for c in todo]
    )
    if not all(asked):
        print(f"time is up: {sum(not a for a in asked)} cases not asked; the same command goes on", file=sys.stderr)


def _refer(split: Path, pool: Executor) -> None:
    cases, *_ = _opened(split, "refer")
    every("refer", pool, reference.refer, [(split, c.name) for c in cases if c.recording in ("hammer", "levels")])


def _opened(split: Path, why: str) -> tuple[list[score.Scored], dict[str, Any], dict[str, Any], Any]:
    """Answers beside results: cases, results by id, manifest, ledger. Enters the opening into the ledger."""
    results, manifest, ledger = _unsealed(split, why)
    cases = [
        score.scored(_answer(split, name), result, reference.kept(split, name)) for name, result in results.items()
    ]
    return cases, results, manifest, ledger


def _answer(split: Path, name: str) -> Any:
    return store.read(split / "answers" / f"{name}.json")


def _unsealed(split: Path, why: str) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Results by id, manifest, ledger, after a check that nothing was changed since the split was made."""
    if not (split / "manifest.json").exists():
        sys.exit(f"{split}: no cases yet; make first")
    manifest = store.read(split / "manifest.json")
    results = {c["id"]: store.read(split / "results" / f"{c['id']}.json") for c in manifest["cases"]
               if (split / "results" / f"{c['id']}.json").exists()}  # fmt: skip
    engine = store.engine_hash()
    if any(r["engine"] == engine for r in results.values()):  # what an older one said is not this one's
        results = {name: r for name, r in results.items() if r["engine"] == engine}
    if not results:
        sys.exit(f"{split}: no results yet; run first")
    for c in manifest["cases"]:
        if store.sha256(split / "answers" / f"{c['id']}.json") != c["answer"]:
            sys.exit(f"{split}: the answer of {c['id']} is not the one that was sealed")
        if "description" in c and store.sha256(split / c["robot"]) != c["description"]:
            sys.exit(f"{split}: {c['robot']} is not the one that was sealed")
        for name, digest in c["files"].items():
            if store.sha256(split / "recordings" / c["id"] / name) != digest:
                sys.exit(f"{split}: recordings/{c['id']}/{name} is not the one that was sealed")
    ledger = store.entered(split, f"answers opened: {why} of {len(results)} cases")
    return results, manifest, ledger


def _score(split: Path, target: Path) -> None:
    if store.read(split / "manifest.json").get("world"):
        _score_wrong(split, target)
        return
    cases, results, manifest, ledger = _opened(split, "score")
    without = {c["id"]: c["without"] for c in manifest["cases"]}
    target.parent.mkdir(parents=True, exist_ok=True)
    page(target, cases, results, split, without, ledger, manifest)
    for name, value in score.headline(cases).items():
        print(f"{name:40s} {value:.3g}" if isinstance(value, float) else f"{name:40s} {value}")
    store.write(split / "scores.json", json.loads(json.dumps(score.headline(cases), default=str)))
    print(f"wrote {target}")


def _score_wrong(split: Path, target: Path) -> None:
    """The page about wrong descriptions and recordings, or about whole arms."""
    results, manifest, ledger = _unsealed(split, "score")
    cases = [wrong_score.judged(_answer(split, name), result) for name, result in results.items()]
    store.write_text(split / "cases.md", "\n".join(wrong_score.every(cases)) + "\n")
    arms = manifest["world"] == "arms"
    text, scores = (arms_score.page, arms_score.headline) if arms else (wrong_score.page, wrong_score.headline)
    store.write_text(target, text(target, cases, len(manifest["cases"]), results, ledger))
    for name, value in scores(cases).items():
        print(f"{name:52s} {value:.3g}" if isinstance(value, float) else f"{name:52s} {value}")
    print(f"wrote {target}")


def _calibrate(split: Path) -> None:
    cases, *_ = _opened(split, "calibrate")
    factor, losses, errors = score.temperature(cases)
    now = calibration()["temperature"]
    print(f"{len(cases)} cases; temperature of twin/diagnose/calibration.yaml: {now:g} → {now * factor:.2f}")
    print(f"log score {losses[0]:.3f} → {losses[1]:.3f}, calibration error {errors[0]:.3f} → {errors[1]:.3f}")


if __name__ == "__main__":
    main()
