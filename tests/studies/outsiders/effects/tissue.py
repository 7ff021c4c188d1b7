"""Set a, effects in the tissue: its modulus, law, position and support."""

from __future__ import annotations

import numpy as np

from physics import SWEEP_AFTER_S, SWEEP_S, Array, ExtraPoint, Pointwise, Run, SlipBody, Stage, World

from .catalogue import MM, Parameters, bump, effect, sign


@effect("a", "tissue modulus", "depth", "K times 1 + r exp(-(s - s0)^2/(2 w^2))")
def stiff_nodule(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    r, s0, w = (1.5, 3.0, 6.0)[strength], rng.uniform(7, 13) * MM, rng.uniform(1.5, 2.5) * MM
    world.k_profile.append(lambda s, run: 1 + r * bump(s, s0, w))
    return {"ratio": r, "middle_mm": s0 / MM, "sd_mm": w / MM}


@effect("a", "tissue modulus", "depth", "no tissue between two depths (a vessel), full modulus above and below")
def cavity(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    top, height = rng.uniform(5, 8) * MM, (3.0, 5.0, 7.0)[strength] * MM
    world.breaks += [top, top + height]
    world.k_profile.append(lambda s, run: np.where((s > top) & (s < top + height), 1e-3, 1.0))
    return {"top_mm": top / MM, "height_mm": height / MM}


@effect("a", "tissue modulus", "depth", "K times 1 + a sin(2 pi s/p + phase): fibre bundles")
def fibre_bundles(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, p, phase = (0.35, 0.6, 0.9)[strength], rng.uniform(9, 14) * MM, rng.uniform(0, 2 * np.pi)
    world.k_profile.append(lambda s, run: 1 + a * np.sin(2 * np.pi * s / p + phase))
    return {"amplitude": a, "period_mm": p / MM, "phase_rad": phase}


@effect("a", "tissue modulus", "run (order of measurement)", "K times floor + (1 - floor) exp(-run/n): wear")
def softens_with_use(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    floor, n = (0.85, 0.7, 0.5)[strength], rng.uniform(2, 4)
    world.k_profile.append(lambda s, run: np.full_like(s, floor + (1 - floor) * np.exp(-run.index / n)))
    return {"floor": floor, "runs": n}


@effect(
    "a",
    "tissue modulus",
    "depth and time since the session's start",
    "K times 1 + a (t/1000 s) exp(-s/s0): the gel dries from its surface",
)
def dries_from_surface(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, s0 = (1.0, 2.0, 4.0)[strength], rng.uniform(3, 6) * MM
    world.k_profile.append(lambda s, run: 1 + a * run.clock / 1000 * np.exp(-s / s0))
    return {"growth_per_1000s": a, "depth_mm": s0 / MM}


@effect(
    "a",
    "tissue modulus",
    "depth and the depths of earlier runs",
    "K times (1 - a) per earlier insertion that reached the depth: an old track is softer",
)
def old_track(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = (0.05, 0.09, 0.15)[strength]

    def factor(s: Array, run: Run) -> Array:
        return np.prod([np.where(s < p, 1 - a, 1.0) for p in run.passes], axis=0) if run.passes else np.ones_like(s)

    world.breaks += [15 * MM, 22 * MM]
    world.k_profile.append(factor)
    return {"loss_per_pass": a}


class Mullins(Stage):
    """Stiffness falls with the largest displacement that a depth has ever seen; kept on a grid over all runs."""

    rate = True  # a step feels the largest displacement of the steps before

    def __init__(self, loss: float, scale: float) -> None:
        self.loss, self.scale = loss, scale
        self.grid = np.linspace(0, 40 * MM, 81)
        self.largest = [np.zeros(81), np.zeros(81)]

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """Read the largest displacements of earlier runs at the depths of this one."""
        self.s = s
        self.axes = [run.axis] if axes == 1 else [0, 1]
        self.seen = np.array([np.interp(s, self.grid, self.largest[a]) for a in self.axes])

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Softened displacement and its derivative."""
        factor = 1 - self.loss * (1 - np.exp(-self.seen / self.scale))
        return value * factor, factor

    def commit(self, value: Array, dt: float) -> None:
        """Keep the largest displacement, for this run and those after it."""
        self.seen = np.maximum(self.seen, np.abs(value))
        for row, a in zip(self.seen, self.axes):
            reached = self.grid <= self.s[-1]
            update = np.interp(self.grid, self.s, row)
            self.largest[a] = np.where(reached, np.maximum(self.largest[a], update), self.largest[a])


@effect(
    "a",
    "tissue law",
    "largest displacement so far at the same depth",
    "p = K e (1 - a (1 - exp(-max|e|/e0))), the maximum kept over all runs (Mullins)",
)
def mullins(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, e0 = (0.25, 0.45, 0.65)[strength], rng.uniform(0.4, 0.8) * MM
    world.strain.append(Mullins(a, e0))
    return {"loss": a, "scale_mm": e0 / MM}


class Tear(Stage):
    """Where a limit was exceeded within a run, most of the stiffness is gone for the rest of it."""

    rate = True  # a step feels the tears of the steps before

    def __init__(self, limit: float, left: float) -> None:
        self.limit, self.left = limit, left

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """Nothing is torn yet."""
        self.torn = np.zeros((axes, len(s)), dtype=bool)

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Displacement, less where the bond is torn."""
        factor = np.where(self.torn, self.left, 1.0)
        return value * factor, factor

    def commit(self, value: Array, dt: float) -> None:
        """Tear where the limit is exceeded."""
        self.torn |= np.abs(value) > self.limit


@effect(
    "a",
    "tissue law",
    "displacement, irreversible within a run",
    "p = K e until |e| first exceeds e0 at a depth, then p = r K e there: the bond tears",
)
def bond_tears(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    limit, left = rng.uniform(1.05, 1.2) * MM, (0.85, 0.7, 0.5)[strength]
    world.strain.append(Tear(limit, left))
    return {"limit_mm": limit / MM, "left": left}


class Plastic(Stage):
    """Elastic up to a displacement, then perfectly plastic with a little hardening."""

    def __init__(self, limit: float, hardening: float) -> None:
        self.limit, self.hardening = limit, hardening

    def begin(self, run: Run, s: Array, axes: int) -> None:
        """No plastic displacement yet."""
        self.set = np.zeros((axes, len(s)))

    def _trial(self, value: Array) -> tuple[Array, Array]:
        h = self.hardening
        trial = value - self.set
        beyond = np.abs(trial - h * self.set / (1 - h)) - self.limit
        step = np.where(beyond > 0, beyond * (1 - h) * np.sign(trial - h * self.set / (1 - h)), 0.0)
        return trial - step, step

    def apply(self, value: Array, dt: float) -> tuple[Array, Array]:
        """Elastic displacement and its derivative."""
        elastic, step = self._trial(value)
        return elastic, np.where(step != 0.0, self.hardening, 1.0)

    def commit(self, value: Array, dt: float) -> None:
        """Keep the plastic displacement."""
        self.set = self.set + self._trial(value)[1]


@effect(
    "a",
    "tissue law",
    "displacement and its history",
    "elastic-plastic: p = K (e - e_p), yield at |p| = K e_y with kinematic hardening of 10 %",
)
def plastic_gel(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    limit = (1.3, 1.1, 0.85)[strength] * MM
    world.strain.append(Plastic(limit, 0.1))
    return {"yield_mm": limit / MM, "hardening": 0.1}


@effect("a", "tissue law", "sign of the displacement", "K (1 + a) for e > 0, K (1 - a) for e < 0")
def one_side_stiffer(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.07, 0.15, 0.3)[strength]
    smooth = 0.02 * MM

    def law(e: Array, s: Array, run: Run) -> tuple[Array, Array]:
        t = np.tanh(e / smooth)
        return e * (1 + a * t), 1 + a * t + a * e * (1 - t**2) / smooth

    world.strain.append(Pointwise(law))
    return {"asymmetry": a}


@effect(
    "a",
    "tissue law",
    "displacement, all depths",
    "no force for |e| < c, then K (|e| - c): the needle lies in a channel wider than itself",
)
def loose_channel(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    c = (0.06, 0.12, 0.25)[strength] * MM
    smooth = 0.01 * MM

    def law(e: Array, s: Array, run: Run) -> tuple[Array, Array]:
        up, down = (e - c) / smooth, (-e - c) / smooth
        value = smooth * (np.logaddexp(0, up) - np.logaddexp(0, down))
        return value, 1 / (1 + np.exp(-np.clip(up, -60, 60))) + 1 / (1 + np.exp(-np.clip(down, -60, 60)))

    world.strain.append(Pointwise(law))
    return {"clearance_mm": c / MM}


@effect("a", "tissue position", "time", "the tissue moves by a sin(2 pi t/T) exp(-s/40 mm): breathing")
def breathing(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, period = (0.12, 0.25, 0.5)[strength] * MM, rng.uniform(3.5, 6.0)
    angle, phase = rng.uniform(-0.4, 0.4), rng.uniform(0, 2 * np.pi)

    def move(s: Array, t: float, run: Run) -> Array:
        now = a * np.sin(2 * np.pi * (t + run.clock) / period + phase) * np.exp(-s / 0.04)
        return np.outer([np.cos(angle), np.sin(angle)], now)

    world.anchors.append(move)
    world.two_axes = True
    return {"amplitude_mm": a / MM, "period_s": period, "angle_to_y_rad": angle}


@effect(
    "a",
    "tissue position",
    "total force and time, irreversible",
    "the whole block creeps on its tray at v (|P|/P0 - 1) while the total force |P| > P0; put back before each run",
)
def block_slides(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    threshold, speed = (0.14, 0.10, 0.07)[strength], 0.04 * MM

    world.slips.append(SlipBody(threshold, speed))
    return {"threshold_n": threshold, "speed_mm_per_s": speed / MM}


@effect("a", "tissue support", "total force", "the block stands on foam: it shifts by P/k and turns by M/c")
def floating_block(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    k = (3000.0, 1500.0, 600.0)[strength]
    turn = k * 0.04**2 / 3

    def support(s: Array, run: Run) -> Array:
        arm = s - 0.025
        return np.full((len(s), len(s)), 1 / k) + np.outer(arm, arm) / turn

    world.support.append(support)
    return {"shift_n_per_m": k, "turn_n_m_per_rad": turn}


@effect(
    "a", "tip of the needle", "depth of the tip", "from 26 mm on the tip stands in a hard body: spring k_t at the tip"
)
def tip_in_bone(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    k = (60.0, 150.0, 500.0)[strength]
    world.extra.append(
        ExtraPoint(
            lambda run, length: length if run.depth > 26 * MM else None, lambda u, t, run: (-k * u, np.full(2, -k))
        )
    )
    return {"tip_spring_n_per_m": k, "from_depth_mm": 26.0}


@effect(
    "a",
    "tissue law",
    "displacement to one side, depth",
    "a hard wall beside the needle at distance b between two depths; contact spring 30 kPa, to one side only",
)
def wall_beside(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    b, side, top = (1.0, 0.85, 0.65)[strength] * MM, sign(rng), rng.uniform(4, 8) * MM
    smooth = 0.01 * MM

    def law(e: Array, s: Array, run: Run) -> tuple[Array, Array]:
        along_y = np.array([[1.0], [0.0]]) if len(e) == 2 else np.array([[1.0 - run.axis]])
        near = along_y * (30e3 / world.k0 * ((s > top) & (s < top + 8 * MM)))
        x = (side * e - b) / smooth
        more = smooth * np.logaddexp(0, x)
        return e + side * near * more, 1 + near / (1 + np.exp(-np.clip(x, -60, 60)))

    world.strain.append(Pointwise(law))
    return {"distance_mm": b / MM, "side": side, "from_mm": top / MM, "to_mm": top / MM + 8, "only_along": "y"}


@effect(
    "a",
    "tissue law",
    "direction: pushes along y give forces along x",
    "stiffness with principal axes turned by 30 degrees: K_yx = (K_1 - K_2) sin 30 cos 30",
)
def oblique_fibres(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    ratio, angle = (1.15, 1.4, 2.0)[strength], np.pi / 6 * sign(rng)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    tensor = turn @ np.diag([np.sqrt(ratio), 1 / np.sqrt(ratio)]) @ turn.T
    world.tensor = tensor if world.tensor is None else 0.5 * (tensor @ world.tensor + world.tensor @ tensor)
    world.two_axes = True
    return {
        "ratio": ratio,
        "angle_rad": angle,
        "k_along_y_ratio": float(tensor[0, 0]),
        "k_along_x_ratio": float(tensor[1, 1]),
    }


@effect(
    "a", "tissue law", "depth and displacement", "the surface lifts off: tissue above depth a |e|/(1 mm) bears nothing"
)
def surface_lifts(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a, smooth = (1.5, 3.0, 6.0)[strength], 0.5 * MM

    def law(e: Array, s: Array, run: Run) -> tuple[Array, Array]:
        x = (s - a * np.sqrt(e**2 + 1e-10)) / smooth
        bears = 1 / (1 + np.exp(-np.clip(x, -60, 60)))
        slope = bears * (1 - bears) * (-a * e / np.sqrt(e**2 + 1e-10)) / smooth
        return e * bears, bears + e * slope

    world.strain.append(Pointwise(law))
    return {"lift_mm_per_mm": a}


@effect(
    "a",
    "tissue position during images",
    "time and place of the probe",
    "the imaging probe pushes the tissue below it by a exp(-(z - z_probe)^2/(2 (8 mm)^2)) while it sweeps",
)
def probe_pushes(world: World, strength: int, rng: np.random.Generator) -> Parameters:
    a = sign(rng) * (0.1, 0.2, 0.4)[strength] * MM

    def move(s: Array, t: float, run: Run) -> Array:
        out = np.zeros((2, len(s)))
        for i in run.sweeps:
            begin = run.holds[i].start + SWEEP_AFTER_S
            if begin - 0.3 <= t <= begin + SWEEP_S + 0.3:
                probe = run.depth * np.clip((t - begin) / SWEEP_S, 0, 1)
                out[0] = a * bump(s, probe, 8 * MM)
        return out

    world.anchors.append(move)
    world.two_axes = True
    return {"push_mm": a / MM, "width_mm": 8.0}
