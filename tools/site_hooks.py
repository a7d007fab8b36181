"""What mkdocs does to every page: formulas are set, nothing comes from elsewhere, all can be used by keyboard."""

import re
from collections.abc import Iterator
from typing import Any

SHIM = "https://unpkg.com/iframe-worker/shim"
"""What the search loads where pages are opened from the disk; a copy is among the site's assets."""

NOT_FOUND = """<!doctype html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>twin: no such page</title>
<style>
:root { color-scheme: light dark }
body { font: 1rem/1.6 sans-serif; max-width: 40rem; margin: 4rem auto; padding: 0 1rem }
a { color: inherit }
</style>
</head>
<body><main><h1>No such page</h1>
<p>It may have moved. The <a href="index.html">first page</a> leads on.</p></main></body>
</html>
"""


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """A link that is called by its file, as readers of the repository know it, bears the page's name here."""
    names = dict(_named(config.nav))
    return re.sub(r"\[([\w-]+\.md)\]\(", lambda link: f"[{names.get(link[1], link[1])}](", markdown)


def _named(nav: Any) -> Iterator[tuple[str, str]]:
    """File and title of every page."""
    for item in nav:
        for title, inside in item.items():
            yield from [(inside, title)] if isinstance(inside, str) else _named(inside)


UNITS = (
    "%|°|Hz|kHz|N·m/rad³?|N·m·s/rad|N·m|N·s|N/m|kN|N|µrad|mrad|rad/s²|rad/s|rad|µm|mm|m/s²|m/s|m|kg·m²|kg|ms|s|min|rpm|"
    "GiB|GB|MB"
)
LONG = 60  # characters of a cell, from which its column must not be a narrow one
CALLED = re.compile(
    r"(<h3[^>]*>(?:(?!</h3>).)*?twin\.)(\w+)((?:(?!</h3>).)*</h3>\s*"
    r"<div class=\"[^\"]*doc-signature(?:(?!</div>).)*?<span class=\"n[cf]\">)\w+(<)",
    re.DOTALL,
)
"""A heading of the reference and its signature: what is called `twin.read_log` has that name in the signature too."""
SHELL = re.compile(r"(?<=language-)text(?= highlight\"><pre>(?:<[^>]*>)*(?:\$ )?(?:twin|pip|python3?|docker|make) )")
"""A block without a language whose first line is a command: it is called a shell's, as blocks are that say so."""
FORMULA = re.compile("[Σ√½∝χσρ]")
LETTER = r"(?:(?<![\w.])[A-Za-zΑ-Ωα-ω]̂?[²³]?|\|²?)"


def on_page_content(html: str, **_: Any) -> str:
    """Classes named as Sphinx does are shown by the name alone; what scrolls can be reached by keyboard."""
    html = re.sub(r":(?:class|func|meth|attr|mod):(?=<code>)", "", html)
    html = "".join(map(_typeset, re.split(r"(<pre.*?</pre>|<code.*?</code>|<[^>]+>)", html, flags=re.DOTALL)))
    html = CALLED.sub(r"\1\2\3\2\4", html)
    html = SHELL.sub("bash", html)
    html = html.replace("<pre>", '<pre tabindex="0">')
    html = re.sub(r"<p>(<img[^>]*>)</p>", r'<p class="picture" tabindex="0">\1</p>', html)
    html = re.sub(r"<h1.*?</h1>", lambda title: _breakable(title[0]), html, flags=re.DOTALL)
    return re.sub(r"<table>.*?</table>", _table, html, flags=re.DOTALL)


def _typeset(part: str) -> str:
    """Indices, powers and units of plain text as they are printed; an option in one piece."""
    if part.startswith("<pre"):
        return _indices(part) if "<span class" not in part and FORMULA.search(part) else part
    if part.startswith("<code"):
        return re.sub(r"(?<![\w-])(?:--|…_)[\w-]+", r'<span class="whole">\g<0></span>', part)
    if part.startswith("<"):
        return part
    part = re.sub(r"(?<![\w.])(\d(?:\.\d+)?)e[+]?([−-]?)0*(\d+)\b", _power, part)
    part = re.sub(r"(?<=\b[α-ω]) (?=\|)|(?<=\|) (?=sgn)|(?<=\bsgn) ", "\u00a0", part)  # μ |τ| sgn q̇
    part = re.sub(r"\[[\d.]+ ?%?, [\d.]+ ?%?\]", r'<span class="whole">\g<0></span>', part)
    part = re.sub(r"(?<![\w-])--[a-z][\w-]*", r'<span class="whole">\g<0></span>', part)
    part = re.sub(r"\be\^(?:\(([^)]*)\)|\{([^}]*)\})", lambda e: f'e<sup class="whole">{e[1] or e[2]}</sup>', part)
    return re.sub(rf"(?<=\d) (?=(?:{UNITS})(?![\w·/]))", "\u00a0", _indices(part))


def _indices(text: str) -> str:
    """F_c, y_{k−1} and χ²_best with their indices below the line."""
    text = re.sub(rf"({LETTER})_(?:([a-zθ]+)|\{{([^}}]+)\}})(?!\w)", lambda x: f"{x[1]}<sub>{x[2] or x[3]}</sub>", text)
    return re.sub(r"\|²<sub>\w+</sub>", r'<span class="whole">\g<0></span>', text)


def _power(number: re.Match[str]) -> str:
    """1e-9 and 6.1e6 as powers of ten."""
    first = "" if number[1] == "1" else f"{number[1]}\u00a0×\u00a0"
    return f"{first}10<sup>{'−' if number[2] else ''}{number[3]}</sup>"


def _breakable(html: str) -> str:
    """Long names may break after their underscores and bars."""
    return re.sub(r"(?<=[a-z0-9][_@])(?=[a-z])(?![^<]*>)|(?<=[A-Z]\|)(?=[A-Z])(?![^<]*>)", "<wbr>", html)


def _table(found: re.Match[str]) -> str:
    """A table scrolls where it must, and its long names may break before that; a column of sentences is wide."""
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL) for row in found[0].split("</tr>")]
    longest = [
        max(len(re.sub("<[^>]*>", "", cell)) for cell in column) for column in zip(*filter(None, rows), strict=False)
    ]
    columns = iter(longest if len(longest) > 3 else [])
    table = re.sub("<th(?=[ >])", lambda head: head[0] + ' class="long"' * (next(columns, 0) > LONG), found[0])
    table = _breakable(table)
    return f'<div class="md-typeset__scrollwrap" tabindex="0"><div class="md-typeset__table">{table}</div></div>'


def _whole(output: str, shim: str) -> str:
    output = output.replace(SHIM, shim).replace('role="dialog"', 'role="dialog" aria-label="Search"')
    return re.sub(r'(<input class="md-toggle"[^>]*id="__(\w+)")', r'\1 aria-label="\2"', output)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """The copy takes the script's place; what the theme leaves without a name gets one."""
    from mkdocs.utils import get_relative_url  # only where the site is built

    return _whole(output, get_relative_url("assets/iframe-worker.js", page.url))


def on_post_template(output: str, template_name: str, **_: Any) -> str:
    """The page for what is not found stands alone: the theme's asks the server's root for its style."""
    return NOT_FOUND if template_name == "404.html" else output
