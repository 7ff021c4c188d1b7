"""The device: a fake one at the far end of a pseudo terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from needle_guide import SAMPLE, Device, DeviceError, FileError, UsageError

Start = Callable[[int], "subprocess.Popen[str]"]


def port(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def executed(process: subprocess.Popen[str]) -> str:
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return process.stdout.readline()


def test_a_device_is_operated(fake_device: Start, guide: str) -> None:
    process = fake_device(0)
    name = port(process)
    with Device.open(name) as device:
        status = device.status()
        assert status["schema"] == "guide.status/1" and status["state"] == "idle"
        blocks: list[np.ndarray] = []
        moved = device.move(y_mm=1.2, progress=blocks.append)
        assert moved["schema"] == "guide.move/1"
        assert sum(map(len, blocks)) == 32 and blocks[0].dtype == SAMPLE
        assert (np.diff(np.concatenate(blocks)["time_s"]) > 0).all()
        samples = device.run("displace")
        assert len(samples) == 32 and (samples["step"] == 0).all()
        assert device.stop()["schema"] == "guide.stop/1"
        with pytest.raises(UsageError, match="speed"):
            device.move(y_mm=1.0, speed_mm_s=-1.0)
        with pytest.raises(FileError, match="built-in program"):
            device.run("no-such-program")
    assert "Move" in executed(process)
    with pytest.raises(DeviceError, match="closed"):
        device.status()


def test_a_device_that_is_not_there_is_an_error() -> None:
    with pytest.raises(DeviceError, match="/dev/none"):
        Device.open("/dev/none")


def test_an_interrupt_stops_the_guide_before_the_call_ends(fake_device: Start) -> None:
    process = fake_device(60)
    code = (
        "import os, signal, sys\n"
        "from needle_guide import Device\n"
        "device = Device.open(sys.argv[1])\n"
        "try:\n"
        "    device.run('displace', progress=lambda block: os.kill(os.getpid(), signal.SIGINT))\n"
        "    print('done')\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', device.status()['schema'])\n"
        "os._exit(0)\n"
    )
    run = subprocess.run([sys.executable, "-c", code, port(process)], capture_output=True, text=True, check=True)
    assert run.stdout == "interrupted guide.status/1\n", run.stderr
    assert "Stop" in executed(process)


def test_the_device_stops_when_the_interpreter_is_killed(fake_device: Start) -> None:
    process = fake_device(60)
    name = port(process)
    code = (
        "import sys\n"
        "from needle_guide import Device\n"
        "Device.open(sys.argv[1]).run('displace', progress=lambda block: print('moving', flush=True))\n"
    )
    child = subprocess.Popen([sys.executable, "-c", code, name], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "moving\n"
    os.kill(child.pid, signal.SIGKILL)
    child.communicate()
    # Looking at it is a command too: longer pauses than its limit of silence, in which it has to stop by itself.
    status: dict[str, Any] = {}
    for _ in range(10):
        time.sleep(2.0)
        with Device.open(name) as device:
            status = device.status()
        if status["state"] == "faulted":
            break
    assert status["state"] == "faulted" and "host" in status["fault"]
