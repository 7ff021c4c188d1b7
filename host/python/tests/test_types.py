"""Types reject what would fail."""

from __future__ import annotations

import pathlib
import subprocess
import sys

import pytest

pytest.importorskip("mypy")

WRONG = {
    "forward.force_n(k_pa=12.0, depth_mm=30.0)": "k_pa",
    "forward.force_n(k_kpa=12.0)": "depth_mm",
    'forward.force_jacobian(["k_pa"], k_kpa=12.0, depth_mm=30.0)': "list-item",
    'session.identify(foundation="spring")': "foundation",
    'population([], groups="tissue")': "groups",
    "population([]).groups[0].spread": "spread",
    "session.identify().runs[0].plot_shape(axes=None)": "axes",
}


def test_misspelt_names_are_rejected(tmp_path: pathlib.Path) -> None:
    head = "from needle_guide import Session, forward, population\n\nsession = Session.example()\n"
    path = tmp_path / "wrong.py"
    path.write_text(head + "\n".join(WRONG) + "\n", encoding="utf-8")
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", str(path)], capture_output=True, text=True, check=False
    )
    for number, (line, name) in enumerate(WRONG.items(), 4):
        errors = [one for one in checked.stdout.splitlines() if f"wrong.py:{number}: error" in one]
        assert any(name in one for one in errors), f"{line}\n{checked.stdout}{checked.stderr}"


def test_what_is_right_is_accepted(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "right.py"
    path.write_text(
        """import numpy as np
from needle_guide import Session, forward, population

force_n = forward.force_n(k_kpa=np.linspace(1.0, 2.0, 3), depth_mm=30.0)
found = population(Session.example().summarize(), by=["tissue"])
for level in found.groups[0].levels:
    tau: float = 0.0 if level.tau is None else level.tau
""",
        encoding="utf-8",
    )
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", str(path)], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
