"""Targets that a needle can reach: where its tip arrives by a path of guide 2 inside a share of all limits, without noise."""
import numpy as np

from tissue import Needle
from world import World

SHARE = 0.8
DEPTH = 100


def path(world, moves):
    """Tip at the target's depth, peak force and peak strain where guide 2 goes to positions at depths, in the needle's true state."""
    needle = Needle(world)
    load = lambda depth: world.load(depth, 0.0)
    guide = np.zeros(2)
    needle.to(0.0, guide, load, 0.1)
    force = strain = 0.0
    for depth in range(DEPTH + 1):
        if depth in moves:
            aim = moves[depth]
            # In parts, as a drive would, since tissue yields and relaxes by the way.
            for part in range(1, 5):
                needle.to(needle.depth, guide + part / 4 * (aim - guide), load, 0.3)
                force, strain = max(force, float(np.hypot(*needle.force))), max(strain, needle.strain)
            guide = aim
        if depth < DEPTH:
            needle.to(depth + 1.0, guide, load, 0.25)
            force, strain = max(force, float(np.hypot(*needle.force))), max(strain, needle.strain)
    return needle.tip + world.slope * DEPTH, force, strain


def target(tissue, seed, hidden, limits, draw):
    """Target and the miss without steering, mm."""
    world = World(tissue, seed, hidden, limits)
    rng = np.random.default_rng([seed, draw, 63])
    places = [0, int(rng.integers(3, 9)) * 5, int(rng.integers(9, 13)) * 5]
    aims = rng.uniform(-SHARE, SHARE, (3, 2)) * world.limits["travel"]
    still = path(world, {})[0]
    while True:
        tip, force, strain = path(world, dict(zip(places, aims)))
        if force <= SHARE * world.limits["force"] and strain <= SHARE * world.limits["strain"]:
            return tip, still
        aims = 0.8 * aims
