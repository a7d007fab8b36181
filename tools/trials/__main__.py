"""Trials with concealed physics: `python -m tools.trials make | run | score | prove`."""

import argparse
import json
import os
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from tools.trials import ask, make, score, store
from tools.trials.report import page

DEVELOPMENT_SEED = 20
EXAMPLES = """
  make    record the cases of a split and seal the answers
  run     put every recording to `twin diagnose`
  score   open the answers, write the page
  prove   all three

Every step goes on where it was interrupted. The development split has a fixed seed; the seed of a sealed split is drawn
in secret, and every opening of its answers is entered in its ledger with the hash of the engine that was judged.

  python -m tools.trials prove --split development --cases 60
  python -m tools.trials prove --split sealed --cases 240 --page docs/proof.md
  python -m tools.trials run --split sealed --scheduler tcp://HOST:8786     # pip install distributed; shared folder
"""


@contextmanager
def executor(processes: int, scheduler: str | None) -> Iterator[Executor]:
    """Processes of this machine, or a Dask cluster, behind one interface."""
    if scheduler is None:
        with ProcessPoolExecutor(processes) as pool:
            yield pool
        return
    from distributed import Client

    with Client(scheduler) as client:
        yield client.get_executor()


def every(title: str, pool: Executor, function: Any, jobs: list[tuple[Any, ...]]) -> list[Any]:
    """Results of function(*job) in the order of the jobs, with progress; a failed job stops all but loses nothing."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bars:
        task = bars.add_task(title, total=len(jobs))
        futures = {pool.submit(function, *job): k for k, job in enumerate(jobs)}
        found: list[Any] = [None] * len(jobs)
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            bars.advance(task)
    return found


def main(arguments: list[str] | None = None) -> None:
    shape = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="python -m tools.trials", description=__doc__, epilog=EXAMPLES, formatter_class=shape
    )
    parser.add_argument("step", choices=("make", "run", "score", "prove"))
    parser.add_argument(
        "--out", type=Path, default=Path("out/trials"), help="folder of the splits (default %(default)s)"
    )
    parser.add_argument("--split", default="development", help="development, or any name for a sealed one")
    parser.add_argument("--cases", type=int, default=240)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scheduler", help="address of a Dask scheduler that sees the same folder")
    parser.add_argument("--page", type=Path, help="Markdown page to write (default: in the split's folder)")
    options = parser.parse_args(arguments)
    split = (options.out / options.split).resolve()
    if options.step in ("make", "run", "prove"):
        with executor(options.processes, options.scheduler) as pool:
            if options.step != "run":
                seed = DEVELOPMENT_SEED if options.split == "development" else None
                jobs = [(split, *case) for case in make.prepare(split, options.cases, seed)]
                lines = every("record", pool, make.record, jobs)
                store.write(split / "manifest.json", {"format": "twin-trials", "version": 1, "cases": lines})
            if options.step != "make":
                cases = store.read(split / "manifest.json")["cases"]
                todo = [
                    (split, c["id"], c["without"])
                    for c in cases
                    if not (split / "results" / f"{c['id']}.json").exists()
                ]
                every("diagnose", pool, ask.ask, todo)
    if options.step in ("score", "prove"):
        _score(split, options.page or split / "proof.md")


def _score(split: Path, target: Path) -> None:
    manifest = store.read(split / "manifest.json")["cases"]
    results = {c["id"]: store.read(split / "results" / f"{c['id']}.json") for c in manifest
               if (split / "results" / f"{c['id']}.json").exists()}  # fmt: skip
    if not results:
        sys.exit(f"{split}: no results yet; run first")
    ledger = store.opened(split, f"score of {len(results)} cases")
    for c in manifest:
        if store.sha256(split / "answers" / f"{c['id']}.json") != c["answer"]:
            sys.exit(f"{split}: the answer of {c['id']} is not the one that was sealed")
    cases = [
        score.scored(store.read(split / "answers" / f"{c['id']}.json"), results[c["id"]])
        for c in manifest
        if c["id"] in results
    ]
    without = {c["id"]: c["without"] for c in manifest}
    target.parent.mkdir(parents=True, exist_ok=True)
    page(target, f"Proof: {split.name} split", cases, results, split, without, ledger)
    for name, value in score.headline(cases).items():
        print(f"{name:40s} {value:.3g}" if isinstance(value, float) else f"{name:40s} {value}")
    store.write(split / "scores.json", json.loads(json.dumps(score.headline(cases), default=str)))
    print(f"wrote {target}")


if __name__ == "__main__":
    main()
