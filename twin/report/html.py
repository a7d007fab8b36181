"""One self-contained HTML page from titled sections: text, tables, figures. Nothing is loaded from elsewhere."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment

from twin.files import writing
from twin.result import Table

_TABLE = """{% macro draw(table) %}{% if table.title %}<p><b>{{ table.title }}</b></p>
{% endif %}<table><thead><tr>{% for head in table.header %}<th
{%- if loop.index0 in table.numbers %} class="number"{% endif %}>{{ head }}</th>{% endfor %}</tr></thead><tbody>
{% for row in table.rows %}<tr{% if loop.index0 in table.dim %} class="dim"{% endif %}>{% for cell in row %}<td
{%- if loop.index0 in table.numbers %} class="number"{% endif %}>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</tbody></table>
{% endmacro %}"""

_PAGE = (
    _TABLE
    + """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; color: #1c2733; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; }
.lead { color: #51606f; margin-top: 0; } img { max-width: 100%; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6rem 0; }
th, td { padding: .15rem .8rem .15rem 0; text-align: left; border-bottom: 1px solid #e3e7eb; }
td.number, th.number { text-align: right; } tr.dim td { color: #8a96a3; }
li.warning { color: #a33b00; } footer { color: #8a96a3; margin-top: 3rem; font-size: .85rem; }
</style></head><body>
<h1>{{ title }}</h1><p class="lead">{{ lead }}</p>
{% for section in sections %}<section><h2>{{ section.title }}</h2>
{% for text in section.text %}<p>{{ text }}</p>
{% endfor %}{% if section.warnings %}<ul>
{% for text in section.warnings %}<li class="warning">{{ text }}</li>
{% endfor %}</ul>{% endif %}
{% for table in section.tables %}{{ draw(table) }}{% endfor %}{% for image in section.images %}<p>
<img alt="{{ image.alt }}" src="data:image/png;base64,{{ image.data }}"></p>
{% endfor %}</section>
{% endfor %}<footer>{{ footer }}</footer></body></html>
"""
)

_FRAGMENT = (
    _TABLE
    + """<style>.twin td.number, .twin th.number { text-align: right; } .twin tr.dim td { opacity: .55; }</style>
<div class="twin"><p>{{ lead }}</p>
{% for table in tables %}{{ draw(table) }}{% endfor %}</div>
"""
)


@dataclass(frozen=True)
class Section:
    """A part of the page: paragraphs, warnings, tables, then figures: what they show, and the PNG to be inlined."""

    title: str
    text: Sequence[str] = ()
    warnings: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[tuple[str, Path]] = ()


def write_html(path: str | Path, title: str, lead: str, sections: Sequence[Section], footer: str = "") -> None:
    """Write the page; it appears whole or not at all."""
    content = [
        {
            "title": section.title, "text": section.text, "warnings": section.warnings, "tables": section.tables,
            "images": [{"alt": alt, "data": _inlined(image)} for alt, image in section.figures],
        }
        for section in sections
    ]  # fmt: skip
    page = Environment(autoescape=True).from_string(_PAGE)
    with writing(path) as stream:
        stream.write(page.render(title=title, lead=lead, sections=content, footer=footer))


def fragment(lead: str, tables: Sequence[Table]) -> str:
    """A sentence and tables as HTML inside another page, such as a notebook."""
    return Environment(autoescape=True).from_string(_FRAGMENT).render(lead=lead, tables=tables)


def _inlined(image: Path) -> str:
    return base64.b64encode(image.read_bytes()).decode("ascii")
