"""Small imperfections of a real lab, whose sizes are drawn by the seed."""

from __future__ import annotations

import numpy as np

from effects import MM
from physics import Array, Motion, Readings, Run, World


def lagging(force: Array, scale: float) -> Array:
    """Direction of the last change of a force, from -1 to 1, turned over a change of about `scale` [N]."""
    out = np.zeros(len(force))
    state, before = 0.0, float(force[0])
    for i, value in enumerate(force.tolist()):
        change = value - before
        if change != 0.0:
            state += min(abs(change) / scale, 1.0) * ((1.0 if change > 0 else -1.0) - state)
            before = value
        out[i] = state
    return out


def add_background(world: World, rng: np.random.Generator) -> dict[str, float]:
    """Imperfections of every lab; returns their sizes."""
    rms, phases = rng.uniform(0.01, 0.035), rng.uniform(0, 2 * np.pi, 3)
    lengths = rng.uniform(20, 60, 3) * MM
    drift, wander = rng.normal(0, 0.0015, 2), rng.uniform(0.0005, 0.002)
    wander_t = rng.uniform(15, 40)
    hysteresis, hum = rng.uniform(0.002, 0.004), rng.uniform(0.001, 0.004)
    beat = rng.uniform(0.1, 3.0)
    zero = rng.uniform(0.001, 0.004)
    wave, period, phase = rng.uniform(5e-6, 15e-6), rng.uniform(4, 12) * MM, rng.uniform(0, 2 * np.pi)
    seat = rng.uniform(1e-6, 4e-6)
    seed = int(rng.integers(2**31))

    def factor(s: Array, run: Run) -> Array:
        waves = [np.cos(2 * np.pi * s / length + p) for length, p in zip(lengths, phases)]
        return 1 + rms * np.sqrt(2 / 3) * np.sum(waves, axis=0)

    def force(r: Readings, m: Motion) -> None:
        drawn = np.random.default_rng([seed, r.run.index])
        span = max(float(np.abs(r.force).max()), 1e-3)
        late = np.array([lagging(row, 0.2 * span) for row in r.force])
        slow = drift[:, None] * r.time / r.time[-1] * drawn.uniform(0.5, 1.5)
        slow = slow + wander * np.sin(2 * np.pi * r.time / wander_t + drawn.uniform(0, 2 * np.pi, (2, 1)))
        mains = hum * np.sin(2 * np.pi * beat * r.time + drawn.uniform(0, 2 * np.pi, (2, 1)))
        r.force = r.force - hysteresis * span * late + slow + mains + drawn.normal(0, zero, (2, 1))

    def displacement(r: Readings, m: Motion) -> None:
        drawn = np.random.default_rng([seed, r.run.index, 1])
        r.displacement = r.displacement + drawn.normal(0, seat, (2, 1))

    def shape(r: Readings, m: Motion) -> None:
        drawn = np.random.default_rng([seed, r.run.index, 2])
        for sweep in r.sweeps:
            sweep.deflection = (
                sweep.deflection + wave * np.sin(2 * np.pi * sweep.z / period + phase) + drawn.normal(0, seat, (2, 1))
            )

    world.k_profile.append(factor)
    world.force_hooks.append(force)
    world.displacement_hooks.append(displacement)
    world.shape_hooks.append(shape)
    return {
        "modulus_rms": rms,
        "force_drift_mn": 1e3 * float(np.abs(drift).max()),
        "force_wander_mn": 1e3 * wander,
        "force_hysteresis": hysteresis,
        "hum_mn": 1e3 * hum,
        "force_zero_mn": 1e3 * zero,
        "image_wave_um": 1e6 * wave,
        "image_period_mm": period / MM,
        "seat_um": 1e6 * seat,
    }
