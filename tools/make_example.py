"""Makes twin/examples/cell: what `twin example` writes. A robot cell of the truth code, one fault concealed.

Five postures struck at eight points, FRFs and raw hits, and a log of two runs of the same robot. Records are rounded to
what a 16-bit card resolves and compressed, so that the wheel stays small.

    python -m tools.make_example [--out twin/examples/cell]
"""

import argparse
import json
from pathlib import Path

import h5py
import numpy as np

from tools.truth.chain import kr90
from tools.truth.effects import Effect, parse
from tools.truth.motion import Log, Run, draw_fourier, write_log
from tools.truth.recording import HAMMER, HammerTest, draw_postures, draw_truth, plain, streams, write_campaign

SEED = 11
FAULT = "base_compliance@base.rx"
STRUCK = ("1X+", "4Y+", "6Y+", "9Z-", "12X-", "16Y-", "21Y+", "21Z+")
TEST = HammerTest(start_hz=5.0, spacing_hz=0.25, lines=160, hits=3, hit_rate_hz=256.0)
RUNS, RUN_S = 2, 30.0
STEP = {"force": 0.05, "response": 2e-4, "position": 1e-7, "torque": 0.1}  # N, m/s², rad, N·m
FOLDER = Path(__file__).parents[1] / "twin" / "examples" / "cell"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=FOLDER)
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    fault = parse(FAULT)
    make_campaign(out / "campaign.h5", fault)
    make_log(out / "log.h5")


def make_campaign(path: Path, fault: Effect) -> None:
    """FRFs and raw hits in five postures; what was concealed goes into answer.json beside them."""
    postures = draw_postures(5, streams(SEED)[1])
    hammer = tuple(channel for channel in HAMMER if channel.label in STRUCK)
    truth = draw_truth(SEED, (fault,), postures, hammer=hammer)
    write_campaign(path, truth, postures, TEST, streams(SEED)[3])
    _shrink(path)
    answer = {"concealed": plain([{"effect": e.kind, "site": e.site, **e.parameters} for e in truth.effects])}
    path.with_name("answer.json").write_text(json.dumps(answer, indent=2) + "\n")


def make_log(path: Path) -> None:
    """Two Fourier motions of the same robot, which a foundation that tilts does not change."""
    chain, random = kr90(), streams(SEED)[4]
    time = np.arange(int(RUN_S * Log.rate_hz)) / Log.rate_hz
    runs = tuple(
        Run(f"run{i + 1}", draw_fourier(chain, random, RUN_S, 0), time, i * (RUN_S + 5.0)) for i in range(RUNS)
    )
    write_log(path, draw_truth(SEED, (), (), log=True), runs, Log(), streams(SEED)[3])
    _shrink(path)


def _shrink(path: Path) -> None:
    """The same file with records rounded and compressed, and without the room of what was removed."""
    small = path.with_name(path.name + ".part")
    with h5py.File(path) as old, h5py.File(small, "w") as new:
        new.attrs.update(old.attrs)

        def copy(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Group):
                made = new.require_group(name)
            elif (step := STEP.get(name.rpartition("/")[2])) and name.count("/") > 1:
                kind = "f4" if item.dtype == "f4" else "f8"
                made = new.create_dataset(
                    name, data=(np.rint(item[()] / step) * step).astype(kind), compression="gzip", shuffle=True
                )
            else:
                made = new.create_dataset(name, data=item[()], dtype=item.dtype)
            made.attrs.update(item.attrs)

        old.visititems(copy)
    small.replace(path)


if __name__ == "__main__":
    main()
