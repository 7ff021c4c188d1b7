"""Set b, usual effects."""

from __future__ import annotations

import numpy as np

from physics import Array, Motion, Pointwise, Readings, Run, Stage, World

from .catalogue import MM, Parameters, effect, play_operator, sign


@effect("b", "tissue modulus", "depth", "K above a boundary, r K below")
def layers(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r, b = (1.5, 2.2, 3.5)[strength] ** sign(rng), rng.uniform(8, 13) * MM
    world.breaks.append(b)
    world.k_profile.append(lambda s, run: np.where(s < b, 1.0, r))
    return {"ratio": r, "boundary_mm": b / MM}


@effect("b", "tissue modulus", "depth", "K (1 + a s/(20 mm))")
def gradient(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = (0.4, 0.8, 1.6)[strength]
    world.k_profile.append(lambda s, run: 1 + a * s / (20 * MM))
    return {"growth_per_20mm": a}


@effect("b", "tissue modulus", "depth", "r K over a thin skin at the surface")
def skin(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r, h = (4.0, 7.0, 14.0)[strength], rng.uniform(1.0, 2.0) * MM
    world.breaks.append(h)
    world.k_profile.append(lambda s, run: np.where(s < h, r, 1.0))
    return {"ratio": r, "thickness_mm": h / MM}


@effect("b", "tissue law", "displacement", "p = K e (1 + (e/e0)^2)")
def stiffening(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    e0 = (3.0, 2.2, 1.5)[strength] * MM
    world.strain.append(Pointwise(lambda e, s, run: (e * (1 + (e / e0) ** 2), 1 + 3 * (e / e0) ** 2)))
    return {"scale_mm": e0 / MM}


class Maxwell(Stage):
    """Standard linear solid: a share of the force relaxes with one time constant."""

    rate = True

    def __init__(self, fraction: float, tau: float) -> None:
        self.fraction, self.tau = fraction, tau

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """The branch is relaxed."""
        self.branch = np.zeros((axes, len(s)))
        self.last = np.zeros((axes, len(s)))

    def _branch(self, value: Array, dt: float) -> tuple[Array, float]:
        x = dt / self.tau
        factor = (1 - np.exp(-x)) / x if x > 0 else 1.0
        return np.exp(-x) * self.branch + factor * (value - self.last), factor

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Force with its relaxing fraction, and the derivative."""
        branch, factor = self._branch(value, dt)
        return (1 - self.fraction) * value + self.fraction * branch, np.full_like(
            value, 1 - self.fraction * (1 - factor)
        )

    def commit(self, value: Array, dt: float) -> None:
        """Keep the force of the branch."""
        self.branch = self._branch(value, dt)[0]
        self.last = value.copy()


@effect(
    "b", "tissue law", "time", "a share of the tissue's force relaxes with a time constant; K is the modulus at once"
)
def relaxation(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, tau = (0.12, 0.22, 0.4)[strength], rng.uniform(1.5, 5)
    world.stress.append(Maxwell(a, tau))
    return {"share": a, "time_s": tau}


@effect(
    "b",
    "tissue law",
    "curvature of the displacement over depth",
    "p = K u - G u'' with G = K l^2 (Pasternak); the layer goes on below the tip",
)
def shear(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    length = (6.0, 10.0, 16.0)[strength] * MM
    world.shear = world.k0 * length**2
    return {"g_n": world.shear, "length_mm": length / MM}


@effect("b", "tissue modulus", "depth", "no contact over the first part below the surface")
def entry_gap(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    h = (2.0, 3.5, 6.0)[strength] * MM
    world.breaks.append(h)
    world.k_profile.append(lambda s, run: np.where(s < h, 1e-3, 1.0))
    return {"gap_mm": h / MM}


@effect("b", "tissue modulus", "direction", "K along y, r K along x")
def anisotropy(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r = (1.25, 1.6, 2.2)[strength] ** sign(rng)
    world.tensor = np.diag([1.0, r]) if world.tensor is None else world.tensor * np.sqrt(np.outer([1, r], [1, r]))
    return {"ratio_x": r}


@effect("b", "clamp", "moment", "the clamp turns by c M")
def clamp_compliance(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    c = (0.08, 0.2, 0.5)[strength]
    world.clamp.append(lambda run: c)
    return {"compliance_rad_per_n_m": c}


@effect("b", "frame", "force", "guide 2 stays behind its reading by c F")
def frame_compliance(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    c = (0.06, 0.15, 0.35)[strength] * MM
    world.frame += c
    return {"compliance_mm_per_n": c / MM}


@effect("b", "motion of guide 2", "history of the displacement", "guide 2 follows its reading with lost motion of +-b")
def backlash(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = (0.04, 0.08, 0.15)[strength] * MM
    world.motion.append(lambda run, g: np.array([play_operator(row, b) for row in g]))
    return {"half_width_mm": b / MM}


@effect("b", "guide 2", "sign of the force", "the needle has play of +-b in guide 2")
def play(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = (0.04, 0.08, 0.15)[strength] * MM
    world.play += b
    return {"half_gap_mm": b / MM}


@effect(
    "b",
    "force reading",
    "direction of the motion",
    "friction in the guide adds f0 times the direction of the last motion",
)
def friction(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    f0, slip = (0.04, 0.08, 0.16)[strength], 0.02 * MM

    def hook(r: Readings, m: Motion) -> None:
        for a in range(2):
            g = np.interp(r.time, m.time, m.guide[a])
            r.force[a] += f0 * (g - play_operator(g, slip)) / slip

    world.force_hooks.append(hook)
    return {"friction_n": f0, "slip_mm": slip / MM}


@effect("b", "force reading", "nothing", "reading = F + b")
def force_bias(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = sign(rng) * (0.05, 0.1, 0.2)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force[0] += b

    world.force_hooks.append(hook)
    return {"bias_y_n": b}


@effect("b", "force reading", "force", "reading = (1 + a) F")
def force_gain(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.05, 0.1, 0.2)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force * (1 + a)

    world.force_hooks.append(hook)
    return {"gain": a}


@effect("b", "force reading", "time within a run", "reading = F + a t")
def force_drift(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.002, 0.004, 0.008)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force[0] += a * r.time

    world.force_hooks.append(hook)
    return {"drift_y_n_per_s": a}


@effect("b", "force reading", "force along the other axis", "F_x reads + a F_y and F_y reads + a F_x")
def force_crosstalk(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.06, 0.12, 0.25)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = r.force + a * r.force[::-1]

    world.force_hooks.append(hook)
    return {"share": a}


@effect("b", "force reading", "time", "the force is read late")
def force_delay(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    late = (0.15, 0.3, 0.6)[strength]

    def hook(r: Readings, m: Motion) -> None:
        r.force = np.array([np.interp(r.time - late, r.time, row) for row in r.force])

    world.force_hooks.append(hook)
    return {"delay_s": late}


@effect("b", "shape reading", "nothing", "reading = u + b")
def shape_offset(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = sign(rng) * (0.08, 0.16, 0.3)[strength] * MM

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection[0] += b

    world.shape_hooks.append(hook)
    return {"offset_y_mm": b / MM}


@effect("b", "shape reading", "deflection", "reading = (1 + a) u")
def shape_scale(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.05, 0.1, 0.2)[strength]

    def hook(r: Readings, m: Motion) -> None:
        for sweep in r.sweeps:
            sweep.deflection *= 1 + a

    world.shape_hooks.append(hook)
    return {"scale": a}


@effect("b", "shape reading", "place along the needle", "the shape at stated z is that at z + b")
def shape_depth_shift(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = sign(rng) * (1.5, 3.0, 5.0)[strength] * MM
    world.shape_positions.append(lambda z, run: z + b)
    return {"shift_mm": b / MM}


@effect("b", "needle", "nothing", "bending stiffness times r")
def needle_stiffness(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r = (1.08, 1.16, 1.35)[strength] ** sign(rng)
    world.bending.append(lambda z, run, length: np.full_like(z, r))
    return {"ratio": r}


@effect("b", "needle", "place along the needle", "the unloaded needle has the shape b (z/100 mm)^2 along y")
def prebend(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b = sign(rng) * (0.3, 0.6, 1.2)[strength] * MM
    world.free_shape.append(lambda z, length: np.stack([b * (z / 0.1) ** 2, 0 * z]))
    world.two_axes = True
    return {"bend_at_100mm_mm": b / MM}


@effect("b", "needle", "slope", "compressive load N along the whole needle")
def axial_load(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    n = sign(rng) * (0.8, 1.6, 3.0)[strength]
    world.axial.append(lambda run: n)
    return {"load_n": n}
