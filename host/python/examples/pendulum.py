"""A pendulum that is said to swing in air alone, and whose pivot rubs."""

import numpy as np

from needle_guide import discrepancy

HIDDEN = 0.06  # 1/s^2: dry friction of the pivot, which the model does not have


def swing(time_s, start, deceleration):
    """Angle of a pendulum: semi-implicit steps of 5 ms."""
    angle, speed, angles = start, 0.0, []
    for _ in time_s:
        angles.append(angle)
        for _ in range(4):
            speed -= 0.005 * deceleration(angle, speed)
            angle += 0.005 * speed
    return np.array(angles)


def model(parameters, terms, run):
    gravity, air = parameters["gravity"], parameters["air"]
    inside = lambda q, v: gravity * np.sin(q) + air * v + terms("pivot", speed=v)
    return swing(run["time_s"], run["start"][0], inside)


def measured(name, start, seed, judges):
    time_s = np.arange(0.0, 8.0, 0.02)
    truth = lambda q, v: 9.4 * np.sin(q) + 0.12 * v + HIDDEN * np.tanh(v / 1e-3)
    angle = swing(time_s, start, truth) + 0.002 * np.random.default_rng(seed).standard_normal(time_s.size)
    return discrepancy.Run(name, time_s, {"angle": angle}, {"start": np.full(time_s.size, start)}, judges=judges)


found = discrepancy.diagnose(
    model,
    [measured("high", 0.9, 1, False), measured("low", 0.5, 2, True)],
    parameters={"gravity": (9.81, 0.5), "air": (0.1, 0.1)},
    sites={"pivot": {"regressors": [{"name": "speed", "unit": "1/s", "resolution": 0.002}], "unit": "1/s^2"}},
)
print(found)
