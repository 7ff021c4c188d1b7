"""Stiffness of an elastic block against the deflection of a needle in it, by three-dimensional finite elements.

An independent solution for the program's blocks (``Block`` in the crate ``mechanics``): scikit-fem, hexahedra with quadratic
displacements and continuous linear pressure (Taylor-Hood), so that nothing locks up to a Poisson's ratio of one half. The needle is a
hole whose wall and bottom are bonded to it; its sections stay plane and normal to its axis. Below the tip there is tissue.

    pip install numpy scipy scikit-fem pypardiso
    python blocks.py --count 30 --seed 1 > blocks.csv
    python blocks.py --count 30 --seed 2 --depths 1 0.8 0.6 > sessions.csv
    python blocks.py --block 50 50 45 --at 25 25 --sides held --far-side held --depth 30 --poisson 0.49

A line per block: edges, needle's place, depth (mm), Poisson's ratio, mountings, and the stiffness against the Legendre polynomials of
degree 0 to 5 in depth, per unit of Young's modulus and of depth, entries on and below the diagonal row by row.
"""

import argparse
import sys
import time

import numpy as np
from scipy.sparse import bmat, csr_matrix
from skfem import Basis, BilinearForm, ElementHex1, ElementHex2, ElementVector, MeshHex, asm
from skfem.helpers import ddot, div, sym_grad

RADIUS = 0.635
MODES = 6
HEX_CORNERS = [[0, 0, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0], [1, 1, 1]]


def graded(length, first, growth, last):
    """Nodes from 0 to length: elements of ``first`` that grow to ``last`` at most."""
    sizes = [first]
    while sum(sizes) < length:
        sizes.append(min(sizes[-1] * growth, last))
    return np.concatenate([[0.0], np.cumsum(sizes)]) * length / sum(sizes)


def both_ends(length, first, growth, last):
    """Nodes that are closer at both ends."""
    half = graded(0.5 * length, first, growth, last)
    return np.concatenate([half, length - half[-2::-1]])


def plane(width, height, at, angular, layers):
    """Quadrilaterals of the cross-section: rings from the needle's circle to the rectangle, and the disc within the circle."""
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]) - at
    directions = np.unwrap(np.arctan2(corners[:, 1], corners[:, 0]))
    ends = np.append(directions, directions[0] + 2.0 * np.pi)
    share = np.diff(ends) / (2.0 * np.pi)
    pieces = np.maximum(2, np.floor(share * angular)).astype(int)
    while pieces.sum() < angular:
        pieces[np.argmax(share * angular / pieces)] += 1
    while pieces.sum() > angular:
        pieces[np.argmax(pieces / share * (pieces > 2))] -= 1
    outer = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(ends, ends[1:], pieces)])
    reach = np.empty(angular)
    for k, angle in enumerate(outer):
        c, s = np.cos(angle), np.sin(angle)
        to_x = (width - at[0]) / c if c > 1e-12 else -at[0] / c if c < -1e-12 else np.inf
        to_y = (height - at[1]) / s if s > 1e-12 else -at[1] / s if s < -1e-12 else np.inf
        reach[k] = min(to_x, to_y)
    inner = outer[0] + 2.0 * np.pi * np.arange(angular) / angular
    inner += np.mean(outer - inner)
    # The polygon conducts as the circle does where it is drawn a little outside of it.
    side = np.pi / angular
    radius = RADIUS * (1.0 + side * side / 6.0)
    points, quads = [], []
    for ring in range(layers + 1):
        s = ring / layers
        r = radius * (reach / radius) ** s
        # Near the needle rings are round.
        turn = inner + (outer - inner) * s**1.5
        points.append(np.stack([r * np.cos(turn), r * np.sin(turn)], axis=1) + at)
    points = np.concatenate(points)
    for ring in range(layers):
        for k in range(angular):
            a, b = ring * angular + k, ring * angular + (k + 1) % angular
            quads.append([a, a + angular, b + angular, b])
    outside = len(quads)
    # The disc: a square grid and a ring around it.
    n = angular // 4
    grid = np.linspace(-1.0, 1.0, n + 1)
    start = len(points)
    angle = inner[0] + np.pi / 4.0
    local = np.array([[x, y] for y in grid for x in grid])
    stretch = np.maximum(np.abs(local).max(axis=1), 1e-12) / np.maximum(np.hypot(*local.T), 1e-12)
    local = local * (0.5 + 0.5 * stretch[:, None]) * 0.62 * radius
    # The first corner of the square is where the first node of the circle is.
    turn = inner[0] - np.arctan2(-1.0, -1.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = np.concatenate([points, local @ rotation.T + at])
    index = lambda i, j: start + j * (n + 1) + i
    for j in range(n):
        for i in range(n):
            quads.append([index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)])
    rim = [index(i, 0) for i in range(n)] + [index(n, j) for j in range(n)]
    rim += [index(n - i, n) for i in range(n)] + [index(0, n - j) for j in range(n)]
    for k in range(angular):
        quads.append([rim[k], k, (k + 1) % angular, rim[(k + 1) % angular]])
    del angle
    return points, np.array(quads), outside


def solve(block, angular=16, layers=9, fineness=1.0):
    """Stiffness against Legendre polynomials, per unit of modulus and depth."""
    (width, height, length), at, depth, poisson, sides, far_side = block
    points, quads, outside = plane(width, height, np.array(at), angular, layers)
    first = 1.5 * RADIUS / fineness
    above = both_ends(depth, first, 1.0 + 0.9 / fineness, depth / (4.0 * fineness))
    below = depth + graded(length - depth, first, 1.0 + 0.9 / fineness, (length - depth) / 3.0)
    levels = np.concatenate([above, below[1:]])
    tip = len(above) - 1
    count = len(points)
    p = np.concatenate([np.column_stack([points, np.full(count, z)]) for z in levels]).T
    cells = []
    for level in range(len(levels) - 1):
        used = quads if level >= tip else quads[:outside]
        for quad in used:
            corner = [quad[0], quad[1], quad[3], quad[2]]
            cells.append([c + level * count for c in corner] + [c + (level + 1) * count for c in corner])
    cells = np.array(cells)
    # From (0,0), (1,0), (0,1), (1,1) below and above to the order of the library.
    own = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]]
    cells = cells[:, [own.index(c) for c in HEX_CORNERS]]
    used = np.unique(cells)
    renumbered = np.full(p.shape[1], -1)
    renumbered[used] = np.arange(len(used))
    mesh = MeshHex(p[:, used], renumbered[cells].T)
    moved = Basis(mesh, ElementVector(ElementHex2()), intorder=4)
    pressed = moved.with_element(ElementHex1())
    shear = 0.5 / (1.0 + poisson)
    lam_inverse = (1.0 + poisson) * (1.0 - 2.0 * poisson) / poisson

    a = asm(BilinearForm(lambda u, v, w: 2.0 * shear * ddot(sym_grad(u), sym_grad(v))), moved)
    b = asm(BilinearForm(lambda u, q, w: -div(u) * q), moved, pressed)
    c = asm(BilinearForm(lambda q, r, w: -lam_inverse * q * r), pressed)
    system = csr_matrix(bmat([[a, b.T], [b, c]]))
    where = moved.doflocs
    tol = 1e-6 * RADIUS
    x, y, z = where
    on_side = (x < tol) | (x > width - tol) | (y < tol) | (y > height - tol)
    fixed = np.zeros(where.shape[1], dtype=bool)
    if sides == "held":
        fixed |= on_side
    if far_side == "held":
        fixed |= z > length - tol
    from_axis = np.hypot(x - at[0], y - at[1])
    wall = (from_axis < 1.02 * RADIUS * (1.0 + (np.pi / angular) ** 2 / 6.0)) & (z < depth + tol)
    components = np.empty(where.shape[1], dtype=int)
    for part in (moved.nodal_dofs, moved.edge_dofs, moved.facet_dofs, moved.interior_dofs):
        for component in range(3):
            if len(part):
                components[part[component::3]] = component
    given = np.zeros((system.shape[0], MODES))
    for degree in range(MODES):
        legendre = np.polynomial.legendre.Legendre.basis(degree)
        at_z = 2.0 * z / depth - 1.0
        value = np.where(components == 1, legendre(at_z), 0.0)
        turned = -(y - at[1]) * legendre.deriv()(at_z) * 2.0 / depth
        given[: len(z), degree] = np.where(wall, np.where(components == 2, turned, value), 0.0)
    known = np.zeros(system.shape[0], dtype=bool)
    known[: len(z)] = wall | fixed
    free = ~known
    inner = system[free][:, free]
    right = -(system[free][:, known] @ given[known])
    try:
        import pypardiso

        found = pypardiso.spsolve(inner.tocsr(), right)
    except ImportError:
        from scipy.sparse.linalg import splu

        found = splu(inner.tocsc()).solve(right)
    all_of = given.copy()
    all_of[free] = found.reshape(-1, MODES)
    energy = given.T @ (system @ all_of)
    return 0.5 * (energy + energy.T) / depth, system.shape[0]


def drawn(count, seed):
    """Blocks as a laboratory may have them."""
    rng = np.random.default_rng(seed)
    while count > 0:
        size = np.exp(rng.uniform(np.log(40.0), np.log(200.0), 3))
        depth = rng.uniform(15.0, 60.0)
        at = [edge * rng.uniform(0.25, 0.75) for edge in size[:2]]
        poisson = rng.choice([0.45, 0.48, 0.49, 0.495, 0.5])
        sides, far_side = rng.choice(["free", "held"], 2)
        if depth > 0.85 * size[2] or (sides == "free" and far_side == "free"):
            continue
        count -= 1
        round_to = lambda values: tuple(float(np.round(v, 1)) for v in values)
        yield round_to(size), round_to(at), float(np.round(depth, 1)), float(poisson), str(sides), str(far_side)


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--count", type=int, default=30)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--depths", type=float, nargs="+", default=[1.0], help="of every drawn block, as shares of its depth")
    arguments.add_argument("--skip", type=int, default=0, help="drawn blocks that are there already")
    arguments.add_argument("--angular", type=int, default=16)
    arguments.add_argument("--layers", type=int, default=9)
    arguments.add_argument("--fineness", type=float, default=1.0)
    arguments.add_argument("--block", type=float, nargs=3)
    arguments.add_argument("--at", type=float, nargs=2)
    arguments.add_argument("--depth", type=float)
    arguments.add_argument("--poisson", type=float, default=0.5)
    arguments.add_argument("--sides", default="held")
    arguments.add_argument("--far-side", default="held")
    given = arguments.parse_args()
    if given.block:
        at = given.at or [0.5 * given.block[0], 0.5 * given.block[1]]
        blocks = [(tuple(given.block), tuple(at), given.depth, given.poisson, given.sides, given.far_side)]
    else:
        blocks = (
            (size, at, round(share * depth, 1), *others)
            for size, at, depth, *others in list(drawn(given.count, given.seed))[given.skip :]
            for share in given.depths
        )
    print("# width, height, length, x, y, depth (mm), Poisson's ratio, sides, far side, stiffness (rows of the lower triangle)")
    for block in blocks:
        started = time.time()
        stiffness, unknowns = solve(block, given.angular, given.layers, given.fineness)
        (width, height, length), (x, y), depth, poisson, sides, far_side = block
        lower = [f"{stiffness[i, j]:.6e}" for i in range(MODES) for j in range(i + 1)]
        print(",".join([f"{width},{height},{length},{x},{y},{depth},{poisson},{sides},{far_side}"] + lower), flush=True)
        print(f"{unknowns} unknowns, {time.time() - started:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
