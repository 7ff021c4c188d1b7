"""Processes that are forked, spawned or started by a fork server, after calls in the parent."""

from __future__ import annotations

import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

from needle_guide import Session

METHODS = ["fork", "spawn", "forkserver"]
MANUAL = pathlib.Path(__file__).parents[2] / "manual" / "src"

AFTER_A_CALL = """
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

from needle_guide import Session, forward, population, summarize


def main() -> None:
    path, method = sys.argv[1:]
    # All that starts threads in the parent.
    Session(path).identify()
    here = summarize(path)
    forward.force_n(k_kpa=12.0, depth_mm=30.0)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
        there = list(pool.map(summarize, [path]))
        modulus = pool.submit(Session(path).identify).result().k_kpa
    assert there[0].to_json() == here.to_json()
    assert modulus == Session(path).identify().k_kpa
    assert population(there).groups[0].sessions == 1


if __name__ == "__main__":
    main()
"""


def run(script: pathlib.Path, *arguments: str, cwd: pathlib.Path) -> str:
    """Runs a script that would otherwise hang for ever, and returns what it prints."""
    done = subprocess.run(
        [sys.executable, str(script), *arguments], cwd=cwd, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("method", METHODS)
def test_a_child_computes_what_its_parent_does(method: str, example: Session, tmp_path: pathlib.Path) -> None:
    script = tmp_path / "after_a_call.py"
    script.write_text(AFTER_A_CALL, encoding="utf-8")
    run(script, str(example.path), method, cwd=tmp_path)


@pytest.mark.parametrize("method", METHODS)
def test_the_pool_of_the_page_runs(method: str, example: Session, tmp_path: pathlib.Path) -> None:
    page = (MANUAL / "python.md").read_text(encoding="utf-8")
    (pool,) = (block for block in re.findall(r"```text\n(.*?)```", page, re.DOTALL) if "ProcessPoolExecutor" in block)
    shutil.copytree(example.path, tmp_path / "sessions" / "a")
    stated = tmp_path / "sessions" / "a" / "session.toml"
    text = stated.read_text(encoding="utf-8")
    table = "[tissue]\nid = 'gel'\n"
    text = text.replace("[tissue]\n", table, 1) if "[tissue]" in text else f"{text}\n{table}"
    stated.write_text(text, encoding="utf-8")
    script = tmp_path / "pool.py"
    # As in a program that has computed before it starts processes.
    before = f"import multiprocessing\n\nfrom needle_guide import Session\n\nif __name__ == '__main__':\n    \
multiprocessing.set_start_method({method!r})\n    Session('sessions/a').identify()\n\n"
    script.write_text(before + pool, encoding="utf-8")
    assert "sessions=1" in run(script, cwd=tmp_path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_child_that_is_forked_during_a_computation_says_so(example: Session, tmp_path: pathlib.Path) -> None:
    script = tmp_path / "torn.py"
    script.write_text(
        """
import os, sys, threading
from needle_guide import Session, UsageError, forward

path = sys.argv[1]
forward.force_n(k_kpa=12.0, depth_mm=30.0)
begun = threading.Event()
thread = threading.Thread(target=lambda: Session(path).diagnose(on_step=lambda step: begun.set()))
thread.start()
begun.wait()
child = os.fork()
if child == 0:
    try:
        forward.force_n(k_kpa=12.0, depth_mm=30.0)
    except UsageError as error:
        os._exit(0 if "forked while another thread" in str(error) else 1)
    os._exit(2)
_, status = os.waitpid(child, 0)
thread.join()
assert os.waitstatus_to_exitcode(status) == 0, status
""",
        encoding="utf-8",
    )
    run(script, str(example.path), cwd=tmp_path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_forked_child_leaves_the_folder_of_its_parent() -> None:
    session = Session.example()
    child = os.fork()
    if child == 0:
        del session
        os._exit(0)
    os.waitpid(child, 0)
    assert (session.path / "session.toml").is_file()
