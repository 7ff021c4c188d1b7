"""How much the hidden effects of a session can be seen, and the moduli that a lab may mean by K.

`removable_chi2` compares two predictions without noise, both with the same background: the world as it is, and the
plain world (no hidden effect, geometry as stated) led by the displacement that was read, its K rescaled by least
squares. It is the sum over all runs of the squared differences over the variances of the stated noise: force in
blocks of 0.25 s within holds (variance of the block's mean, the noise of the displacement included), and every point
of the shapes. `removable_chi2_repeats` is the part of it in the repeats, the runs that a diagnosis would hold out;
`removable_chi2_moving` is the same as the first of the blocks during ramps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from effects import MM
from physics import Array, Motion, Readings, Run, Sweep, march
from sessions import Session, build, read, sweep_points

BLOCK_S = 0.25


class Plain:
    """The plain world of a session, which is linear: responses per run to unit displacement, by the scale of K."""

    def __init__(self, session: Session, kind: str, seed: int, strength: int) -> None:
        self.bare = build(kind, seed, strength, frozenset(range(9)))
        self.runs = session.runs
        self.cache: dict[tuple[float, float], tuple[float, Array, Array]] = {}
        self.added: dict[int, tuple[Array, list[Array]]] = {}

    def unit(self, run: Run, scale: float) -> tuple[float, Array, Array]:
        """Force per displacement [N/m], positions, deflections per displacement."""
        key = (run.depth, scale)
        if key not in self.cache:
            world = replace(self.bare.world, k0=self.bare.world.k0 * scale)
            short = replace(run, axis=0, levels=(1 * MM,), sweeps=(), hold_s=0.1, holds=[])
            z = np.linspace(world.stated.entry - 2 * MM, world.geometry.entry + run.depth, 45)
            motion = march(world, short, z)
            self.cache[key] = (float(motion.force[0, 0] / MM), motion.z, motion.deflection[0, 0] / MM)
        return self.cache[key]

    def read(self, run: Run, scale: float, displacement: Array) -> Readings:
        """Readings of the plain world led by a displacement (2, samples)."""
        stiffness, z, shape = self.unit(run, scale)
        world = self.bare.world
        time = np.arange(displacement.shape[1]) / run.rate_hz
        nothing = np.zeros((2, len(time)))
        empty = np.zeros((2, 0, 0))
        motion = Motion(run, time, nothing, nothing, z, empty, z, empty, empty, np.zeros(0))
        zero = Readings(run, time, nothing, nothing, [])
        for hook in world.displacement_hooks:  # what the background adds to the reading has not moved anything
            hook(zero, motion)
        moved = displacement - zero.displacement
        spline = CubicSpline(z, shape, bc_type="natural")
        sweeps = []
        for i, when, z_points in sweep_points(world, run):
            led = np.array([np.interp(when, time, row) for row in moved])
            sweeps.append(Sweep(i, when, z_points, led * spline(z_points)))
        out = Readings(run, time, displacement, stiffness * moved, sweeps)
        if run.index not in self.added:  # the background's readings hardly depend on the scale of K
            before = (out.force.copy(), [s.deflection.copy() for s in sweeps])
            for hook in [*world.force_hooks, *world.shape_hooks]:
                hook(out, motion)
            self.added[run.index] = (out.force - before[0], [s.deflection - b for s, b in zip(sweeps, before[1])])
            return out
        force, shapes = self.added[run.index]
        out.force = out.force + force
        for sweep, more in zip(out.sweeps, shapes):
            sweep.deflection = sweep.deflection + more
        return out


def compare(
    run: Run, one: Readings, other: Readings, noise: dict[str, float], stiffness: float, by: np.ndarray
) -> tuple[Array, Array, Array]:
    """Differences of two readings over their noise: force blocks in holds, force blocks in ramps, shape points.

    by: displacement (2, samples) by which the two differ in their reading beyond what `other` was led by.
    """
    size = int(round(BLOCK_S * run.rate_hz))
    count = one.force.shape[1] // size
    sd = np.hypot(noise["force_n"], stiffness * noise["displacement_mm"] * MM) / np.sqrt(size)
    delta = (one.force - other.force - stiffness * by)[:, : count * size].reshape(2, count, size).mean(axis=2) / sd
    begin = np.arange(count) * BLOCK_S
    held = np.zeros(count, dtype=bool)
    for hold in run.holds:
        held |= (begin >= hold.start - 1e-9) & (begin + BLOCK_S <= hold.end + 1e-9)
    shapes = [
        ((a.deflection[:, :n] - b.deflection[:, :n]) / (noise["shape_mm"] * MM)).ravel()
        for a, b in zip(one.sweeps, other.sweeps)
        for n in [min(len(a.z), len(b.z))]
    ]
    return delta[:, held].ravel(), delta[:, ~held].ravel(), np.concatenate(shapes)


def visibility(session: Session, seen: list[Readings], kind: str, seed: int, strength: int) -> dict[str, object]:
    """Chi-square that the hidden effects cause, the scale of K of the plain world, and where it is largest."""
    plain = Plain(session, kind, seed, strength)
    nothing = np.zeros((2, 1))

    def difference(scale: float) -> tuple[Array, Array, Array]:
        parts = [
            compare(
                r.run, r, plain.read(r.run, scale, r.displacement), session.noise, plain.unit(r.run, scale)[0], nothing
            )
            for r in seen
        ]
        return (
            np.concatenate([p[0] for p in parts]),
            np.concatenate([p[1] for p in parts]),
            np.concatenate([p[2] for p in parts]),
        )

    log_scale, step = 0.0, 0.02
    for _ in range(5):
        here = np.concatenate(difference(float(np.exp(log_scale)))[::2])
        there = np.concatenate(difference(float(np.exp(log_scale + step)))[::2])
        slope = (there - here) / step
        change = float(np.clip(-(slope @ here) / (slope @ slope), -0.7, 0.7))
        log_scale = float(np.clip(log_scale + change, -3, 3))
        if abs(change) < 1e-3:
            break
    scale = float(np.exp(log_scale))
    held, moving, shape = difference(scale)
    repeats = 0.0
    for r in seen:
        if r.run.repeat > 1:
            repeat = compare(
                r.run, r, plain.read(r.run, scale, r.displacement), session.noise, plain.unit(r.run, scale)[0], nothing
            )
            repeats += float(repeat[0] @ repeat[0] + repeat[2] @ repeat[2])
    out: dict[str, object] = {
        "removable_chi2": float(held @ held + shape @ shape),
        "removable_chi2_force": float(held @ held),
        "removable_chi2_shape": float(shape @ shape),
        "removable_chi2_repeats": repeats,
        "removable_chi2_moving": float(moving @ moving),
        "readings": len(held) + len(shape),
        "largest_force_n": float(np.abs(held).max() * session.noise["force_n"] / np.sqrt(BLOCK_S * 100)),
        "largest_shape_mm": float(np.abs(shape).max() * session.noise["shape_mm"]),
        "k_scale_of_plain_world": scale,
    }
    if len(session.hidden) > 1:
        direction = slope / np.sqrt(slope @ slope)
        each = []
        for i in range(len(session.hidden)):
            without = build(kind, seed, strength, frozenset({i}))
            parts = []
            for r in seen:
                other = read(without.world, without.runs[r.run.index])
                by = r.displacement - other.displacement
                stiffness = plain.unit(r.run, scale)[0]
                parts.append(compare(r.run, r, other, session.noise, stiffness, by))
            v = np.concatenate([np.concatenate([p[0] for p in parts]), np.concatenate([p[2] for p in parts])])
            if len(v) == len(direction):
                each.append(float(v @ v - (v @ direction) ** 2))
            else:
                each.append(float(v @ v))
        out["removable_chi2_each"] = each
    return out


def moduli(session: Session, scale: float) -> dict[str, float | None]:
    """Moduli that a lab may mean by K, in kPa, along y and at small displacement."""
    world, runs = session.world, session.runs
    equivalent = world.k0 * scale / 1e3
    if world.body is not None:
        return {"k_mean_kpa": None, "k_surface_kpa": None, "k_equivalent_kpa": equivalent}
    s = np.linspace(0, max(world.depth(r) for r in runs), 601)
    along_y = 1.0 if world.tensor is None else float(world.tensor[0, 0])
    first, last = (world.modulus(s, r) * along_y / 1e3 for r in (runs[0], runs[-1]))
    every = np.mean([world.modulus(s, r).mean() for r in runs]) * along_y / 1e3
    out: dict[str, float | None] = {
        "k_mean_kpa": float(every),
        "k_surface_kpa": float(first[0]),
        "k_first_run_kpa": float(first.mean()),
        "k_last_run_kpa": float(last.mean()),
        "k_equivalent_kpa": equivalent,
        "k_base_kpa": world.k0 / 1e3,
    }
    for effect, parameters in session.hidden:
        if effect.kind == "relaxation":
            out["k_relaxed_kpa"] = float(every) * (1 - float(parameters["share"]))
    return out
