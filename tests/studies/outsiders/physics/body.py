"""Elastic bodies in place of springs: Mindlin's point forces along the needle, and their mirror images."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .beam import Array


def mindlin(s: Array, source: Array, radius: Array | float, along2: Array | float, poisson: float) -> Array:
    """Displacement along a horizontal point force inside a half space, per force and times the shear modulus [1/m].

    R. D. Mindlin, Physics 7 (1936) 195: s and source are the depths of the point and of the force, radius their
    distance in the horizontal plane, along2 the square of its component along the force.
    """
    a, b = s - source, s + source
    r1, r2 = np.sqrt(radius**2 + a**2), np.sqrt(radius**2 + b**2)
    nu4 = 3 - 4 * poisson
    return (
        nu4 / r1
        + 1 / r2
        + along2 / r1**3
        + nu4 * along2 / r2**3
        + 2 * source * s / r2**3 * (1 - 3 * along2 / r2**2)
        + 4 * (1 - poisson) * (1 - 2 * poisson) / (r2 + b) * (1 - along2 / (r2 * (r2 + b)))
    ) / (16 * np.pi * (1 - poisson))


def body_stiffness(
    youngs: float, poisson: float, radius: float, walls: float | None = None, images: int = 12
) -> Callable[[Array, Array, float], Array]:
    """Tissue forces on the needle's line in an elastic half space, or in a square block of it.

    The needle is bonded: its displacement at a Gauss point is the mean displacement of the circle of the needle's
    radius there, caused by lateral forces spread evenly along each point's share of the line (Mindlin's solution).
    walls: distance of four rigid frictionless side walls from the needle [m]; they are satisfied exactly by mirrored
    sources: those across a wall normal to the force change its sign.
    """
    shear_modulus = youngs / (2 * (1 + poisson))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    tail = np.array([1.0, 5.0, 11.0, 15.0])[::-1] / 16  # Euler's summation of the alternating images

    def make(s: Array, w: Array, depth: float) -> Array:
        edges = np.concatenate([[0.0], np.cumsum(w)])
        influence = np.zeros((len(s), len(s)))
        for node, weight in zip(nodes, weights):
            source = 0.5 * (edges[:-1] + edges[1:]) + 0.5 * np.diff(edges) * node
            influence += 0.5 * weight * mindlin(s[:, None], source[None, :], radius, radius**2 / 2, poisson)
        if walls is not None:
            for i in range(-images, images + 1):
                end = images - abs(i)
                taper = tail[3 - end] if end < 4 else 1.0
                for j in range(-images // 3, images // 3 + 1):
                    if i == 0 and j == 0:
                        continue
                    y, x = 2 * walls * i, 2 * walls * j
                    influence += (
                        taper * (-1.0) ** i * mindlin(s[:, None], s[None, :], float(np.hypot(x, y)), y**2, poisson)
                    )
        influence /= shear_modulus
        inverse = np.linalg.inv(0.5 * (influence + influence.T))
        return 0.5 * (inverse + inverse.T)

    return make
