"""One self-contained HTML page from titled sections: text, tables, figures, curves and maps. Nothing is loaded."""

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup, escape
from PIL import Image

from twin.files import writing
from twin.table import Table

SHORT = 22  # letters: a name that paper has room for
SMALL = 700  # pixels: legible at half of a page's width


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
class Grid:
    """One map: a colour per cell.

    Attributes:
        rows: (nr,) names.
        edges: (nc + 1,) of the columns, increasing.
        values: (nr, nc), above zero; NaN where nothing was used.
        x_label, y_label: with units.
        columns: (nc,) names, where the columns are no ranges of numbers; the edges then count them.
    """

    rows: Sequence[str]
    edges: np.ndarray
    values: np.ndarray
    x_label: str
    y_label: str
    columns: Sequence[str] | None = None


@dataclass(frozen=True)
class Map:
    """Maps that a reader can zoom, in one scale of colours.

    Attributes:
        caption: what it shows.
        y_label: what the colour says.
        panels: name → map; one is shown at a time.
        range: values of the first and the last colour, on a logarithmic scale.
        colours: as ``#rrggbb``.
    """

    caption: str
    y_label: str
    panels: Mapping[str, Grid]
    range: tuple[float, float]
    colours: Sequence[str]

    def data(self) -> dict[str, Any]:
        """Plain data for the page's script, to three digits; every panel's edges are told by its index."""
        x = [_rounded(grid.edges, 6) for grid in self.panels.values()]
        panels = [
            {
                "x": k, "rows": list(grid.rows), "x_label": grid.x_label,
                "columns": None if grid.columns is None else list(grid.columns), "y_label": grid.y_label,
                "values": [_rounded(row, 3) for row in grid.values],
            }
            for k, grid in enumerate(self.panels.values())
        ]  # fmt: skip
        colours, ends = list(self.colours), list(self.range)
        return {"y_label": self.y_label, "range": ends, "colours": colours, "x": x, "panels": panels}


@dataclass(frozen=True)
class Section:
    """A part of the page: text, warnings, tables, curves and maps, then figures: what they show, and the PNG."""

    title: str
    text: Sequence[str] = ()
    warnings: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[tuple[str, Path]] = ()
    plots: Sequence[Plot | Map] = ()


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
    environment.filters["wide"] = _wide
    environment.filters["small"] = _small
    environment.filters["as_script"] = _as_script
    environment.filters["breakable"] = _breakable
    environment.filters["told"] = _told
    return environment


def _inlined(image: Path) -> str:
    """A picture of lines and text with a palette of 256 colours: a quarter of the size, the same to the eye."""
    with Image.open(image) as picture, BytesIO() as stream:
        few = picture.convert("RGB").quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(stream, "PNG", optimize=True)
        return base64.b64encode(stream.getvalue()).decode("ascii")


def _wide(image: Path) -> int:
    """Pixels across, so that paper does not enlarge a small picture."""
    with Image.open(image) as picture:
        return picture.width


def _small(image: Path) -> bool:
    """Two of this size stand beside each other."""
    return _wide(image) < SMALL


def _breakable(cell: object) -> Markup:
    """A name may break after its underscores, dots and at-signs, not inside a word; a short one only where narrow."""
    place = "<wbr>" if len(str(cell)) > SHORT else '<wbr class="narrow">'
    return Markup(re.sub(r"(?<=[a-z0-9\]][_.@])(?=[a-z])", place, str(_told(cell))))


def _told(text: object) -> Markup:
    """A percent sign stays with its number, a space before it; an option stays whole."""
    bound = re.sub(r"(?<=\d) ?%", "\u00a0%", str(escape(text)))
    return Markup(re.sub(r"(?<!\S)--[a-z-]+", r'<span class="option">\g<0></span>', bound))


def _as_script(data: dict[str, Any]) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")


def _rounded(values: np.ndarray, digits: int = 4) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in np.asarray(values, float)]
