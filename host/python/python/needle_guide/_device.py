"""The device."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core

SAMPLE = np.dtype(
    [
        ("time_s", "<f8"),
        ("displacement_x_mm", "<f8"),
        ("displacement_y_mm", "<f8"),
        ("force_x_n", "<f8"),
        ("force_y_n", "<f8"),
        ("lost_before", "<u8"),
        ("step", "<i2"),
        ("state", "<u2"),
    ]
)
"""A sample: device time, displacement of guide 2, force relative to the tare, samples lost before it, step of the program (-1 outside
one), and the number of the state in :data:`STATES`."""

STATES: tuple[str, ...] = tuple(_core.Link.states())
"""Names of the device's states."""

Samples = NDArray[np.void]
Progress = Callable[[Samples], object]


def _samples(packed: bytes) -> Samples:
    return np.frombuffer(packed, dtype=SAMPLE)


def _observer(progress: Progress | None) -> Callable[[bytes], object] | None:
    return None if progress is None else lambda packed: progress(_samples(packed))


class Device:
    """A connected device: the firmware on its board, or in QEMU.

    The firmware's interlocks are active as from the command line. While a program runs the host sends a keepalive ten times a
    second; if the interpreter crashes, the device stops by itself after its silence limit. Ctrl-C in a call that moves the guide
    stops the guide before the call ends. One call at a time may use a device.

    Use it in a ``with`` statement, which stops the guide on an exception and closes the port::

        with Device.open("/dev/ttyACM0") as device:
            device.tare()
            samples = device.run("displace")
    """

    def __init__(self, link: _core.Link, port: str) -> None:
        self._link = link
        self.port = port

    @classmethod
    def open(cls, port: str | os.PathLike[str]) -> Device:
        """Connects to the device at a serial port, as ``guide ports`` lists it.

        Raises:
            DeviceError: the port cannot be opened, nothing answers, or the firmware speaks another version.
        """
        name = os.fspath(port)
        return cls(_core.Link(name), name)

    def close(self) -> None:
        """Closes the port. A program that runs is stopped by the device."""
        self._link.close()

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if kind is not None:
                self._link.stop()
        except Exception:  # noqa: BLE001 - the first exception is the one to report
            pass
        finally:
            self.close()

    def status(self) -> dict[str, Any]:
        """State, position, force, faults and load of the device: document of ``guide status``."""
        return _document(self._link.status())

    def home(self, *, speed_mm_s: float = 2.0, nominal: bool = False, progress: Progress | None = None) -> dict[str, Any]:
        """Moves guide 2 to where the needle is straight; as :meth:`move`."""
        return self.move(speed_mm_s=speed_mm_s, nominal=nominal, progress=progress)

    def move(
        self,
        *,
        x_mm: float = 0.0,
        y_mm: float = 0.0,
        speed_mm_s: float = 1.0,
        force_limit_n: float | None = None,
        nominal: bool = False,
        progress: Progress | None = None,
    ) -> dict[str, Any]:
        """Moves guide 2 and waits until it has settled: document of ``guide move``.

        Args:
            x_mm: horizontal position, millimetres from where the needle is straight.
            y_mm: vertical position.
            speed_mm_s: speed along the path, millimetres per second.
            force_limit_n: largest force along either axis, from the tare and from the calibration's zero, newtons; stays set.
            nominal: move by the nominal calibration where the device has none stored.
            progress: called with the samples (:data:`SAMPLE`) as they arrive.

        Raises:
            DeviceError: the device refuses, stops on a fault, or is gone.
            UsageError: position or speed is out of range.
        """
        how = (nominal, force_limit_n)
        return _document(self._link.move_to((x_mm, y_mm), speed_mm_s, how, _observer(progress)))

    def tare(self, *, duration_s: float = 1.0, nominal: bool = False) -> dict[str, Any]:
        """Averages the force for so many seconds and makes that the zero: document of ``guide tare``."""
        return _document(self._link.tare(duration_s, (nominal, None)))

    def run(
        self,
        program: str | os.PathLike[str],
        *,
        force_limit_n: float | None = None,
        nominal: bool = False,
        progress: Progress | None = None,
    ) -> Samples:
        """Runs a motion program and returns its samples (:data:`SAMPLE`).

        Args:
            program: "displace", "staircase", "quick-staircase", or a file.
            force_limit_n: largest force along either axis, from the tare and from the calibration's zero, newtons; stays set.
            nominal: move by the nominal calibration where the device has none stored.
            progress: called with the samples as they arrive.

        Raises:
            FileError: the program cannot be read, or has a step that makes no sense.
            DeviceError: the device refuses, stops on a fault, or is gone.
        """
        return _samples(self._link.run(os.fspath(program), (nominal, force_limit_n), _observer(progress)))

    def stop(self) -> dict[str, Any]:
        """Stops the guide where it is: document of ``guide stop``."""
        return _document(self._link.stop())

    def clear(self) -> dict[str, Any]:
        """Clears a latched fault once its cause is gone: document of ``guide clear``."""
        return _document(self._link.clear())

    def retreat(self) -> dict[str, Any]:
        """Unloads the guide while the fault of the load is latched: document of ``guide retreat``."""
        return _document(self._link.retreat())

    def stream(self, duration_s: float | None = None, *, timeout_s: float = 3.0) -> Iterator[Samples]:
        """Samples as they arrive, block by block, until the duration is over, or for ever.

        Args:
            duration_s: how long, seconds.
            timeout_s: time without a sample after which the device counts as gone, seconds.

        Raises:
            DeviceError: the connection to the device is lost.
        """
        self._link.stream(True)
        try:
            end = None if duration_s is None else time.monotonic() + duration_s
            while end is None or time.monotonic() < end:
                left = timeout_s if end is None else min(timeout_s, max(end - time.monotonic(), 0.05))
                packed = self._link.next_samples(left)
                if packed is not None:
                    yield _samples(packed)
                elif left >= timeout_s:
                    from ._errors import DeviceError

                    raise DeviceError(f"{self.port}: no sample within {timeout_s} s while the device streams")
        finally:
            self._link.stream(False)

    def __repr__(self) -> str:
        return f"Device({self.port!r})"


def _document(text: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    return document
