"""Runs, their motion program, and what is recorded of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from .beam import Array

STEP_S = 0.05
SWEEP_AFTER_S = 0.9
SWEEP_S = 1.5


@dataclass
class Hold:
    """A hold of guide 2: from, to [s], and its level [m]."""

    start: float
    end: float
    level: float


@dataclass
class Run:
    """One lateral run.

    index: place in the order of measurement, from 0; axis: 0 for y, 1 for x; depth: what the session states [m];
    passes: deepest depth reached in earlier runs [m], one entry per earlier run; clock: start since the session's [s].
    """

    name: str
    index: int
    axis: int
    depth: float
    repeat: int
    passes: list[float]
    clock: float
    levels: tuple[float, ...]
    sweeps: tuple[int, ...]
    hold_s: float = 3.0
    speed: float = 1e-3
    rate_hz: float = 100.0
    holds: list[Hold] = field(default_factory=list)
    time: Array = field(default_factory=lambda: np.zeros(0))
    command: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        knots_t, knots_g = [0.0], [self.levels[0]]
        t, g = 0.0, self.levels[0]
        for level in self.levels:
            ramp = round(abs(level - g) / self.speed / STEP_S) * STEP_S
            if ramp > 0.0:
                t += ramp
                knots_t.append(t)
                knots_g.append(level)
            self.holds.append(Hold(t, t + self.hold_s, level))
            t += self.hold_s
            knots_t.append(t)
            knots_g.append(level)
            g = level
        grid = [np.arange(0.0, t, STEP_S)]
        for hold in self.holds:  # coarser where a hold has settled
            settled = hold.start + 6 * STEP_S
            grid[0] = grid[0][(grid[0] < settled + 1e-9) | (grid[0] > hold.end - 1e-9)]
            grid.append(np.arange(settled + 4 * STEP_S, hold.end - STEP_S, 4 * STEP_S))
        self.time = np.unique(np.round(np.append(np.concatenate(grid), t), 6))
        self.command = np.interp(self.time, knots_t, knots_g)


@dataclass
class Sweep:
    """One shape: times [s], stated positions [m] and deflections (2, points) [m]; hold: index of its hold."""

    hold: int
    time: Array
    z: Array
    deflection: Array


@dataclass
class Readings:
    """What the channels of one run read without noise.

    time [s], displacement and force of shape (2, samples) [m, N]; sweeps: per sweep the times, stated positions z and
    deflections (2, points) [s, m, m].
    """

    run: Run
    time: Array
    displacement: Array
    force: Array
    sweeps: list[Sweep]


@dataclass
class Motion:
    """The true motion of one run: on the grid `time`, guide displacement and force (2, T), deflections (2, T, P)
    at the positions z (P), relative displacement and tissue forces at the Gauss points (2, T, n)."""

    run: Run
    time: Array
    guide: Array
    force: Array
    z: Array
    deflection: Array
    s: Array
    relative: Array
    tissue: Array
    energy: Array

    def look(self, time: Array, z: Array) -> Array:
        """Deflections (2, points) at times and positions, straight on beyond the computed positions."""
        steps = np.interp(time, self.time, np.arange(len(self.time)))
        low = np.minimum(steps.astype(int), len(self.time) - 2)
        fraction = steps - low
        first = int(low.min())
        spline = CubicSpline(self.z, self.deflection[:, first : int(low.max()) + 2], axis=2, bc_type="natural")
        inside = np.clip(z, self.z[0], self.z[-1])
        curves = spline(inside) + spline(inside, 1) * (z - inside)
        points = np.arange(len(z))
        return (1 - fraction) * curves[:, low - first, points] + fraction * curves[:, low - first + 1, points]
