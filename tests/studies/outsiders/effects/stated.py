"""Set e, stated geometry that is wrong; set f, an elastic body in place of springs."""

from __future__ import annotations

import numpy as np

from physics import Geometry, World, body_stiffness

from .catalogue import MM, Parameters, effect, sign


@effect("e", "rig as stated", "nothing", "guide 2 lies off its stated place by 1, 2 or 5 mm")
def guide2_off(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    off = sign(rng) * (1.0, 2.0, 5.0)[strength] * MM
    g = world.geometry
    world.geometry = Geometry(g.guide2 + off, g.entry, g.outer, g.inner, g.youngs)
    return {"off_mm": off / MM}


@effect("e", "rig as stated", "nothing", "the surface lies off its stated place by 1, 2 or 5 mm")
def surface_off(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    off, carriage = sign(rng) * (1.0, 2.0, 5.0)[strength] * MM, bool(rng.integers(0, 2))
    g = world.geometry
    world.geometry = Geometry(g.guide2, g.entry + off, g.outer, g.inner, g.youngs)
    if carriage:
        world.true_depth.append(lambda run, depth: depth - off)
    return {"off_mm": off / MM, "depth_counted_from": "carriage" if carriage else "true surface"}


@effect("e", "needle as stated", "nothing", "the outer or the inner diameter is off by 0.03 mm")
def diameter_off(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    off, which = sign(rng) * 0.03 * MM, ("outer", "inner", "outer")[strength]
    g = world.geometry
    world.geometry = Geometry(
        g.guide2, g.entry, g.outer + off * (which == "outer"), g.inner + off * (which == "inner"), g.youngs
    )
    return {"off_mm": off / MM, "diameter": which}


def _as_body(world: World, strength: int, rng: np.random.Generator, walls: float | None) -> Parameters:
    youngs, poisson = world.k0, float((0.5, 0.47, 0.42)[strength])
    world.body = body_stiffness(youngs, poisson, world.stated.outer / 2, walls)
    world.cell = 0.9 * MM
    out: Parameters = {"youngs_modulus_kpa": youngs / 1e3, "poisson": poisson}
    if walls is not None:
        out["walls_at_mm"] = walls / MM
    return out


@effect(
    "f",
    "tissue",
    "displacement at all depths",
    "elastic half space, needle bonded: Mindlin's point forces along the needle in place of springs",
)
def half_space(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    return _as_body(world, strength, rng, None)


@effect(
    "f",
    "tissue",
    "displacement at all depths",
    "elastic square block, deep, with rigid frictionless side walls: Mindlin's point forces and their mirror images",
)
def block(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    return _as_body(world, strength, rng, (40.0, 25.0, 15.0)[strength] * MM)
