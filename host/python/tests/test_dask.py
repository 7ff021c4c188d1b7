"""The program on the page of Dask, on a cluster of this machine; needs Dask (`pip install 'dask[distributed]'`)."""

from __future__ import annotations

import pathlib
import re
import shutil
import subprocess
import sys

import pytest

from needle_guide import Session, summarize

pytest.importorskip("dask.distributed")

PAGE = pathlib.Path(__file__).parents[2] / "manual" / "src" / "dask.md"


def test_the_program_of_the_page_summarizes_every_session(example: Session, tmp_path: pathlib.Path) -> None:
    block = re.search(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert block is not None
    program = tmp_path / "many.py"
    program.write_text(block[1], encoding="utf-8")
    sessions = tmp_path / "sessions"
    shutil.copytree(example.path, sessions / "b")
    (sessions / "a").mkdir()
    (sessions / "a" / "session.toml").write_text("[session]\n", encoding="utf-8")
    run = subprocess.run(
        [sys.executable, program, "sessions"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    failed, found, mean = run.stdout.splitlines()
    assert failed.startswith("sessions/a ") and "session.format: missing" in failed
    own = summarize(sessions / "b")
    assert found == f"sessions/b {own.k_kpa}"
    assert mean.startswith("1 sessions, mean K")
