"""WAV: channels ``channel.1`` … in full scale (±1) for whole numbers, as they stand for floating point."""

import warnings
from pathlib import Path

import numpy as np
import scipy.io.wavfile

from twin.importing.tables import Channel, Table


def read(path: Path) -> list[Table]:
    """One table; a map's ``factor`` says how many N or m/s² full scale is."""
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Reached EOF", scipy.io.wavfile.WavFileWarning)  # the file is cut short
        rate, data = scipy.io.wavfile.read(path)
    scale = 1.0 if data.dtype.kind == "f" else float(np.iinfo(data.dtype).max) + 1
    offset = scale / 2 if data.dtype.kind == "u" else 0.0  # 8 bits are unsigned about their middle
    values = (np.asarray(data, dtype=float) - offset) / (scale - offset)
    values = values.reshape(len(values), -1)
    channels = {f"channel.{i + 1}": Channel(column) for i, column in enumerate(values.T)}
    return [Table(path.stem, channels, float(rate))]
