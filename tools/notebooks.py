"""The tutorials as notebooks: `python -m tools.notebooks` makes `docs/notebooks/*.ipynb` from `docs/tutorial-*.md`.

The page is the source; a test says when a notebook is out of date, and runs it.
"""

import re
from pathlib import Path

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

DOCS = Path(__file__).parents[1] / "docs"
FOLDER = DOCS / "notebooks"
PAGES = tuple(sorted(path.stem for path in DOCS.glob("tutorial-*.md")))
KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}


def notebook(page: str) -> str:
    """The notebook of a page, as its file holds it: text and Python blocks in their order, shell lines after a `!`."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    text = re.sub(r"^\[This page as a notebook\].*\n\n", "", text, flags=re.MULTILINE)
    cells = []
    for part in re.split(r"^(```(?:python|bash)\n.*?^```)$", text, flags=re.MULTILINE | re.DOTALL):
        code = re.fullmatch(r"```(python|bash)\n(.*?)\n```", part, flags=re.DOTALL)
        if code:
            lines = code[2] if code[1] == "python" else "\n".join(f"!{line}" for line in code[2].splitlines())
            cells.append(new_code_cell(lines))
        elif part.strip():
            cells.append(new_markdown_cell(re.sub(r"\]\((?!http|#)", "](../", part.strip())))
    for number, cell in enumerate(cells):
        cell["id"] = f"{page}-{number}"
    return str(nbformat.writes(new_notebook(cells=cells, metadata={"kernelspec": KERNEL}))) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in PAGES:
        (FOLDER / f"{name}.ipynb").write_text(notebook(name), encoding="utf-8")
