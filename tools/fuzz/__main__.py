"""`python -m tools.fuzz --cases 5000 --out out/fuzz`: cases not yet in the corpus are run, then all are counted.

Cases are made from a seed and a number; a case is run again by `--only NUMBER`. The corpus is `corpus.jsonl`, a line
for each.
"""

import argparse
import json
import sys
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any

from tools.fuzz import run, seeds

WARM = (
    "twin.commands.simulate", "twin.commands.modal", "twin.commands.fit", "twin.commands.excite",
    "twin.commands.identify", "twin.commands.compare", "twin.commands.diagnose", "twin.commands.lobes",
    "twin.commands.map", "twin.commands.view", "twin.commands.foreign",
    "twin.commands.example", "twin.commands.describe", "twin.measure.uff", "twin.report.figures",
    "twin.report.scene", "twin.report.html", "mujoco", "h5py", "scipy.optimize", "scipy.signal", "typer",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Exit code 1 where a case broke it."""
    parser = argparse.ArgumentParser(prog="tools.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--timeout", type=float, default=run.STOPPED_S, help="of every case; more on a busy machine")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    seeds.make(out / "seeds")
    for name in WARM:
        import_module(name)
    if asked.only is not None:
        print(
            json.dumps(
                run.case(asked.only, asked.seed, out / "seeds", out / "case", stopped=asked.timeout).data(), indent=1
            )
        )
        return 0
    corpus = out / f"corpus-{asked.seed}.jsonl"
    found = [json.loads(line) for line in corpus.read_text().splitlines()] if corpus.exists() else []
    known = {case["number"] for case in found}
    with corpus.open("a") as stream:
        for number in range(asked.first, asked.first + asked.cases):
            if number not in known:
                one = run.case(number, asked.seed, out / "seeds", out / f"case-{asked.first}", stopped=asked.timeout)
                found.append(one.data())
                stream.write(json.dumps(found[-1]) + "\n")
                stream.flush()
    return report(found)


def report(found: list[dict[str, Any]]) -> int:
    """Print counts by command and every fault; returns how the process ends."""
    counts = Counter(case["kind"] for case in found)
    print(f"{len(found)} cases: " + ", ".join(f"{count} {kind}" for kind, count in counts.most_common()))
    for command, count in sorted(Counter(case["command"][0] for case in found).items()):
        print(f"  {command:10s} {count}")
    bad = [case for case in found if case["kind"] not in run.OK]
    for case in bad:
        said = case["said"].strip().splitlines()
        print(f"{case['number']} {case['kind']}: {' '.join(case['command'])[:150]}  [{case['change'][:100]}]")
        print(f"    {said[-1][:200] if said else ''}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
