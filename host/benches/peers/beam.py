"""Beam on springs: deflection at guide 2 and the shape at 40 places under 1 N at guide 2, K = 16 kPa. In closed form with NumPy, by
Hermite elements with SciPy's banded solver, and by the frame programs of structural engineers, with a spring at every millimetre."""

import numpy as np
from scipy.linalg import solveh_banded

from timing import report
from unit_shape import DEPTH, EI, ENTRY, GUIDE2, SAMPLES, Z, unit_shape

K = 16e3
STEP = 1e-3
NODES = round((ENTRY + DEPTH) / STEP) + 1
X = STEP * np.arange(NODES)
LOADED = round(GUIDE2 / STEP)
INSIDE = np.arange(NODES - 1) >= round(ENTRY / STEP)
# Of every node: the stretch of tissue that its spring stands for.
LUMPED = STEP * 0.5 * (np.append(INSIDE, False).astype(float) + np.append(False, INSIDE))


def closed_form(k=K):
    at_guide2, inside = unit_shape(k, Z)
    return np.append(at_guide2, inside)


def hermite(u, slope, z):
    """Between nodes."""
    at = np.minimum((z / STEP).astype(int), NODES - 2)
    x = z / STEP - at
    return (
        (1 - 3 * x**2 + 2 * x**3) * u[at]
        + STEP * (x - 2 * x**2 + x**3) * slope[at]
        + (3 * x**2 - 2 * x**3) * u[at + 1]
        + STEP * (x**3 - x**2) * slope[at + 1]
    )


L = STEP
BENDING = EI / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L**2, -6 * L, 2 * L**2],
                                [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L**2, -6 * L, 4 * L**2]])
SPRINGS = L / 420 * np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                              [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])


def elements(k=K):
    local = BENDING[None] + k * INSIDE[:, None, None] * SPRINGS[None]
    banded = np.zeros((4, 2 * NODES))
    at = 2 * np.arange(NODES - 1)
    for i in range(4):
        for j in range(i + 1):
            np.add.at(banded[i - j], at + j, local[:, i, j])
    # Clamped: the first two unknowns are dropped.
    right = np.zeros(2 * NODES - 2)
    right[2 * LOADED - 2] = 1.0
    u = np.append([0.0, 0.0], solveh_banded(banded[:, 2:], right, lower=True))
    return np.append(u[2 * LOADED], hermite(u[0::2], u[1::2], Z))


def opensees(k=K):
    import openseespy.opensees as ops

    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    ops.geomTransf("Linear", 1)
    for i in range(NODES):
        ops.node(i, float(X[i]), 0.0)
        if i > 0:
            ops.element("elasticBeamColumn", i, i - 1, i, 1.0, EI, 1.0, 1)
        if LUMPED[i] > 0:
            ops.node(1000 + i, float(X[i]), 0.0)
            ops.fix(1000 + i, 1, 1, 1)
            ops.uniaxialMaterial("Elastic", i, float(k * LUMPED[i]))
            ops.element("zeroLength", 1000 + i, 1000 + i, i, "-mat", i, "-dir", 2)
    ops.fix(0, 1, 1, 1)
    ops.timeSeries("Constant", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(LOADED, 0.0, 1.0, 0.0)
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("BandSPD")
    ops.integrator("LoadControl", 1.0)
    ops.algorithm("Linear")
    ops.analysis("Static", "-noWarnings")
    ops.analyze(1)
    u = np.array([ops.nodeDisp(i, 2) for i in range(NODES)])
    slope = np.array([ops.nodeDisp(i, 3) for i in range(NODES)])
    return np.append(u[LOADED], hermite(u, slope, Z))


def pynite(k=K):
    from Pynite import FEModel3D

    model = FEModel3D()
    # E I of the section is that of the needle.
    model.add_material("steel", 1.0, 1.0, 0.3, 0.0)
    model.add_section("needle", 1.0, EI, EI, 1.0)
    for i in range(NODES):
        model.add_node(f"N{i}", float(X[i]), 0, 0)
        if i > 0:
            model.add_member(f"M{i}", f"N{i - 1}", f"N{i}", "steel", "needle")
        if LUMPED[i] > 0:
            model.def_support_spring(f"N{i}", "DY", float(k * LUMPED[i]))
    model.def_support("N0", True, True, True, True, True, True)
    model.add_node_load(f"N{LOADED}", "FY", 1.0)
    model.analyze_linear()
    u = np.array([model.nodes[f"N{i}"].DY["Combo 1"] for i in range(NODES)])
    slope = np.array([model.nodes[f"N{i}"].RZ["Combo 1"] for i in range(NODES)])
    return np.append(u[LOADED], hermite(u, slope, Z))


def frames(k=K):
    from anastruct import SystemElements

    model = SystemElements(EI=EI, EA=1.0)
    for i in range(1, NODES):
        model.add_element([[float(X[i - 1]), 0.0], [float(X[i]), 0.0]])
    model.add_support_fixed(node_id=1)
    for i in np.flatnonzero(LUMPED):
        model.add_support_spring(node_id=int(i) + 1, translation=2, k=float(k * LUMPED[i]))
    model.point_load(node_id=LOADED + 1, Fy=1.0)
    model.solve()
    results = model.get_node_results_system()
    u = np.array([abs(node["uy"]) for node in results])
    slope = np.gradient(u, STEP)
    return np.append(u[LOADED], hermite(u, slope, Z))


PEERS = [
    ("NumPy, closed form", closed_form),
    ("SciPy, Hermite elements of 1 mm, `solveh_banded`", elements),
    ("OpenSeesPy, elements of 1 mm", opensees),
    ("PyNite, elements of 1 mm", pynite),
    ("anastruct, elements of 1 mm", frames),
]


if __name__ == "__main__":
    assert SAMPLES == len(Z)
    report(PEERS)
