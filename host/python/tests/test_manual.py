"""The pages of the manual do what they state."""

from __future__ import annotations

import copy
import doctest
import pathlib
import re
from typing import Any

import pytest

from needle_guide import Session

MANUAL = pathlib.Path(__file__).parents[2] / "manual" / "src"


def test_the_examples_of_the_page_give_what_is_printed() -> None:
    page = "python.md"
    text = (MANUAL / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    examples = doctest.DocTestParser().get_doctest("\n".join(blocks), {}, page, str(MANUAL / page), 0)
    assert len(examples.examples) >= 3
    failed, _ = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL).run(examples)
    assert failed == 0


@pytest.mark.parametrize("path", sorted(MANUAL.glob("notebooks/*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_gives_what_it_shows(path: pathlib.Path) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("matplotlib")
    shown = nbformat.read(path, as_version=4)
    cells = [cell for cell in shown.cells if cell.cell_type == "code"]
    assert cells and all(cell.outputs for cell in cells[-1:])
    again = copy.deepcopy(shown)
    nbclient.NotebookClient(again, kernel_name="python3", timeout=300).execute()

    def outputs(cell: Any) -> list[tuple[str, Any]]:
        # Pixels are those of a version of matplotlib.
        shown = [(one.output_type, one.get("data", one.get("text"))) for one in cell.outputs]
        return [
            (kind, sorted(data) if isinstance(data, dict) and "image/png" in data else data) for kind, data in shown
        ]

    for cell, run in zip(cells, (cell for cell in again.cells if cell.cell_type == "code"), strict=True):
        assert outputs(cell) == outputs(run), cell.source


def test_the_picture_of_the_page_is_the_one_of_the_example() -> None:
    drawn = Session.example().identify(profile=True).plot("d40-1.shape")["d40-1.shape"]
    assert drawn == (MANUAL / "pictures" / "d40-1.shape.svg").read_text(encoding="utf-8")
