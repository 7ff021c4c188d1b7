"""The pages of the manual do what they state."""

from __future__ import annotations

import doctest
import pathlib
import re

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


def test_the_picture_of_the_page_is_the_one_of_the_example() -> None:
    drawn = Session.example().identify(profile=True).plot("d40-1.shape")["d40-1.shape"]
    assert drawn == (MANUAL / "pictures" / "d40-1.shape.svg").read_text(encoding="utf-8")
