#!/usr/bin/env python3
"""The manual's plant in Python with other limits: example.py SEED [NAME=VALUE]..., and targets that its needle can reach."""
import importlib.util
import math
import random
import sys
from pathlib import Path

FILE = Path(__file__).resolve().parents[4] / "host/examples/plant.py"
USUAL = {"travel": 6.0, "speed": 4.0, "force": 8.0, "strain": 0.004}


def needle(limits):
    """The module, with limits."""
    spec = importlib.util.spec_from_file_location("needle_plant", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.FORCE, module.STRAIN = limits["force"], limits["strain"]
    module.TRAVEL, module.SPEED = limits["travel"], limits["speed"]
    return module


def modulus_kpa(seed):
    """Modulus of a needle's tissue, within the range that the plant states."""
    return random.Random(f"modulus {seed}").uniform(0.5, 1.5) * 15.0


def target(seed, limits, depth):
    """Target and tip without steering: the tip is carried there inside 0.8 of all limits."""
    usual = USUAL | ({"force": 0.5 * USUAL["force"]} if "force" in limits else {}) | {
        name: value for name, value in limits.items() if name != "force"}
    module = needle(usual)
    rng = random.Random(f"target {seed}")
    drawn = random.Random(seed)
    slope = [drawn.gauss(0, 0.005), drawn.gauss(0, 0.005)]
    loads = [[module.LOAD], [0.0]]
    for _ in range(module.DEPTH + 1):
        for load in loads:
            load.append(load[-1] + drawn.gauss(0, module.WANDER * module.LOAD))
    places = [0, rng.randrange(3, 9) * 5, rng.randrange(9, 13) * 5]
    aims = [[rng.uniform(-0.8, 0.8) * usual["travel"] for _ in range(2)] for _ in places]

    def path(scale):
        planes = [module.Needle(modulus_kpa(seed)) for _ in range(2)]
        guide, most_force, most_bent = [0.0, 0.0], 0.0, 0.0
        for at in range(depth + 1):
            for place, aim in zip(places, aims):
                if at == place:
                    guide = [scale * one for one in aim]
            for i in range(2):
                planes[i].push(at, guide[i], loads[i][at])
            ends = [planes[i].at(at, guide[i], loads[i][at]) for i in range(2)]
            most_force = max(most_force, math.hypot(ends[0][1], ends[1][1]))
            most_bent = max(most_bent, module.RADIUS * max(math.hypot(x, y) for x, y in zip(ends[0][3], ends[1][3])))
        return [ends[i][0] + slope[i] * depth for i in range(2)], most_force, most_bent

    still, scale = path(0.0)[0], 1.0
    while True:
        tip, force, bent = path(scale)
        if force <= 0.8 * usual["force"] and bent <= 0.8 * usual["strain"]:
            import numpy as np
            return np.array(tip), np.array(still)
        scale *= 0.8


if __name__ == "__main__":
    seed = int(sys.argv[1])
    stated = USUAL | {name: float(value) for name, value in (one.split("=") for one in sys.argv[2:])}
    plant = needle(stated)
    sys.argv = ["plant.py", str(seed), str(modulus_kpa(seed))]
    sys.exit(plant.main())
