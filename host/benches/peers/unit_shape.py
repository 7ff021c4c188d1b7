"""The needle on a uniform foundation under 1 N at guide 2, in closed form: cubics outside, decaying waves inside, one linear system
of six unknowns."""

import numpy as np

EI = 200e9 * np.pi / 64 * (1.27e-3**4 - 1.0e-3**4)
GUIDE2, ENTRY, DEPTH = 0.06, 0.07, 0.03
SAMPLES = 40
Z = ENTRY + DEPTH * (np.arange(SAMPLES) + 0.5) / SAMPLES
ORDERS = np.arange(4)[:, None]
CUBIC = np.array([[ENTRY**2, ENTRY**3], [2 * ENTRY, 3 * ENTRY**2], [2.0, 6 * ENTRY], [0.0, 6.0]])
# What the force itself adds beyond guide 2.
# What 1 N at guide 2 takes off the cubic beyond it.
BEYOND = np.array([(ENTRY - GUIDE2) ** 3 / 6, (ENTRY - GUIDE2) ** 2 / 2, ENTRY - GUIDE2, 1.0]) / EI


def waves(b, s, order):
    """Derivatives of the four waves at s (arrays of orders and places are taken against each other)."""
    left, right = -b + 1j * b, b + 1j * b
    first = left**order * np.exp(left * s)
    second = right**order * np.exp(right * (s - DEPTH))
    return np.stack([first.real, first.imag, second.real, second.imag], axis=-1)


def unit_shape(k, z):
    """Deflection at guide 2 and at z per newton."""
    b = (k / (4 * EI)) ** 0.25
    rows = np.zeros((6, 6))
    rows[:4, :2] = CUBIC
    rows[:4, 2:] = -waves(b, 0.0, ORDERS)[:, 0]
    rows[4:, 2:] = waves(b, DEPTH, ORDERS[2:])[:, 0]
    right = np.zeros(6)
    right[:4] = -BEYOND
    x = np.linalg.solve(rows, right)
    return x[0] * GUIDE2**2 + x[1] * GUIDE2**3, waves(b, z - ENTRY, 0) @ x[2:]
