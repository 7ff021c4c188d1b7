"""The insertion: at every depth the needle's response to a load at its tip, and from it where the tip goes. 140 mm in steps of 0.5 mm,
Hermite elements, the springs at rest on the path that the tip has cut. The result: the tip at every 10 mm, in mm."""

import numpy as np
from scipy.linalg import solveh_banded

from timing import report
from unit_shape import EI, GUIDE2

ENTRY, K, LOAD, STEP, STEPS = 0.085, 12e3, 0.2, 0.5e-3, 280


def bending(l):
    return EI / l**3 * np.array([[12, 6 * l, -12, 6 * l], [6 * l, 4 * l**2, -6 * l, 2 * l**2],
                                 [-12, -6 * l, 12, -6 * l], [6 * l, 2 * l**2, -6 * l, 4 * l**2]])


L = STEP
SPRINGS = K * L / 420 * np.array([[156, 22 * L, 54, -13 * L], [22 * L, 4 * L**2, 13 * L, -3 * L**2],
                                  [54, 13 * L, 156, -22 * L], [-13 * L, -3 * L**2, -22 * L, 4 * L**2]])
# What a path that is linear over the element, by its start and its end, does to the four unknowns.
PATH = K * L * np.array([[7 / 20, 3 / 20], [L / 20, L / 30], [3 / 20, 7 / 20], [-L / 30, -L / 20]])
INSIDE = bending(STEP) + SPRINGS


def add(banded, at, local):
    for i in range(4):
        banded[i, at : at + 4 - i] += np.diagonal(local, -i)


def insertion():
    # Unknowns: slope at guide 2 (its deflection is held), then deflection and slope of every node. Guide 1 is clamped.
    banded = np.zeros((4, 1 + 2 * (STEPS + 1)))
    banded[0, 0] = bending(GUIDE2)[3, 3]
    local = bending(ENTRY - GUIDE2)[1:, 1:]
    for i in range(3):
        banded[i, : 3 - i] += np.diagonal(local, -i)
    tip = np.empty(STEPS + 1)
    for n in range(STEPS + 1):
        if n > 0:
            add(banded, 2 * n - 1, INSIDE)
        size = 2 * n + 3
        right = np.zeros(size)
        right[-2] = 1.0
        shape = solveh_banded(banded[:, :size], right, lower=True, overwrite_b=True, check_finite=False)
        known, newest = LOAD * shape[-2], 0.0
        if n > 0:
            u = shape[1:].reshape(-1, 2)
            weights = np.hstack([u[:-1], u[1:]]) @ PATH
            known += weights[:, 0] @ tip[:n] + weights[:-1, 1] @ tip[1:n]
            newest = weights[-1, 1]
        tip[n] = known / (1.0 - newest)
    return 1e3 * tip[20::20]


if __name__ == "__main__":
    report([("SciPy, `solveh_banded` at every depth", insertion)])
