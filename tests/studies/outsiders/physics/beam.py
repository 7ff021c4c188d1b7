"""The needle: an Euler-Bernoulli beam of cubic Hermite elements, clamped at guide 1 (z = 0) and free at its end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KINK = 4e-3


def second_moment(outer_m: float, inner_m: float) -> float:
    """Second moment of area of a tube [m^4]."""
    return np.pi / 64.0 * (outer_m**4 - inner_m**4)


def hermite(xi: Array, h: Array) -> Array:
    """Cubic Hermite functions on an element of length h at xi in [0, 1]; rows of 4: w1, slope1, w2, slope2."""
    return np.stack(
        [
            1 - 3 * xi**2 + 2 * xi**3,
            h * (xi - 2 * xi**2 + xi**3),
            3 * xi**2 - 2 * xi**3,
            h * (xi**3 - xi**2),
        ],
        axis=-1,
    )


class Beam:
    """Finite-element beam, clamped at z = 0, free at z = length.

    bending(z): bending stiffness [N m^2]; clamp_compliance: rotation of the clamp per moment [rad/(N m)];
    guide_spring: rotational stiffness of guide 2 at guide_m [N m/rad]; axial: compressive load [N] along the whole
    beam; breaks: positions that shall be nodes.
    """

    def __init__(
        self,
        length: float,
        breaks: list[float],
        bending: Callable[[Array], Array],
        clamp_compliance: float = 0.0,
        guide_m: float = 0.0,
        guide_spring: float = 0.0,
        axial: float = 0.0,
        coarse: float = 5e-3,
        fine: float = 2.5e-3,
        fine_from: float = 0.0,
    ) -> None:
        marks = sorted({0.0, length, *[b for b in breaks if 0.0 < b < length]})
        nodes = [0.0]
        for left, right in zip(marks[:-1], marks[1:]):
            size = fine if left >= fine_from - 1e-9 else coarse
            count = max(1, int(np.ceil((right - left) / size - 1e-9)))
            nodes.extend((left + (right - left) * np.arange(1, count + 1) / count).tolist())
        self.nodes = np.array(nodes)
        n = 2 * len(nodes)
        bend = np.zeros((n, n))
        geometric = np.zeros((n, n))
        for i, (a, b) in enumerate(zip(self.nodes[:-1], self.nodes[1:])):
            h = b - a
            dof = slice(2 * i, 2 * i + 4)
            for g in np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]):
                weight = (5 / 9 if g != 0.0 else 8 / 9) * h / 2
                x = (g + 1) / 2
                curvature = np.array([-6 + 12 * x, h * (-4 + 6 * x), 6 - 12 * x, h * (6 * x - 2)]) / h**2
                slope = (
                    np.array([-6 * x + 6 * x**2, h * (1 - 4 * x + 3 * x**2), 6 * x - 6 * x**2, h * (3 * x**2 - 2 * x)])
                    / h
                )
                ei = float(bending(np.array([a + x * h]))[0])
                bend[dof, dof] += weight * ei * np.outer(curvature, curvature)
                geometric[dof, dof] += weight * np.outer(slope, slope)
        self.bend = bend
        self.geometric = geometric
        total = bend - axial * geometric
        total[1, 1] += 1.0 / max(clamp_compliance, 1e-9)
        if guide_spring > 0.0:
            row = self.slopes(np.array([guide_m]))[0]
            total += guide_spring * np.outer(row, row)
        inverse = np.zeros((n, n))
        inverse[1:, 1:] = np.linalg.inv(total[1:, 1:])
        self.inverse = 0.5 * (inverse + inverse.T)

    def _locate(self, z: Array) -> tuple[NDArray[np.int64], Array, Array]:
        index = np.clip(np.searchsorted(self.nodes, z, side="right") - 1, 0, len(self.nodes) - 2)
        h = self.nodes[index + 1] - self.nodes[index]
        return index, (z - self.nodes[index]) / h, h

    def rows(self, z: Array) -> Array:
        """Interpolation of the deflection at z from the nodal values: matrix of len(z) rows."""
        index, xi, h = self._locate(z)
        return self._scatter(index, hermite(xi, h))

    def slopes(self, z: Array) -> Array:
        """Interpolation of the slope at z from the nodal values."""
        index, xi, h = self._locate(z)
        values = np.stack(
            [(-6 * xi + 6 * xi**2) / h, 1 - 4 * xi + 3 * xi**2, (6 * xi - 6 * xi**2) / h, 3 * xi**2 - 2 * xi], axis=-1
        )
        return self._scatter(index, values)

    def _scatter(self, index: NDArray[np.int64], values: Array) -> Array:
        out = np.zeros((len(index), 2 * len(self.nodes)))
        for k in range(4):
            out[np.arange(len(index)), 2 * index + k] += values[:, k]
        return out

    def nodal(self, shape: Callable[[Array], Array]) -> Array:
        """Nodal values and slopes of a smooth shape [m]."""
        out = np.empty(2 * len(self.nodes))
        out[0::2] = shape(self.nodes)
        step = 1e-6
        out[1::2] = (shape(self.nodes + step) - shape(self.nodes - step)) / (2 * step)
        return out

    def unloaded(self, stress_free: Array) -> Array:
        """Nodal values of the unloaded needle whose stress-free shape is given by nodal values."""
        return self.inverse @ (self.bend @ stress_free)


def kink(z: Array, bend: float) -> Array:
    """Shape of a needle bent by one radian at a place, over the short length KINK [m]."""
    inside = np.clip(z - bend + KINK / 2, 0.0, KINK)
    return inside**2 / (2 * KINK) + np.maximum(z - bend - KINK / 2, 0.0)
