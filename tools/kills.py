"""`python -m tools.kills --kills 500 --out out/kills`: every command is killed at random moments, over an earlier run.

What is there afterwards must be the earlier run, whole, or the new one, whole. Half of the kills fall between the start
and the end, the other half into the time after the first file is written. Kills are counted in ``kills.jsonl`` and gone
on with.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import sys
import time
from collections import Counter
from importlib import import_module
from pathlib import Path

from tools.fuzz import seeds
from tools.fuzz.__main__ import WARM
from tools.fuzz.run import MEMORY, inside
from twin.commands.outputs import LISTED

FILES = {"view": "found.rrd", "import": "found.h5"}
LINES = {
    "simulate": ("posture.yaml",),
    "view": ("two.yaml",),
    "modal": ("hammer.h5",),
    "compare": ("hammer.h5", "--as-is"),
    "fit": ("modes.yaml", "--starts", "1"),
    "identify": ("log.h5",),
    "excite": ("--robot", "two.yaml", "--count", "1", "--harmonics", "1"),
    "lobes": ("two.yaml", "--cut", "cut.yaml", "--draws", "0"),
    "map": ("cut.yaml", "--robot", "two.yaml", "--random", "3", "--processes", "1"),
    "describe": ("arm.urdf",),
    "import": ("foreign.csv", "--map", "csv-map.yaml"),
    "example": ("cell",),
    "diagnose": ("modes.yaml",),
}
OLD = b"of the earlier run"
USERS = "notes.txt"  # a file of the user's, in the output folder
Tree = dict[str, str]


def tree(path: Path) -> Tree:
    """Digest of every file; a file alone has its own name."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file.relative_to(path.parent)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def begin(command: str, folder: Path) -> int:
    """Process id of a command started in a folder."""
    child = os.fork()
    if child == 0:
        inside([command, *LINES[command], "-o", FILES.get(command, "found")], folder, MEMORY)
    return child


def earlier(folder: Path, command: str, names: set[str]) -> Tree:
    """Write what an earlier run left, and a file of the user's; returns its digests."""
    found = folder / FILES.get(command, "found")
    if command in FILES:
        found.write_bytes(OLD)
        return tree(found)
    made = [*sorted(name.partition("/")[2] for name in names if LISTED not in name), "gone.csv"]
    for name in made:
        (found / name).parent.mkdir(parents=True, exist_ok=True)
        (found / name).write_bytes(OLD)
    (found / f"{LISTED}{command}").write_text("\n".join(made))
    (found / USERS).write_text("mine")
    return tree(found)


def reference(command: str, folder: Path) -> tuple[Tree, Tree, float]:
    """What two runs of a command leave, and how long one takes, s."""
    trees = []
    for _ in range(2):
        start = time.monotonic()
        _, status = os.waitpid(begin(command, folder), 0)
        seconds = time.monotonic() - start
        if status:
            raise SystemExit(f"{command}: {(folder / '.err').read_text()}")
        found = folder / FILES.get(command, "found")
        trees.append(tree(found))
        shutil.rmtree(found) if found.is_dir() else found.unlink()
    return trees[0], trees[1], seconds


def whole(now: Tree, first: Tree, second: Tree) -> bool:
    """Whether a tree is that of a run: the same files, and the same content where two runs agree on it."""
    return now.keys() == first.keys() and all(now[name] == first[name] or first[name] != second[name] for name in now)


def kill(command: str, folder: Path, runs: tuple[Tree, Tree, float], rng: random.Random) -> tuple[str, float]:
    """Kill a command once; returns what is there (old, new or a fault) and the moment, s."""
    first, second, seconds = runs
    found = folder / FILES.get(command, "found")
    old = earlier(folder, command, set(first))
    known = set(folder.iterdir())
    child, start = begin(command, folder), time.monotonic()
    if rng.random() < 0.5:
        while not os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) and not (
            {path for path in folder.iterdir() if path.name not in (".out", ".err")} - known
        ):
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.3 * seconds))
    else:
        time.sleep(rng.uniform(0, 1.1 * seconds))
    moment = time.monotonic() - start
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    now = tree(found)
    if USERS in {Path(name).name for name in now}:
        mine = next(name for name in now if Path(name).name == USERS)
        new = {name: digest for name, digest in now.items() if name != mine}
    else:
        new = now
    kind = "old" if now == old else "new" if whole(new, first, second) and (command in FILES or new != now) else "mixed"
    shutil.rmtree(found) if found.is_dir() else found.unlink(missing_ok=True)
    for path in folder.glob(".found*"):  # stages; another run into the folder removes them itself
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return kind, moment


def main(arguments: list[str] | None = None) -> int:
    """Exit code 1 where something is half-written."""
    parser = argparse.ArgumentParser(prog="tools.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/kills"))
    asked = parser.parse_args(arguments)
    out = asked.out.absolute()
    seeds.make(out / "seeds")
    for name in WARM:
        import_module(name)
    table = out / "kills.jsonl"
    done = [json.loads(line) for line in table.read_text().splitlines()] if table.exists() else []
    runs = {}
    with table.open("a") as stream:
        for number in range(len(done), asked.kills):
            command = list(LINES)[number % len(LINES)]
            folder = out / command
            if command not in runs:
                shutil.rmtree(folder, ignore_errors=True)
                shutil.copytree(out / "seeds", folder)
                runs[command] = reference(command, folder)
            kind, moment = kill(command, folder, runs[command], random.Random(f"{asked.seed}:{number}"))
            done.append({"number": number, "command": command, "left": kind, "moment_s": round(moment, 3)})
            stream.write(json.dumps(done[-1]) + "\n")
            stream.flush()
    print(f"{len(done)} kills: " + ", ".join(f"{n} {kind}" for kind, n in Counter(d["left"] for d in done).items()))
    for bad in (one for one in done if one["left"] == "mixed"):
        print(json.dumps(bad))
    return int(any(one["left"] == "mixed" for one in done))


if __name__ == "__main__":
    sys.exit(main())
