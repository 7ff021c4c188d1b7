"""Equilibrium of needle, guides and tissue, marched through a motion program.

Forces of the tissue act at Gauss points below the surface, the force of guide 2 at guide 2. The beam is condensed to
its flexibility between these points, and the equilibrium of every time step is found by Newton iteration on

* e, the displacement of the needle relative to its tissue at each Gauss point,
* F, the force of guide 2,
* theta, rotations of hinges (clamp, dents), where a world has any.
"""

from __future__ import annotations

import numpy as np

from .beam import KINK, Array, Beam
from .condensed import Condensed, Points, blend
from .runs import Motion, Run
from .tissue import gauss_points
from .world import World, foundation


def march(world: World, run: Run, positions: Array) -> Motion:
    """Equilibrium of one run at every step of its grid; deflections are returned at `positions` from guide 1, which
    are clipped to the needle's end."""
    geometry = world.geometry
    depth = world.depth(run)
    length = geometry.entry + depth
    axes = 2 if world.two_axes else 1
    axis_of = [run.axis] if axes == 1 else [0, 1]

    def bending(z: Array) -> Array:
        out = np.full_like(z, geometry.bending)
        for factor in world.bending:
            out = out * factor(z, run, length)
        return out

    hinges = [(h, z) for h in world.hinges if (z := h.z(run, length)) is not None]
    extras = [(x, z) for x in world.extra if (z := x.z(run, length)) is not None]
    breaks = [
        geometry.guide2,
        geometry.entry,
        *[geometry.entry + b for b in world.breaks],
        *[z for _, z in hinges],
        *[z for _, z in extras],
        *[z + d for _, z in hinges if z > 1e-9 for d in (-KINK / 2, KINK / 2)],
    ]
    compliance = sum(c(run) for c in world.clamp)
    axial = sum(a(run) for a in world.axial)

    def make(load: float) -> Beam:
        return Beam(
            length, breaks, bending, compliance, geometry.guide2, world.guide_spring, load, fine_from=geometry.entry
        )

    s, w = gauss_points(depth, world.breaks, world.cell)
    n, m, h = len(s), len(extras), len(hinges)
    z_forces = np.concatenate([geometry.entry + s, [z for _, z in extras]])
    z_image = np.clip(positions, 0.0, length)
    stiffness = foundation(world, run, s, w, depth)
    support = np.zeros((n, n))
    for add in world.support:
        support = support + add(s, run)
    for stage in [*world.strain, *world.stress]:
        stage.begin(run, s, axes)
    for hinge, _ in hinges:
        hinge.begin(run, axes)
    for slip in world.slips:
        slip.begin()

    guide = np.zeros((2, len(run.time)))
    guide[run.axis] = run.command
    for change_motion in world.motion:
        guide = change_motion(run, guide)

    points = Points(
        z_forces,
        z_image,
        [z for _, z in hinges],
        compliance,
        world.free_shape,
        length,
        axis_of,
    )
    ladder: list[Condensed] = []
    loads = np.zeros(1)
    if world.membrane > 0.0:
        loads = np.linspace(0.0, -14.0, 15)
        ladder = [Condensed(make(axial + q), points, geometry.guide2) for q in loads]
    beam = make(axial)
    condensed = Condensed(beam, points, geometry.guide2)
    tension = 0.0

    size = n + m + 1 + h
    steps = len(run.time)
    force = np.zeros((2, steps))
    deflection = np.zeros((2, steps, len(z_image)))
    relative = np.zeros((2, steps, n))
    tissue = np.zeros((2, steps, n))
    energy = np.zeros(steps)
    state = np.zeros((axes, size))
    previous_guide = np.full(2, np.nan)

    for step, time in enumerate(run.time):
        dt = float(time - run.time[step - 1]) if step else 0.0
        target = guide[axis_of, step]
        if step and world.timeless and np.array_equal(guide[:, step], previous_guide):
            force[:, step], deflection[:, step] = force[:, step - 1], deflection[:, step - 1]
            relative[:, step], tissue[:, step] = relative[:, step - 1], tissue[:, step - 1]
            energy[step] = energy[step - 1]
            continue
        previous_guide = guide[:, step].copy()
        if world.membrane > 0.0:
            nearest = int(np.argmin(np.abs(loads + tension)))
            condensed = blend(ladder, loads, tension, nearest)
        if world.guide_shift is not None:
            condensed = Condensed(beam, points, geometry.guide2 + world.guide_shift(guide[:, step], run))
        anchor = np.zeros((2, n))
        for move in world.anchors:
            anchor = anchor + move(s, float(time), run)
        for slip in world.slips:
            anchor = anchor + slip.value[:, None]
        anchor = anchor[axis_of]

        def evaluate(y: Array) -> tuple[Array, Array, Array, Array, list[Array]]:
            """Residual, Jacobian, forces of tissue and extras on the needle (resisting), moments, stage inputs."""
            value, chain = y[:, :n], np.ones((axes, n))
            inputs: list[Array] = []
            for stage in world.strain:
                inputs.append(value)
                value, d = stage.apply(value, dt)
                chain = chain * d
            if world.tensor is not None:
                tensor = world.tensor if axes == 2 else world.tensor[np.ix_(axis_of, axis_of)]
                q = tensor @ value @ stiffness.T
                jacobian = np.einsum("ab,ij,bj->aibj", tensor, stiffness, chain)
            else:
                q = value @ stiffness.T
                jacobian = np.einsum("ab,ij,bj->aibj", np.eye(axes), stiffness, chain)
            for stage in world.stress:
                inputs.append(q)
                q, d = stage.apply(q, dt)
                jacobian = d[:, :, None, None] * jacobian
            push = np.zeros((axes, m))
            push_d = np.zeros((axes, m))
            for i, (point, _) in enumerate(extras):
                moved = np.zeros(2)
                moved[axis_of] = y[:, n + i]
                f, d = point.force(moved, float(time), run)
                push[:, i], push_d[:, i] = -f[axis_of], -d[axis_of]
            loads_on = np.concatenate([q, push], axis=1)
            big = np.zeros((axes, n + m, axes, n + m))
            big[:, :n, :, :n] = jacobian
            for a in range(axes):
                for i in range(m):
                    big[a, n + i, a, n + i] = push_d[a, i]
            pull, turn = y[:, n + m], y[:, n + m + 1 :]
            c = condensed
            residual = np.zeros((axes, size))
            derivative = np.zeros((axes, size, axes, size))
            flexible = c.ff.copy()
            flexible[:n, :n] += support
            bent = c.bent.copy()
            bent[:, :n] -= anchor
            residual[:, : n + m] = (
                y[:, : n + m] - np.outer(pull, c.fg) + loads_on @ flexible.T - turn @ c.turn[:, :-1] - bent[:, :-1]
            )
            soft = world.frame * pull + world.play * pull / np.sqrt(pull**2 + 2.5e-5)
            soft_d = world.frame + world.play * 2.5e-5 / (pull**2 + 2.5e-5) ** 1.5
            residual[:, n + m] = target - soft - c.gg * pull + loads_on @ c.fg - turn @ c.turn[:, -1] - bent[:, -1]
            moments = np.outer(pull, c.lever[:, -1]) - loads_on @ c.lever[:, :-1].T if h else np.zeros((axes, 0))
            derivative[:, : n + m, :, : n + m] = np.einsum("ij,ajbk->aibk", flexible, big)
            derivative[:, n + m, :, : n + m] = np.einsum("j,ajbk->abk", c.fg, big)
            for a in range(axes):
                derivative[a, np.arange(n + m), a, np.arange(n + m)] += 1.0
                derivative[a, : n + m, a, n + m] -= c.fg
                derivative[a, n + m, a, n + m] -= c.gg + soft_d[a]
                if h:
                    derivative[a, : n + m, a, n + m + 1 :] -= c.turn[:, :-1].T
                    derivative[a, n + m, a, n + m + 1 :] -= c.turn[:, -1]
            for j, (hinge, _) in enumerate(hinges):
                angle, angle_d = hinge.law(moments[:, j])
                row = n + m + 1 + j
                residual[:, row] = turn[:, j] - angle
                for a in range(axes):
                    derivative[a, row, a, row] += 1.0
                    derivative[a, row, a, n + m] -= angle_d[a] * c.lever[j, -1]
                    derivative[a, row, :, : n + m] += angle_d[a] * np.einsum("j,jbk->bk", c.lever[j, :-1], big[a])
            return residual, derivative, loads_on, moments, inputs

        residual, derivative, loads_on, moments, inputs = evaluate(state)
        norm = float(np.abs(residual).max())
        for _ in range(60):
            if norm < 1e-10:
                break
            change = np.linalg.solve(derivative.reshape(axes * size, axes * size), residual.reshape(-1)).reshape(
                axes, size
            )
            scale = 1.0
            while True:
                trial = state - scale * change
                evaluated = evaluate(trial)
                trial_norm = float(np.abs(evaluated[0]).max())
                if trial_norm < norm or scale < 1e-3:
                    break
                scale *= 0.5
            state, norm = trial, trial_norm
            residual, derivative, loads_on, moments, inputs = evaluated
        if norm > 1e-7:
            raise RuntimeError(f"no equilibrium at {time:.2f} s of run {run.name}: {norm:.1e} m")
        for stage, value in zip([*world.strain, *world.stress], inputs):
            stage.commit(value, dt)
        for j, (hinge, _) in enumerate(hinges):
            hinge.commit(moments[:, j], dt)
        total = np.zeros(2)
        total[axis_of] = loads_on[:, :n].sum(axis=1)
        for slip in world.slips:
            slip.commit(total, dt)
        all_forces = np.concatenate([-loads_on, state[:, n + m : n + m + 1]], axis=1)
        shape = (
            all_forces @ condensed.image_full.T + state[:, n + m + 1 :] @ condensed.turn_image + condensed.bent_image
        )
        force[axis_of, step] = state[:, n + m]
        deflection[axis_of, step] = shape
        relative[axis_of, step] = state[:, :n]
        tissue[axis_of, step] = loads_on[:, :n]
        nodal = all_forces @ condensed.rows @ condensed.beam.inverse
        energy[step] = 0.5 * float(np.einsum("ai,ij,aj->", nodal, condensed.beam.bend, nodal))
        if world.membrane > 0.0:
            for j, t in enumerate(condensed.nodal_turn):
                nodal = nodal + np.outer(state[:, n + m + 1 + j], t)
            shortening = 0.5 * float(np.einsum("ai,ij,aj->", nodal, condensed.beam.geometric, nodal))
            area = np.pi / 4 * (geometry.outer**2 - geometry.inner**2)
            wanted = min(world.membrane * geometry.youngs * area * shortening / length, -float(loads[-1]))
            tension += 0.7 * (wanted - tension)
    return Motion(run, run.time, guide, force, z_image, deflection, s, relative, tissue, energy)
