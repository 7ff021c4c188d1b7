"""Sessions and devices that tests share."""

from __future__ import annotations

import os
import pathlib
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from needle_guide import Session

# A shell's job in the background ignores Ctrl-C, and so would every program that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def example(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """The example of `guide init --example`, in a folder of its own."""
    path = tmp_path_factory.mktemp("sessions") / "example"
    made = Session.example()
    shutil.copytree(made.path, path)
    return Session.open(path)


@pytest.fixture(scope="session")
def guide() -> str:
    """The program that the wheel has installed."""
    return str(pathlib.Path(sys.executable).parent / "guide")


@pytest.fixture
def fake_device() -> Iterator[Callable[[int], subprocess.Popen[str]]]:
    """Starts fake devices, whose program holds for so many seconds; the first line of their output is the port."""
    program = os.environ.get("NEEDLE_GUIDE_FAKE_DEVICE")
    if program is None:
        pytest.skip("NEEDLE_GUIDE_FAKE_DEVICE is not set: cargo xtask wheel builds the program and sets it")
    started: list[subprocess.Popen[str]] = []

    def start(seconds: int) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [program, str(seconds)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.communicate(timeout=60)
