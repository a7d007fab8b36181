"""One self-contained HTML page from titled sections: text, tables, figures, curves one can zoom. Nothing is loaded."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader
from PIL import Image

from twin.files import writing
from twin.result import Table


@dataclass(frozen=True)
class Panel:
    """Curves that are drawn together: ``x`` (n,) increasing; name → (n,), what was measured first."""

    x: np.ndarray
    curves: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Plot:
    """Curves that a reader can zoom, drawn where the page may run scripts.

    Attributes:
        caption: what it shows.
        x_label, y_label: with units.
        panels: name of a channel or joint → its curves; one is shown at a time.
        log: logarithmic ordinate.
    """

    caption: str
    x_label: str
    y_label: str
    panels: Mapping[str, Panel]
    log: bool = False

    def data(self) -> dict[str, Any]:
        """Plain data for the page's script, to four digits; panels share abscissae, each told by its index."""
        axes = list({id(panel.x): panel.x for panel in self.panels.values()}.values())
        index = {id(x): k for k, x in enumerate(axes)}
        panels = [
            {"x": index[id(panel.x)], "curves": [{"name": name, "y": _rounded(y)} for name, y in panel.curves.items()]}
            for panel in self.panels.values()
        ]
        x = [_rounded(axis, 6) for axis in axes]
        return {"x_label": self.x_label, "y_label": self.y_label, "log": self.log, "x": x, "panels": panels}


@dataclass(frozen=True)
class Section:
    """A part of the page: text, warnings, tables, curves, then figures: what they show, and the PNG to be inlined."""

    title: str
    text: Sequence[str] = ()
    warnings: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[tuple[str, Path]] = ()
    plots: Sequence[Plot] = ()


def pick(drawn: Mapping[str, Path], ending: str, caption: str) -> list[tuple[str, Path]]:
    """The figures whose file name ends so, with what they show; ``{}`` in the caption is what the name begins with."""
    return [
        (caption.format(name.removesuffix(ending).strip("-_")), path)
        for name, path in drawn.items()
        if name.endswith(ending)
    ]


def write_html(path: str | Path, title: str, lead: str, sections: Sequence[Section], footer: str = "") -> None:
    """Write the page; it appears whole or not at all. Sections without content are left out."""
    shown = [s for s in sections if s.text or s.warnings or s.tables or s.figures or s.plots]
    script = files("twin.report").joinpath("plot.js").read_text("utf-8") if any(s.plots for s in shown) else ""
    page = _environment().get_template("page.html")
    with writing(path) as stream:
        stream.write(page.render(title=title, lead=lead, sections=shown, footer=footer, script=script))


def fragment(lead: str, tables: Sequence[Table]) -> str:
    """A sentence and tables as HTML inside another page, such as a notebook."""
    return _environment().get_template("fragment.html").render(lead=lead, tables=tables)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("twin.report", "templates"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["inlined"] = _inlined
    environment.filters["as_script"] = _as_script
    return environment


def _inlined(image: Path) -> str:
    """A picture of lines and text with a palette of 64 colours: a fifth of the size, the same to the eye."""
    with Image.open(image) as picture, BytesIO() as stream:
        few = picture.convert("RGB").quantize(64, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(stream, "PNG", optimize=True)
        return base64.b64encode(stream.getvalue()).decode("ascii")


def _as_script(data: dict[str, Any]) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def _rounded(values: np.ndarray, digits: int = 4) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in np.asarray(values, float)]
