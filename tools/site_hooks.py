"""What mkdocs does to every page: names without the roles of docstrings, nothing from elsewhere, usable by keyboard."""

import re
from collections.abc import Iterator
from typing import Any

from mkdocs.utils import get_relative_url

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


def on_page_content(html: str, **_: Any) -> str:
    """Classes named as Sphinx does are shown by the name alone; what scrolls can be reached by keyboard."""
    html = re.sub(r":(?:class|func|meth|attr|mod):(?=<code>)", "", html)
    html = html.replace("<pre>", '<pre tabindex="0">')
    html = re.sub(r"<h1.*?</h1>", lambda title: _breakable(title[0]), html, flags=re.DOTALL)
    return re.sub(r"<table>.*?</table>", _table, html, flags=re.DOTALL)


def _breakable(html: str) -> str:
    """Long names may break after their underscores and bars."""
    return re.sub(r"(?<=[a-z0-9][_@])(?=[a-z])(?![^<]*>)|(?<=[A-Z]\|)(?=[A-Z])(?![^<]*>)", "<wbr>", html)


def _table(found: re.Match[str]) -> str:
    """A table scrolls where it must, and its long names may break before that."""
    table = _breakable(found[0])
    return f'<div class="md-typeset__scrollwrap" tabindex="0"><div class="md-typeset__table">{table}</div></div>'


def _whole(output: str, shim: str) -> str:
    output = output.replace(SHIM, shim).replace('role="dialog"', 'role="dialog" aria-label="Search"')
    return re.sub(r'(<input class="md-toggle"[^>]*id="__(\w+)")', r'\1 aria-label="\2"', output)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """The copy takes the script's place; what the theme leaves without a name gets one."""
    return _whole(output, get_relative_url("assets/iframe-worker.js", page.url))


def on_post_template(output: str, template_name: str, **_: Any) -> str:
    """The page for what is not found stands alone: the theme's asks the server's root for its style."""
    return NOT_FOUND if template_name == "404.html" else output
