"""Set a, effects in needle, guides and clamp."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from physics import Array, ExtraPoint, Hinge, Run, World

from .catalogue import MM, Parameters, effect, sign


@effect(
    "a",
    "force on the needle",
    "distance between needle and actuator",
    "a magnet on one side at z = 45 mm pulls with f0 (d/(d - u))^2, d = 4 mm",
)
def magnet(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    f0, d, side = (0.06, 0.12, 0.25)[strength], 4 * MM, sign(rng)

    def force(u: Array, t: float, run: Run) -> tuple[Array, Array]:
        gap = np.maximum(d - side * u[0], 0.5 * MM)
        return np.array([side * f0 * (d / gap) ** 2, 0.0]), np.array([2 * f0 * d**2 / gap**3, 0.0])

    world.extra.append(ExtraPoint(lambda run, length: 45 * MM, force))
    world.two_axes = True
    return {"force_n": side * f0, "distance_mm": d / MM, "z_mm": 45.0}


@effect("a", "needle stiffness", "place along the needle", "bending stiffness times r within 3 mm of a dent at z0")
def dented_needle(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r, z0 = (0.35, 0.18, 0.08)[strength], rng.uniform(62, 68) * MM
    world.bending.append(lambda z, run, length: np.where(np.abs(z - z0) < 3 * MM, r, 1.0))
    return {"ratio": r, "z_mm": z0 / MM, "width_mm": 6.0}


@effect(
    "a",
    "needle stiffness",
    "distance from the tip",
    "the stylet ends short of the tip: stiffness times r over the last part of the needle",
)
def short_stylet(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r, short = (0.5, 0.25, 0.1)[strength], rng.uniform(24, 34) * MM
    world.bending.append(lambda z, run, length: np.where(z > length - short, r, 1.0))
    return {"ratio": r, "short_mm": short / MM}


class Yielding(Hinge):
    """Viscoplastic hinge: turns at rate (|M| - M_y)/eta beyond a moment; keeps its angle over the runs or not."""

    rate = True

    def __init__(self, z: Callable[[Run, float], float | None], limit: float, eta: float, keeps: bool) -> None:
        super().__init__(z)
        self.limit, self.eta, self.keeps = limit, eta, keeps
        self.angle = np.zeros(2)

    def begin(self, run: Run, axes: int) -> None:
        """Choose the axes; straighten the hinge unless it keeps its angle."""
        self.axes = [run.axis] if axes == 1 else [0, 1]
        if not self.keeps:
            self.angle = np.zeros(2)

    def law(self, moment: Array) -> tuple[Array, Array]:
        """The angle so far, which does not depend on the moment within a step."""
        return self.angle[self.axes], np.zeros(len(self.axes))

    def commit(self, moment: Array, dt: float) -> None:
        """Turn where the moment exceeds the limit."""
        beyond = np.maximum(np.abs(moment) - self.limit, 0.0)
        self.angle[self.axes] += dt * np.sign(moment) * beyond / self.eta


@effect(
    "a",
    "needle",
    "bending moment at the clamp's exit, irreversible within a run",
    "a plastic hinge 4 mm from guide 1 turns while |M| > M_y",
)
def needle_yields(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    limit = (0.0135, 0.0115, 0.009)[strength]
    world.hinges.append(Yielding(lambda run, length: 4 * MM, limit, 0.4, keeps=False))
    return {"yield_moment_n_m": limit, "z_mm": 4.0}


@effect(
    "a",
    "needle tension",
    "square of the slopes",
    "the needle is held lengthwise: tension r E A/(2 L) int u'^2 dz straightens it",
)
def tension_builds(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r = (0.08, 0.2, 0.5)[strength]
    world.membrane = r
    return {"share_of_full_restraint": r}


@effect("a", "guide 2", "slope of the needle in guide 2", "guide 2 is a sleeve: moment c u'(c2) against turning")
def sleeve_guide(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    c = (0.08, 0.2, 0.6)[strength]
    world.guide_spring += c
    return {"spring_n_m_per_rad": c}


@effect(
    "a",
    "motion of guide 2",
    "displacement, across it",
    "guide 2 travels on an arc: while it moves g along one axis it moves g^2/(2 R) along the other, unread",
)
def arc_motion(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    radius = (8.0, 4.0, 2.0)[strength] * MM * sign(rng)

    def move(run: Run, g: Array) -> Array:
        out = g.copy()
        out[1 - run.axis] += g[run.axis] ** 2 / (2 * radius)
        return out

    world.motion.append(move)
    world.two_axes = True
    return {"radius_mm": radius / MM}


@effect("a", "place of guide 2", "displacement", "guide 2 sits on a tilting lever: its place is c2 + a g")
def tilting_guide(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = (1.2, 2.5, 5.0)[strength] * sign(rng)
    world.guide_shift = lambda g, run: a * g[run.axis]
    return {"shift_mm_per_mm": a}


@effect("a", "clamp", "run (order of measurement)", "the clamp works loose: rotational compliance a n, n = runs before")
def clamp_loosens(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = (0.04, 0.1, 0.22)[strength]
    world.clamp.append(lambda run: a * run.index)
    return {"compliance_rad_per_n_m_per_run": a}


@effect("a", "clamp", "moment, irreversible within a run", "the clamp slips while |M| > M_s, and holds below")
def clamp_slips(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    limit = (0.0135, 0.0115, 0.009)[strength]
    world.hinges.append(Yielding(lambda run, length: 0.0, limit, 0.4, keeps=False))
    return {"slip_moment_n_m": limit}


class OneSided(Hinge):
    """Compliant for one sign of the moment."""

    def __init__(self, compliance: float, side: float) -> None:
        super().__init__(lambda run, length: 0.0)
        self.compliance, self.side = compliance, side

    def law(self, moment: Array) -> tuple[Array, Array]:
        """Rotation for one sign of the moment, smooth about zero."""
        smooth = 5e-4
        x = self.side * moment / smooth
        return (
            self.side * self.compliance * smooth * (np.logaddexp(0, x) - np.log(2.0)),
            self.compliance / (1 + np.exp(-np.clip(x, -60, 60))),
        )


@effect("a", "clamp", "sign of the moment", "a one-sided clamp: turns by c M for one sign of M, rigid for the other")
def one_sided_clamp(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    c, side = (0.1, 0.25, 0.6)[strength], sign(rng)
    world.hinges.append(OneSided(c, side))
    return {"compliance_rad_per_n_m": c, "side": side}


@effect(
    "a",
    "tip of the needle",
    "depth of the tip",
    "a bevel load pushes the tip sideways along y by f d/(20 mm) at depth d, also at rest",
)
def bevel_load(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    f = sign(rng) * (0.025, 0.05, 0.1)[strength]
    world.extra.append(
        ExtraPoint(
            lambda run, length: length, lambda u, t, run: (np.array([f * run.depth / (20 * MM), 0.0]), np.zeros(2))
        )
    )
    world.two_axes = True
    return {"load_at_20mm_n": f}


@effect(
    "a",
    "true depth",
    "run: depths reached by pulling back",
    "the feed has slack: runs reached by pulling back, and repeats, lie deeper than stated",
)
def feed_slack(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    extra = (1.0, 2.0, 3.5)[strength] * MM

    def deeper(run: Run, depth: float) -> float:
        return depth + extra if run.passes and run.passes[-1] >= run.depth else depth

    world.true_depth.append(deeper)
    return {"slack_mm": extra / MM}
