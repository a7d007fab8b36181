"""``twin modal --operational`` on records of known modes: eight modes from 2 to 70 Hz, white forces and forces of wind.

    python -m tools.study_operational [--first 100] [--count 10]

Each mode is a recursion of one complex pole, independent of the estimator. Forces on eight points are white, or fade
with frequency and push the low modes more, so that the lowest is a thousand times as strong as the highest.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from twin.measure.modal import ModalResult
from twin.measure.operational import Running, identify_running
from twin.measure.shapes import mac

RATE, SECONDS, SENSORS, MODES = 200.0, 180, 8, 8
BAND, DAMPING = (2.0, 70.0), (0.004, 0.02)
BEFORE = 6000  # samples until the start is forgotten
NOISE = 1e-3  # of a response's deviation
FADING = {"white": 0.0, "wind": 0.99}
ALIKE, COVER = 0.9, 1.645


@dataclass
class Count:
    """What was asked and found; of the found, whose shapes are alike, and whose deviations hold."""

    modes: int = 0
    found: int = 0
    wrong: int = 0
    alike: int = 0
    frequency_held: int = 0
    damping_held: int = 0
    seconds: list[float] = field(default_factory=list)

    def add(self, result: ModalResult, frequency: np.ndarray, damping: np.ndarray, shapes: np.ndarray) -> None:
        """Give every mode of the truth to one that is within four deviations or a bandwidth."""
        self.modes += frequency.size
        free = set(range(frequency.size))
        for mode in result.modes:
            n = int(np.argmin(np.abs(frequency - mode.frequency_hz) / frequency))
            apart = abs(frequency[n] - mode.frequency_hz)
            if n not in free or apart > max(4 * mode.frequency_std_hz, 2 * damping[n] * frequency[n]):
                self.wrong += 1
                continue
            free.remove(n)
            self.found += 1
            self.alike += bool(mac(mode.response_shape[None], shapes[n : n + 1].astype(complex))[0, 0] > ALIKE)
            self.frequency_held += bool(apart < COVER * mode.frequency_std_hz)
            self.damping_held += bool(abs(100 * damping[n] - mode.damping_percent) < COVER * mode.damping_std_percent)

    def __str__(self) -> str:
        share = [f"{100 * n / max(self.found, 1):.0f} %" for n in (self.alike, self.frequency_held, self.damping_held)]
        return (
            f"{self.found} of {self.modes} modes, {self.wrong} wrong; shapes alike {share[0]}, "
            f"frequency held {share[1]}, damping held {share[2]}; {np.median(self.seconds):.1f} s of CPU in the median"
        )


def record(seed: int, fading: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies in Hz, damping ratios, shapes (nm, nr) and responses (nr, nt)."""
    rng = np.random.default_rng(seed)
    frequency = np.sort(np.exp(rng.uniform(*np.log(BAND), MODES)))
    damping = np.exp(rng.uniform(*np.log(DAMPING), MODES))
    shapes = rng.normal(size=(MODES, SENSORS))
    noise = rng.normal(size=(SENSORS, int(RATE * SECONDS) + BEFORE))
    force = shapes @ lfilter([1], [1, -fading], noise)
    pole = 2 * np.pi * frequency * (-damping + 1j * np.sqrt(1 - damping**2))
    answers = [np.imag(lfilter([1], [1, -np.exp(p / RATE)], f))[BEFORE:] for p, f in zip(pole, force, strict=True)]
    modal = np.array(answers) / (frequency[:, None] if fading else 1)
    y = shapes.T @ modal
    return frequency, damping, shapes, y + NOISE * y.std(axis=1, keepdims=True) * rng.normal(size=y.shape)


def study(seeds: range) -> Iterator[tuple[str, Count]]:
    """The kinds of force, and what became of their records."""
    for kind, fading in FADING.items():
        count = Count()
        for seed in seeds:
            frequency, damping, shapes, y = record(seed, fading)
            start = time.process_time()
            result = identify_running(kind, Running(np.zeros(0), y, RATE), tuple("abcdefgh"))
            count.seconds.append(time.process_time() - start)
            count.add(result, frequency, damping, shapes)
        yield kind, count


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--count", type=int, default=10)
    asked = parser.parse_args()
    for kind, count in study(range(asked.first, asked.first + asked.count)):
        print(f"{kind}: {count}")
