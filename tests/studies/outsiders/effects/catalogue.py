"""Registration of hidden effects.

Every function takes the world, the strength (0, 1 or 2) and a random generator, adds its mechanism to the world, and
returns its parameters, each named with its unit. SI inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from physics import Array, World

Parameters = dict[str, float | str]
Apply = Callable[[World, int, np.random.Generator], Parameters]
MM = 1e-3


@dataclass(frozen=True)
class Effect:
    """A kind of hidden effect, in words and as a function."""

    kind: str
    group: str
    site: str
    depends_on: str
    formula: str
    apply: Apply


REGISTERED: dict[str, Effect] = {}


def effect(group: str, site: str, depends_on: str, formula: str) -> Callable[[Apply], Apply]:
    """Register a function under its own name."""

    def register(function: Apply) -> Apply:
        function.__doc__ = f"{site}, by {depends_on}: {formula}."
        REGISTERED[function.__name__] = Effect(function.__name__, group, site, depends_on, formula, function)
        return function

    return register


def sign(rng: np.random.Generator) -> float:
    """1 or -1."""
    return float(rng.choice([-1.0, 1.0]))


def bump(s: Array, middle: float, width: float) -> Array:
    """Gaussian of standard deviation `width`."""
    return np.exp(-0.5 * ((s - middle) / width) ** 2)


def play_operator(x: Array, half: float) -> Array:
    """Output of a mechanism with lost motion of +-half, which starts in the middle."""
    out = np.empty_like(x)
    y = x[0]
    for i, value in enumerate(x):
        y = min(max(y, value - half), value + half)
        out[i] = y
    return out
