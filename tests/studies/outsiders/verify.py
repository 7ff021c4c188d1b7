"""Checks of the mechanics against closed forms; prints one line per check and fails if one is off."""

from __future__ import annotations

import numpy as np

from physics import Beam, Geometry, Hinge, Pointwise, Run, World, body_stiffness, gauss_points, march, mindlin


def run_of(depth: float, axis: int = 0) -> Run:
    """A short run with one level of 1.2 mm."""
    return Run("check", 0, axis, depth, 1, [], 0.0, (0.0, 1.2e-3, 0.0), (1,))


def check(name: str, value: float, limit: float) -> None:
    """Print and fail above the limit."""
    print(f"{name:75s} {value:9.2e}  limit {limit:.0e}")
    assert value < limit, name


def infinite_beam() -> None:
    """Hetenyi: an infinite beam under a point load P, u = P b/(2 K) exp(-b x)(cos b x + sin b x)."""
    ei, k = 0.0157222, 16e3
    b = (k / (4 * ei)) ** 0.25
    length = 1.2
    beam = Beam(length, [length / 2], lambda z: np.full_like(z, ei), fine=5e-3)
    s, w = gauss_points(length, [length / 2], 5e-3)
    rows = beam.rows(np.append(s, length / 2))
    c = rows @ beam.inverse @ rows.T
    u = np.linalg.solve(np.eye(len(s)) + c[:-1, :-1] * (k * w)[None, :], c[:-1, -1])
    x = np.abs(s - length / 2)
    exact = b / (2 * k) * np.exp(-b * x) * (np.cos(b * x) + np.sin(b * x))
    middle = x < 0.3
    check(
        "infinite beam on springs (Hetenyi), largest error / largest deflection",
        float(np.abs(u - exact)[middle].max() / exact.max()),
        1e-5,
    )


def cantilever() -> None:
    """In air guide 2 pushes a cantilever: F = 3 EI g / c^3, and with a turning clamp the series of both."""
    g = Geometry()
    for compliance in (0.0, 0.3):
        world = World(1e-6, g, g)
        if compliance:
            world.clamp.append(lambda run: compliance)
        motion = march(world, run_of(20e-3), np.array([80e-3]))
        c = g.guide2
        exact = 1.2e-3 / (c**3 / (3 * g.bending) + compliance * c**2)
        check(f"cantilever in air, clamp compliance {compliance}", abs(motion.force[0].max() / exact - 1), 1e-6)


def finite_beam() -> None:
    """The clamped beam on springs as a boundary-value problem solved piecewise in closed form."""
    g, k, depth, push = Geometry(), 16e3, 30e-3, 1.2e-3
    ei = g.bending
    b = (k / (4 * ei)) ** 0.25
    c2, c = g.guide2, g.entry

    def poly(z: float, d: int) -> np.ndarray:
        return np.array([np.prod(np.arange(p, p - d, -1)) * z ** (p - d) if p >= d else 0.0 for p in range(4)])

    def inside(s: float, d: int) -> np.ndarray:
        out = []
        for root in (b * (1 + 1j), b * (-1 + 1j)):
            value = root**d * np.exp(root * s)
            out += [value.real, value.imag]
        return np.array(out)

    system, right = np.zeros((12, 12)), np.zeros(12)
    system[0, :4], system[1, :4] = poly(0, 0), poly(0, 1)
    system[2, :4], right[2] = poly(c2, 0), push
    for i, d in enumerate((0, 1, 2)):
        system[3 + i, :4], system[3 + i, 4:8] = poly(c2, d), -poly(c2, d)
    for i, d in enumerate((0, 1, 2, 3)):
        system[6 + i, 4:8], system[6 + i, 8:] = poly(c, d), -inside(0.0, d)
    system[10, 8:], system[11, 8:] = inside(depth, 2), inside(depth, 3)
    scale = np.abs(system).max(axis=1)
    coefficients = np.linalg.solve(system / scale[:, None], right / scale)
    exact_force = ei * (poly(c2, 3) @ coefficients[4:8] - poly(c2, 3) @ coefficients[:4])
    z = np.linspace(1e-3, depth, 30)
    exact = np.array([inside(x, 0) @ coefficients[8:] for x in z])
    motion = march(World(k, g, g), run_of(depth), c + z)
    top = int(np.argmax(motion.force[0]))
    check("clamped beam, 30 mm in springs: force of guide 2", abs(motion.force[0, top] / exact_force - 1), 1e-6)
    check("clamped beam, 30 mm in springs: shape", float(np.abs(motion.deflection[0, top] - exact).max()) / push, 1e-6)
    work = 0.5 * motion.force[0, top] * push
    stored = motion.energy[top] + 0.5 * float(motion.relative[0, top] @ motion.tissue[0, top])
    check("energy: work of guide 2 against bending and springs", abs(stored / work - 1), 1e-8)


def incremental_energy() -> None:
    """A stiffening tissue: the work integral of guide 2 along the ramp equals the stored energy."""
    g, k, soft = Geometry(), 12e3, 0.8e-3
    world = World(k, g, g)
    world.strain.append(Pointwise(lambda e, s, run: (e * (1 + (e / soft) ** 2), 1 + 3 * (e / soft) ** 2)))
    motion = march(world, run_of(22e-3), np.array([71e-3]))
    top = int(np.argmax(motion.guide[0]))
    f, u = motion.force[0, : top + 1], motion.guide[0, : top + 1]
    work = float(np.trapezoid(f, u))
    e, q = motion.relative[0, top], motion.tissue[0, top]
    weight_k = q / (e * (1 + (e / soft) ** 2))
    stored = motion.energy[top] + float(np.sum(weight_k * (e**2 / 2 + e**4 / (4 * soft**2))))
    check("energy: stiffening tissue, work along the ramp (trapezoids)", abs(work / stored - 1), 2e-3)


def axial() -> None:
    """Buckling: the flexibility of a cantilever grows as 1/(1 - P/P_E) towards P_E = pi^2 EI/(4 L^2) (within 2 %)."""
    ei, length = 0.0157, 0.1
    euler = np.pi**2 * ei / (4 * length**2)
    tip = []
    for load in (0.0, 0.5 * euler):
        beam = Beam(length, [], lambda z: np.full_like(z, ei), axial=load)
        row = beam.rows(np.array([length]))
        tip.append(float((row @ beam.inverse @ row.T)[0, 0]))
    kl = np.pi / 2 * np.sqrt(0.5)
    exact = 3 * (np.tan(kl) - kl) / kl**3
    check("cantilever under half its buckling load: tip flexibility", abs(tip[1] / tip[0] / exact - 1), 1e-6)


class _Spring(Hinge):
    """A rotational spring of 1/compliance in the needle."""

    def __init__(self, z: float, compliance: float) -> None:
        super().__init__(lambda run, length: z)
        self.compliance = compliance

    def law(self, moment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation in proportion to the moment."""
        return self.compliance * moment, np.full_like(moment, self.compliance)


def hinges() -> None:
    """A hinge at the clamp equals a compliant clamp; a hinge half-way to guide 2 the series of both."""
    g = Geometry()
    by_hinge, by_clamp = World(12e3, g, g), World(12e3, g, g)
    by_hinge.hinges.append(_Spring(0.0, 0.2))
    by_clamp.clamp.append(lambda run: 0.2)
    f = [march(w, run_of(25e-3), np.array([71e-3])).force[0].max() for w in (by_hinge, by_clamp)]
    check("hinge at the clamp against the compliant clamp", abs(f[0] / f[1] - 1), 1e-6)
    air = World(1e-6, g, g)
    air.hinges.append(_Spring(0.03, 0.2))
    c = g.guide2
    exact = 1.2e-3 / (c**3 / (3 * g.bending) + 0.2 * (c - 0.03) ** 2)
    motion = march(air, run_of(20e-3), np.array([80e-3]))
    check("cantilever in air with a hinge", abs(motion.force[0].max() / exact - 1), 1e-4)


def bodies() -> None:
    """Mindlin: far below the surface Kelvin's solution, at the surface Cerruti's; long line against the plane strain
    trend; reciprocity; grid independence of the pooled stiffness."""
    nu = 0.45
    far = mindlin(np.array(10.0), np.array(10.001), 1e-3, 0.5e-6, nu)
    r = np.hypot(1e-3, 1e-3)
    kelvin = (3 - 4 * nu + 0.5e-6 / r**2) / (16 * np.pi * (1 - nu) * r)
    check("Mindlin far below the surface against Kelvin", abs(float(far) / kelvin - 1), 1e-3)
    surface = mindlin(np.array(0.0), np.array(0.0), 2e-3, 4e-6, nu)
    cerruti = 1 / (2 * np.pi * 2e-3)  # G u_x on the x axis: (2(1-nu) + 2 nu)/(4 pi r)
    check("Mindlin at the surface against Cerruti", abs(float(surface) / cerruti - 1), 1e-9)
    a = float(mindlin(np.array(3e-3), np.array(8e-3), 1e-3, 0.5e-6, nu))
    b = float(mindlin(np.array(8e-3), np.array(3e-3), 1e-3, 0.5e-6, nu))
    check("Mindlin: reciprocity", abs(a / b - 1), 1e-9)
    g = Geometry()
    forces = []
    for cell in (0.9e-3, 0.45e-3):
        world = World(12e3, g, g, body=body_stiffness(12e3, 0.49, g.outer / 2), cell=cell)
        forces.append(march(world, run_of(25e-3), np.array([71e-3])).force[0].max())
    check("needle in a half space: force at half the cell size", abs(forces[0] / forces[1] - 1), 3e-3)
    forces = []
    for images in (12, 24):
        world = World(12e3, g, g, body=body_stiffness(12e3, 0.49, g.outer / 2, walls=25e-3, images=images))
        forces.append(march(world, run_of(25e-3), np.array([71e-3])).force[0].max())
    check("needle in a block: force with twice the mirror images", abs(forces[0] / forces[1] - 1), 1e-3)


if __name__ == "__main__":
    infinite_beam()
    cantilever()
    finite_beam()
    incremental_energy()
    axial()
    hinges()
    bodies()
    print("all checks held")
