"""The lowest modes in motion, as a GIF that any viewer plays."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from twin.files import replacing
from twin.model.modes import Modes
from twin.report.figures import mode_shapes
from twin.robot.mechanism import Mechanism

FRAMES, FRAME_MS = 16, 80  # of one period, whatever the mode's frequency
DPI = 75


def write_movie(path: str | Path, mechanism: Mechanism, modes: Modes) -> None:
    """Write one period of the modes that :func:`twin.report.figures.mode_shapes` draws; it repeats without end."""
    limits = [(ax.get_xlim(), ax.get_ylim()) for ax in mode_shapes(mechanism, modes).axes]
    frames = []
    for phase in 2 * np.pi * np.arange(FRAMES) / FRAMES:
        figure = mode_shapes(mechanism, modes, phase=float(phase))
        for ax, (x, y) in zip(figure.axes, limits, strict=True):
            ax.set(xlim=x, ylim=y)
        figure.dpi = DPI
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(128))
    with replacing(path) as scratch:
        frames[0].save(scratch, "GIF", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0)
