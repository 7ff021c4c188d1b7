"""Mechanics of a needle between two guides and in tissue.

SI units throughout: m, N, s, Pa. Depths s count from the surface of the tissue, positions z from guide 1.
Axis 0 is y, axis 1 is x.
"""

from .beam import Array, Beam
from .body import body_stiffness, mindlin
from .equilibrium import march
from .runs import SWEEP_AFTER_S, SWEEP_S, Motion, Readings, Run, Sweep
from .tissue import Pointwise, SlipBody, Stage, gauss_points
from .world import ExtraPoint, Geometry, Hinge, World

__all__ = [
    "SWEEP_AFTER_S",
    "SWEEP_S",
    "Array",
    "Beam",
    "ExtraPoint",
    "Geometry",
    "Hinge",
    "Motion",
    "Pointwise",
    "Readings",
    "Run",
    "SlipBody",
    "Stage",
    "Sweep",
    "World",
    "body_stiffness",
    "gauss_points",
    "march",
    "mindlin",
]
