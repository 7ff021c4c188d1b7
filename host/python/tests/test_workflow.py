"""The workflow for many sessions; needs Snakemake (`pip install needle-guide[workflow]`)."""

from __future__ import annotations

import pathlib
import shutil
import subprocess
import sys

import pytest

from needle_guide import Session

pytest.importorskip("snakemake")

SNAKEFILE = pathlib.Path(__file__).parents[1] / "workflow" / "Snakefile"


def run(folder: pathlib.Path, out: str, **options: object) -> subprocess.CompletedProcess[str]:
    values = [f"{name}={value}" for name, value in {"out": out, **options}.items()]
    return subprocess.run(
        [sys.executable, "-m", "snakemake", "--snakefile", SNAKEFILE, "--cores", "2", "--config", *values],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_results_do_not_depend_on_batches_and_order(example: Session, tmp_path: pathlib.Path) -> None:
    sessions = tmp_path / "sessions"
    shutil.copytree(example.path, sessions / "b")
    (sessions / "a").mkdir()
    (sessions / "a" / "session.toml").write_text("[session]\n", encoding="utf-8")
    first = run(tmp_path, "first", sessions="sessions", batch=1)
    assert first.returncode == 0, first.stderr
    table = tmp_path / "table.txt"
    table.write_text("sessions/b\nsessions/a\n", encoding="utf-8")
    second = run(tmp_path, "second", sessions="table.txt", batch=2)
    assert second.returncode == 0, second.stderr
    for name in ("records.jsonl", "population.json", "prior.toml"):
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "second" / name).read_bytes()
    records = (tmp_path / "first" / "records.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(records) == 2 and '"error":null' not in records[0]


def test_a_missing_table_is_an_error_of_one_line(tmp_path: pathlib.Path) -> None:
    failed = run(tmp_path, "out", sessions="none")
    assert failed.returncode != 0
    assert "sessions: none is not there" in failed.stderr
