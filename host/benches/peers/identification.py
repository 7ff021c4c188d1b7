"""Identification of one lateral run with SciPy's least squares around each of the beams: the same beam, data, weights and unknowns. The
result: ln K and the displacement of guide 2 in mm."""

import numpy as np
from scipy.optimize import least_squares

from beam import PEERS
from timing import report
from unit_shape import SAMPLES, Z, unit_shape

SHAPE_SD = 25e-6


def main():
    at_guide2, inside = unit_shape(16e3, Z)
    force = 1.2e-3 / at_guide2
    shape = force * inside + SHAPE_SD * np.sin(2.0 * np.arange(SAMPLES))

    def identification(solve):
        """With a beam: from K to the deflections at guide 2 and at Z under 1 N at guide 2."""

        def residuals(x):
            per_newton, *per_force = solve(np.exp(x[0]))
            f = x[1] / per_newton
            ends = [(1.205e-3 - x[1]) / 15e-6, (force + 0.05 - f) / 0.1]
            return np.concatenate([ends, (shape - f * np.array(per_force)) / SHAPE_SD])

        def identify():
            found = least_squares(residuals, [9.0, 1.205e-3], x_scale=[1.0, 1e-3], method="lm")
            # The covariance belongs to what is found.
            np.linalg.inv(found.jac.T @ found.jac)
            return [found.x[0], 1e3 * found.x[1]]

        return identify

    report([(f"SciPy, `least_squares` on {name}", identification(solve)) for name, solve in PEERS])


if __name__ == "__main__":
    main()
