"""Set a, effects in the readings of displacement and force."""

from __future__ import annotations

import numpy as np

from physics import Motion, Readings, World

from .catalogue import MM, Parameters, effect, sign


@effect("a", "displacement reading", "displacement", "reading = g + a sin(2 pi g/p + phase): error of the lead screw")
def leadscrew_error(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, p, phase = (0.04, 0.08, 0.15)[strength] * MM, rng.uniform(0.8, 1.5) * MM, rng.uniform(0, 2 * np.pi)

    def hook(r: Readings, m: Motion) -> None:
        g = r.displacement
        r.displacement = g + a * (np.sin(2 * np.pi * g / p + phase) - np.sin(phase))

    world.displacement_hooks.append(hook)
    return {"amplitude_mm": a / MM, "period_mm": p / MM, "phase_rad": phase}


@effect("a", "displacement reading", "time within a run", "reading = g + a (1 - exp(-t/10 s)): the sensor warms up")
def displacement_creeps(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.05, 0.1, 0.2)[strength] * MM

    def hook(r: Readings, m: Motion) -> None:
        r.displacement[r.run.axis] += a * (1 - np.exp(-r.time / 10.0))

    world.displacement_hooks.append(hook)
    return {"creep_mm": a / MM, "time_s": 10.0}


@effect("a", "displacement reading", "displacement", "reading rounded to multiples of q")
def coarse_bits(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    q, start = (0.13, 0.22, 0.35)[strength] * MM, float(rng.uniform(0, 1))

    def hook(r: Readings, m: Motion) -> None:
        r.displacement = q * (np.round(r.displacement / q + start) - np.round(start))

    world.displacement_hooks.append(hook)
    return {"step_mm": q / MM, "phase_steps": start}


@effect("a", "force reading", "force", "the amplifier clips: readings stop at +-F_max")
def force_clips(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    fraction = (0.9, 0.75, 0.6)[strength]
    limit = fraction * (0.5 + 0.05 * world.k0 / 1e3)  # a share of about the largest force of a session

    def hook(r: Readings, m: Motion) -> None:
        r.force = np.clip(r.force, -limit, limit)

    world.force_hooks.append(hook)
    return {"limit_n": limit}


@effect("a", "force reading", "force", "crossover: readings shrink by F exp(-|F|/F0) about zero")
def force_crossover(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    f0 = (0.1, 0.2, 0.4)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force * (1 - np.exp(-np.abs(r.force) / f0))

    world.force_hooks.append(hook)
    return {"scale_n": f0}


@effect("a", "force reading", "force and time", "the load cell creeps: reading = F + a (F low-passed with tau)")
def load_cell_creep(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, tau = (0.08, 0.15, 0.3)[strength], rng.uniform(3, 8)

    def hook(r: Readings, m: Motion) -> None:
        step = 1 - np.exp(-np.diff(r.time, prepend=r.time[0]) / tau)
        slow = np.zeros(2)
        out = np.empty_like(r.force)
        for i in range(r.force.shape[1]):
            slow = slow + step[i] * (r.force[:, i] - slow)
            out[:, i] = slow
        r.force = r.force + a * out

    world.force_hooks.append(hook)
    return {"share": a, "time_s": tau}


@effect("a", "force reading", "time", "reading = F + a sin(2 pi t/T + phase), t since the session's start: a pump")
def pump(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, period, phase = (0.06, 0.12, 0.25)[strength], rng.uniform(5, 12), rng.uniform(0, 2 * np.pi)

    def hook(r: Readings, m: Motion) -> None:
        r.force[0] += a * np.sin(2 * np.pi * (r.time + r.run.clock) / period + phase)

    world.force_hooks.append(hook)
    return {"amplitude_n": a, "period_s": period, "phase_rad": phase, "only_along": "y"}


@effect(
    "a", "force reading", "time in some runs", "the zero jumps by a at 40 to 60 % of every third run: a pulled cable"
)
def zero_jumps(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, moment, first = sign(rng) * (0.06, 0.12, 0.25)[strength], rng.uniform(0.4, 0.6), int(rng.integers(0, 3))

    def hook(r: Readings, m: Motion) -> None:
        if r.run.index % 3 == first:
            r.force[r.run.axis] += a * (r.time > moment * r.time[-1])

    world.force_hooks.append(hook)
    return {"jump_n": a, "at_share_of_run": moment, "runs_modulo_3": float(first)}


@effect(
    "a", "force reading", "run (order of measurement)", "reading = F (1 + a (1 - exp(-n/2))), n = runs before: warm-up"
)
def gain_warms_up(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.05, 0.1, 0.2)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force * (1 + a * (1 - np.exp(-r.run.index / 2)))

    world.force_hooks.append(hook)
    return {"gain_change": a}


@effect("a", "force reading", "sign of the force", "reading = F (1 + a) for F > 0, F (1 - a) for F < 0")
def gain_by_sign(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.04, 0.08, 0.16)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force * (1 + a * np.sign(r.force))

    world.force_hooks.append(hook)
    return {"asymmetry": a}


@effect("a", "force reading", "force and displacement", "reading = F (1 + a g): the lever arm of the sensor changes")
def lever_gain(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.04, 0.08, 0.16)[strength] / MM

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force * (1 + a * r.displacement[r.run.axis])

    world.force_hooks.append(hook)
    return {"gain_per_mm": a * MM}


@effect(
    "a", "force reading", "displacement, not tissue or depth", "reading = F + k g + k3 g^3: a cable acts as a spring"
)
def cable_spring(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    k = (50.0, 100.0, 220.0)[strength]
    k3 = 0.3 * k / MM**2

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force + k * r.displacement + k3 * r.displacement**3

    world.force_hooks.append(hook)
    return {"k_n_per_mm": k * MM, "k3_n_per_mm3": k3 * MM**3}
