"""The tissue: points where it acts on the needle, maps between displacement and force, and a body that slides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .beam import Array
from .runs import Run

GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)


def gauss_points(depth: float, breaks: list[float], cell: float) -> tuple[Array, Array]:
    """Depths and weights [m] of a composite two-point Gauss rule on [0, depth] with cell edges at the breaks."""
    marks = sorted({0.0, depth, *[b for b in breaks if 1e-4 < b < depth - 1e-4]})
    points: list[float] = []
    weights: list[float] = []
    for left, right in zip(marks[:-1], marks[1:]):
        count = max(1, int(np.ceil((right - left) / cell - 1e-9)))
        edges = np.linspace(left, right, count + 1)
        for a, b in zip(edges[:-1], edges[1:]):
            points.extend((0.5 * (a + b) + 0.5 * (b - a) * GAUSS).tolist())
            weights.extend([0.5 * (b - a)] * 2)
    return np.array(points), np.array(weights)


class Stage:
    """An elementwise map with memory: relative displacement to effective displacement, or force to force.

    rate: whether it changes while its argument rests.
    """

    rate = False

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """Start of a run whose Gauss points lie at the depths s."""

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Mapped value and its derivative."""
        raise NotImplementedError

    def commit(self, value: Array, dt: float) -> None:
        """Accept the argument of the finished step."""


class Pointwise(Stage):
    """A map without memory, given by function and derivative of (value, depth, run)."""

    def __init__(self, function: Callable[[Array, Array, Run], tuple[Array, Array]]) -> None:
        self.function = function

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """Keep the run and its depths."""
        self.run, self.s = run, s

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Value and derivative of the function."""
        return self.function(value, self.s, self.run)


class SlipBody:
    """The tissue as a whole slides against its tray; displacement per axis [m]."""

    def __init__(self, threshold_n: float, speed: float, limit: float = np.inf) -> None:
        self.threshold, self.speed, self.limit = threshold_n, speed, limit
        self.value = np.zeros(2)

    def begin(self) -> None:
        """Start of a run: the tissue is put back into its place."""
        self.value = np.zeros(2)

    def commit(self, force: Array, dt: float) -> None:
        """force: of the needle on the tissue, per axis [N]."""
        excess = np.maximum(np.abs(force) / self.threshold - 1.0, 0.0)
        self.value = np.clip(self.value + np.sign(force) * self.speed * excess * dt, -self.limit, self.limit)
