"""Everything that is true in one session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .beam import Array, second_moment
from .runs import Motion, Readings, Run
from .tissue import SlipBody, Stage

Hook = Callable[[Readings, Motion], None]


class Hinge:
    """A place where the needle, or its clamp, turns by theta(moment) [rad, N m]."""

    rate = False

    def __init__(self, z: Callable[[Run, float], float | None]) -> None:
        self.z = z

    def begin(self, run: Run, axes: int) -> None:
        """Start of a run."""

    def law(self, moment: Array) -> tuple[Array, Array]:
        """Rotation per axis and its derivative by the moment."""
        raise NotImplementedError

    def commit(self, moment: Array, dt: float) -> None:
        """Accept the moment of the finished step."""


@dataclass
class ExtraPoint:
    """A force on the needle at one place that is no tissue.

    z(run, length): place or None; force(u, time, run): force on the needle per axis and its derivative by u.
    """

    z: Callable[[Run, float], float | None]
    force: Callable[[Array, float, Run], tuple[Array, Array]]
    rate: bool = False


@dataclass
class Geometry:
    """Rig and needle [m, Pa]."""

    guide2: float = 60e-3
    entry: float = 70e-3
    outer: float = 1.27e-3
    inner: float = 1.0e-3
    youngs: float = 200e9

    @property
    def bending(self) -> float:
        """Bending stiffness [N m^2]."""
        return self.youngs * second_moment(self.outer, self.inner)


@dataclass
class World:
    """Everything that is true in one session, each list open to additions by the effects."""

    k0: float
    geometry: Geometry
    stated: Geometry
    k_profile: list[Callable[[Array, Run], Array]] = field(default_factory=list)
    breaks: list[float] = field(default_factory=list)
    strain: list[Stage] = field(default_factory=list)
    stress: list[Stage] = field(default_factory=list)
    shear: float = 0.0
    tensor: Array | None = None
    body: Callable[[Array, Array, float], Array] | None = None
    support: list[Callable[[Array, Run], Array]] = field(default_factory=list)
    anchors: list[Callable[[Array, float, Run], Array]] = field(default_factory=list)
    slips: list[SlipBody] = field(default_factory=list)
    extra: list[ExtraPoint] = field(default_factory=list)
    bending: list[Callable[[Array, Run, float], Array]] = field(default_factory=list)
    clamp: list[Callable[[Run], float]] = field(default_factory=list)
    guide_spring: float = 0.0
    axial: list[Callable[[Run], float]] = field(default_factory=list)
    membrane: float = 0.0
    free_shape: list[Callable[[Array, float], Array]] = field(default_factory=list)
    hinges: list[Hinge] = field(default_factory=list)
    frame: float = 0.0
    play: float = 0.0
    motion: list[Callable[[Run, Array], Array]] = field(default_factory=list)
    guide_shift: Callable[[Array, Run], float] | None = None
    true_depth: list[Callable[[Run, float], float]] = field(default_factory=list)
    two_axes: bool = False
    force_hooks: list[Hook] = field(default_factory=list)
    displacement_hooks: list[Hook] = field(default_factory=list)
    shape_positions: list[Callable[[Array, Run], Array]] = field(default_factory=list)
    shape_hooks: list[Hook] = field(default_factory=list)
    noise_stated: bool = True
    cell: float = 1.25e-3

    @property
    def timeless(self) -> bool:
        """Whether nothing changes while guide 2 rests."""
        return not (
            self.anchors
            or self.slips
            or self.membrane
            or any(x.rate for x in self.extra)
            or any(x.rate for x in [*self.strain, *self.stress])
            or any(x.rate for x in self.hinges)
        )

    def depth(self, run: Run) -> float:
        """True depth of the tip below the true surface [m]."""
        depth = run.depth
        for change in self.true_depth:
            depth = change(run, depth)
        return depth

    def modulus(self, s: Array, run: Run) -> Array:
        """Foundation modulus at the depths s [Pa]."""
        k = np.full_like(s, self.k0)
        for factor in self.k_profile:
            k = k * factor(s, run)
        return k


def foundation(world: World, run: Run, s: Array, w: Array, depth: float) -> Array:
    """Matrix from relative displacement to nodal forces of the tissue [N/m]."""
    k = world.modulus(s, run)
    if world.body is not None:
        relative = np.sqrt(k / world.k0)
        return relative[:, None] * world.body(s, w, depth) * relative[None, :]
    out = np.diag(k * w)
    if world.shear > 0.0:
        gap = np.diff(s)
        difference = np.diff(np.eye(len(s)), axis=0)
        out += difference.T @ (world.shear / gap[:, None] * difference)
        out[-1, -1] += np.sqrt(world.shear * k[-1])  # the shear layer goes on below the tip
    return out
