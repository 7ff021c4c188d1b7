"""Set a, effects in the readings of the shape."""

from __future__ import annotations

import numpy as np

from physics import Array, Motion, Readings, World

from .catalogue import MM, Parameters, bump, effect, sign


@effect("a", "shape reading", "place along the needle", "reading = u + a sin(2 pi z/p + phase): waves of the image")
def image_wave(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, p, phase = (0.06, 0.12, 0.25)[strength] * MM, rng.uniform(6, 14) * MM, rng.uniform(0, 2 * np.pi)

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection[0] += a * np.sin(2 * np.pi * sweep.z / p + phase)

    world.shape_hooks.append(hook)
    return {"amplitude_mm": a / MM, "period_mm": p / MM, "phase_rad": phase}


@effect(
    "a",
    "shape reading",
    "deflection and depth",
    "reading = u (1 + a s/(20 mm)): wrong speed of sound below the surface",
)
def scale_by_depth(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.04, 0.08, 0.16)[strength]

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection *= 1 + a * (sweep.z - world.stated.entry) / (20 * MM)

    world.shape_hooks.append(hook)
    return {"scale_per_20mm": a}


@effect("a", "shape reading", "the shape before", "reading = (1 - a) u + a (reading of the sweep before): persistence")
def image_ghost(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = (0.08, 0.16, 0.3)[strength]

    def hook(r: Readings, m: Motion) -> None:
        before: Array | None = None
        for sweep in r.sweeps:
            if before is not None:
                sweep.deflection = (1 - a) * sweep.deflection + a * before
            before = sweep.deflection.copy()

    world.shape_hooks.append(hook)
    return {"share": a}


@effect("a", "shape reading", "deflection", "reading = u (1 - (u/u0)^2): barrel distortion")
def barrel_distortion(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    u0 = (6.0, 4.5, 3.2)[strength] * MM

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection *= 1 - (sweep.deflection / u0) ** 2

    world.shape_hooks.append(hook)
    return {"scale_mm": u0 / MM}


@effect(
    "a",
    "shape reading",
    "place along the needle",
    "stated z = surface + (z - surface)/(1 + a): slip of the probe's encoder",
)
def stretched_z(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.2, 0.35, 0.6)[strength]
    world.shape_positions.append(lambda z, run: world.stated.entry + (z - world.stated.entry) * (1 + a))
    return {"stretch": a}


@effect(
    "a",
    "shape reading",
    "sign of the deflection",
    "reading = u + a tanh(u/0.1 mm): the other wall of the needle is taken",
)
def wall_pick(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.06, 0.12, 0.25)[strength] * MM

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection += a * np.tanh(sweep.deflection / (0.1 * MM))

    world.shape_hooks.append(hook)
    return {"offset_mm": a / MM}


@effect("a", "shape reading", "deflection along the other axis", "the image is rolled: (y, x) turned by an angle")
def rolled_probe(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    angle = sign(rng) * (0.08, 0.16, 0.3)[strength]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection = turn @ sweep.deflection

    world.shape_hooks.append(hook)
    return {"angle_rad": angle}


@effect(
    "a",
    "shape reading",
    "place along the needle, deflection",
    "between two z readings are drawn to a bright speck: reading = (1 - a) u + a y0",
)
def bright_speck(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, speck, y0 = (0.2, 0.4, 0.7)[strength], 70 * MM + rng.uniform(5, 10) * MM, sign(rng) * 0.5 * MM

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            pull = a * bump(sweep.z, speck, 2 * MM)
            sweep.deflection = (1 - pull) * sweep.deflection + pull * np.array([[y0], [0.0]])

    world.shape_hooks.append(hook)
    return {"share": a, "z_mm": speck / MM, "sd_mm": 2.0, "y_mm": y0 / MM}


@effect(
    "a",
    "shape reading",
    "order of the sweeps in the session",
    "the image drifts along y by a per sweep and starts again at every second run",
)
def image_walks(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.025, 0.05, 0.1)[strength] * MM

    def hook(r: Readings, m: Motion) -> None:
        before = len(r.sweeps) * (r.run.index % 2)
        for i, sweep in enumerate(r.sweeps):
            sweep.deflection[0] += a * (before + i)

    world.shape_hooks.append(hook)
    return {"walk_mm_per_sweep": a / MM}
