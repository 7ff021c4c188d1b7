"""The beam condensed to the points where something acts on it or looks at it."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .beam import Array, Beam, kink


@dataclass(frozen=True)
class Points:
    """Places on the needle that hold for all beams of a run.

    forces: where tissue and extra points act, image: where deflections are wanted, hinges [m]; clamp_compliance
    [rad/(N m)]; free_shapes: stress-free shapes (y, x) of a needle by place and length [m]; axes: the axes computed.
    """

    forces: Array
    image: Array
    hinges: list[float]
    clamp_compliance: float
    free_shapes: list[Callable[[Array, float], Array]]
    length: float
    axes: list[int]


class Condensed:
    """Flexibilities of one beam between the points, guide 2 (the last of the forces) and the image."""

    def __init__(self, beam: Beam, points: Points, z_guide: float) -> None:
        z_all = np.append(points.forces, z_guide)
        count = len(points.hinges)
        self.beam = beam
        self.rows = beam.rows(z_all)
        flexible = self.rows @ beam.inverse
        full = flexible @ self.rows.T
        self.ff, self.fg, self.gg = full[:-1, :-1], full[:-1, -1], full[-1, -1]
        self.image = beam.rows(points.image)
        self.image_full = self.image @ beam.inverse @ self.rows.T
        turns: list[Array] = []
        for z0 in points.hinges:
            if z0 < 1e-9:  # the clamp itself turns
                turns.append(beam.inverse[:, 1] / max(points.clamp_compliance, 1e-9))
            else:
                turns.append(beam.unloaded(beam.nodal(partial(kink, bend=z0))))
        bent = [np.zeros(2 * len(beam.nodes)) for _ in range(2)]
        for shape in points.free_shapes:
            for a in range(2):
                bent[a] = bent[a] + beam.unloaded(beam.nodal(partial(row, shape, points.length, a)))
        self.turn = np.array([self.rows @ t for t in turns]).reshape(count, len(z_all))
        self.turn_image = np.array([self.image @ t for t in turns]).reshape(count, len(points.image))
        self.bent = np.array([self.rows @ b for b in bent])[points.axes]
        self.bent_image = np.array([self.image @ b for b in bent])[points.axes]
        self.lever = np.array([np.maximum(z_all - z0, 0.0) for z0 in points.hinges]).reshape(count, len(z_all))
        self.nodal_turn = turns


def row(shape: Callable[[Array, float], Array], length: float, axis: int, z: Array) -> Array:
    """One row of a shape."""
    return shape(z, length)[axis]


def blend(ladder: list[Condensed], loads: Array, tension: float, nearest: int) -> Condensed:
    """Flexibilities at a tension between two computed ones (piecewise linear)."""
    x = np.interp(tension, -loads, np.arange(len(loads)))
    low = min(int(x), len(loads) - 2)
    fraction = x - low
    out = copy.copy(ladder[nearest])
    for name in ["ff", "fg", "gg", "image_full", "turn", "turn_image", "bent", "bent_image"]:
        setattr(out, name, (1 - fraction) * getattr(ladder[low], name) + fraction * getattr(ladder[low + 1], name))
    return out
