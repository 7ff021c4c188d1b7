"""Sessions: their runs, what is hidden in them, and what their channels read without noise."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from background import add_background
from effects import EFFECTS, MM, Effect, Parameters
from physics import SWEEP_AFTER_S, SWEEP_S, Array, Geometry, Motion, Readings, Run, Sweep, World, march

NOISE = {"force_n": 0.02, "displacement_mm": 0.01, "shape_mm": 0.03}

COMBINED = {
    "pair_usual": ("b", "b"),
    "triple_usual": ("b", "b", "b"),
    "pair_mixed": ("a", "b"),
    "triple_mixed": ("a", "b", "b"),
}
ALONE: dict[str, tuple[str, ...]] = {
    "background": (),
    "background_force_noise": ("force_n",),
    "background_displacement_noise": ("displacement_mm",),
    "background_shape_noise": ("shape_mm",),
    "background_all_noise": ("force_n", "displacement_mm", "shape_mm"),
    "background_unstated_noise": ("force_n", "displacement_mm", "shape_mm"),
    "background_any_noise": (),
}
# Noise and sampling that laboratories have: displacement of guide 2, mm; force, N, and rate, Hz, drawn by their logarithms.
ANY_DISPLACEMENT_MM, ANY_FORCE_N, ANY_RATE_HZ = (0.0, 0.1), (0.005, 0.1), (20.0, 1000.0)
PROGRAMS = (
    ((0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0), (0, 2, 3, 5, 7)),
    ((0.0, 0.5, 1.0, 1.4, 0.7, 0.0, -0.7, -1.4, 0.0), (0, 2, 3, 5, 7)),
    ((0.0, 0.6, 1.2, 0.6, -0.6, -1.2, -0.4, 0.0), (0, 1, 2, 4, 5)),
)


@dataclass
class Session:
    """A world, its runs, and what is hidden in it."""

    world: World
    runs: list[Run]
    hidden: list[tuple[Effect, Parameters]]
    background: dict[str, float]
    noise: dict[str, float]


def plan(rng: np.random.Generator) -> list[Run]:
    """Runs in the order of measurement: deeper and deeper, all of y before x, or shuffled."""
    wanted = [(d, a, r) for r in (1, 2) for a in (0,) for d in (15, 22, 30)] + [(22, 1, 1), (30, 1, 1)]
    order = rng.choice(["by depth", "y then x", "shuffled"])
    if order == "by depth":
        wanted.sort(key=lambda w: (w[0], w[1], w[2]))
    elif order == "shuffled":
        wanted = [wanted[i] for i in rng.permutation(len(wanted))]
    levels, sweeps = PROGRAMS[int(rng.integers(len(PROGRAMS)))]
    runs: list[Run] = []
    pause = float(rng.uniform(60, 120))
    for i, (depth, axis, repeat) in enumerate(wanted):
        runs.append(
            Run(
                f"{'yx'[axis]}{depth}-{repeat}",
                i,
                axis,
                depth * MM,
                repeat,
                [r.depth for r in runs],
                i * pause,
                tuple(v * MM for v in levels),
                sweeps,
            )
        )
    return runs


def build(kind: str, seed: int, strength: int, leave_out: frozenset[int] = frozenset()) -> Session:
    """The session of a kind, seed and strength (0 to 2), without the hidden effects whose numbers are left out."""
    tag = zlib.crc32(kind.encode())
    base = np.random.default_rng([seed, tag, 0])
    k0 = float(np.exp(base.uniform(np.log(8e3), np.log(20e3))))
    runs = plan(base)
    world = World(k0, Geometry(), Geometry())
    names = chosen(kind, np.random.default_rng([seed, tag, 1]))
    hidden = []
    for i, name in enumerate(names):
        if i not in leave_out:
            rng = np.random.default_rng([seed, tag, 2, i])
            hidden.append((EFFECTS[name], EFFECTS[name].apply(world, strength, rng)))
    background = add_background(world, np.random.default_rng([seed, tag, 3]))
    noise = dict(NOISE)
    if kind in ALONE:
        rng = np.random.default_rng([seed, tag, 4])
        for channel in ALONE[kind]:
            noise[channel] *= float(
                rng.uniform(1.0, 5.0) if "unstated" in kind or "all" in kind else (2.0, 3.5, 5.0)[strength]
            )
        world.noise_stated = "unstated" not in kind
        if kind == "background_any_noise":
            noise["displacement_mm"] = float(rng.uniform(*ANY_DISPLACEMENT_MM))
            noise["force_n"], rate_hz = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (ANY_FORCE_N, ANY_RATE_HZ))
            for run in runs:
                run.rate_hz = round(rate_hz)
    return Session(world, runs, hidden, background, noise)


def chosen(kind: str, rng: np.random.Generator) -> list[str]:
    """Names of the hidden effects of a kind."""
    if kind in EFFECTS:
        return [kind]
    if kind in ALONE:
        return []
    names: list[str] = []
    for group in COMBINED[kind]:
        free = [
            e.kind
            for e in EFFECTS.values()
            if e.group == group and e.kind not in names and not any(conflict(e.kind, n) for n in names)
        ]
        names.append(str(rng.choice(free)))
    return names


def conflict(one: str, other: str) -> bool:
    """Whether two effects act by the same term, so that they are not two effects in one session."""
    alike = (
        {"anisotropy", "oblique_fibres"},
        {"shape_depth_shift", "stretched_z"},
        {"shape_scale", "scale_by_depth"},
        {"clamp_compliance", "one_sided_clamp", "clamp_loosens", "clamp_slips", "needle_yields"},
        {"axial_load", "tension_builds"},
        {"entry_gap", "skin", "surface_lifts"},
        {"play", "backlash"},
    )
    return any(one in group and other in group for group in alike)


def read(world: World, run: Run) -> Readings:
    """What the channels of a run read, without noise."""
    z = np.linspace(world.stated.entry - 2 * MM, world.geometry.entry + world.depth(run), 45)
    return channels(world, run, march(world, run, z))


def sweep_points(world: World, run: Run) -> list[tuple[int, Array, Array]]:
    """Hold, times and stated positions of the points of each sweep; none lies beyond the tip."""
    points = round(run.depth / MM)
    z = world.stated.entry + np.arange(1, points + 1, dtype=np.float64) * MM
    there = z <= world.geometry.entry + world.depth(run) + 0.2 * MM
    return [
        (i, (run.holds[i].start + SWEEP_AFTER_S + SWEEP_S * np.arange(points) / points)[there], z[there])
        for i in run.sweeps
    ]


def channels(world: World, run: Run, motion: Motion) -> Readings:
    """Readings of a motion; the displacement reading is what the motion program commanded."""
    count = int(round(run.time[-1] * run.rate_hz)) + 1
    time = np.arange(count) / run.rate_hz
    force = np.array([np.interp(time, motion.time, row) for row in motion.force])
    displacement = np.zeros((2, count))
    displacement[run.axis] = np.interp(time, run.time, run.command)
    sweeps = []
    for i, when, z in sweep_points(world, run):
        seen = z
        for change in world.shape_positions:
            seen = change(seen, run)
        sweeps.append(Sweep(i, when, z, motion.look(when, seen)))
    out = Readings(run, time, displacement, force, sweeps)
    for hook in [*world.displacement_hooks, *world.force_hooks, *world.shape_hooks]:
        hook(out, motion)
    return out


def group_of(kind: str) -> str:
    """Set of a kind."""
    return EFFECTS[kind].group if kind in EFFECTS else "c" if kind in COMBINED else "d"


def kinds(group: str | None) -> list[str]:
    """All kinds, or those of a set."""
    every = [*EFFECTS, *COMBINED, *ALONE]
    return [k for k in every if group is None or group_of(k) == group]
