"""Writes examples/notebook.ipynb, the first part of docs/notebook.md as a notebook.

python docs/write_notebook.py
"""

import json
import re
from pathlib import Path

DOCS = Path(__file__).parent
NOTEBOOK = DOCS.parent / "examples" / "notebook.ipynb"
END = "\n## What a cell shows\n"
FENCED = re.compile(r"```python\n(.*?)```", re.S)
FORMAT = {
    "metadata": {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    },
    "nbformat": 4,
    "nbformat_minor": 5,
}


def parts(text: str) -> list[tuple[str, str]]:
    """The kinds, "markdown" or "code", and the texts of the cells of a page."""
    texts = FENCED.split(text.partition(END)[0])
    cells = (("code" if k % 2 else "markdown", part.strip()) for k, part in enumerate(texts))
    return [cell for cell in cells if cell[1]]


def notebook(text: str) -> str:
    """The page as a notebook, without outputs; links lead to the pages as text."""
    cells = []
    for kind, part in parts(text):
        cell = {"cell_type": kind, "id": f"cell-{len(cells)}", "metadata": {}, "source": part.splitlines(keepends=True)}
        if kind == "code":
            cell |= {"execution_count": None, "outputs": []}
        else:
            cell["source"] = [re.sub(r"\]\(([\w-]+\.md)", r"](../docs/\1", line) for line in cell["source"]]
        cells.append(cell)
    return json.dumps({"cells": cells, **FORMAT}, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    NOTEBOOK.write_text(notebook((DOCS / "notebook.md").read_text(encoding="utf-8")), encoding="utf-8")
