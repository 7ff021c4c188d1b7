"""Recursive least squares: 18 unknowns, one row after the other, the estimate after each. The result: the last estimate."""

import numpy as np

from timing import given, report

DATA = given()
ROWS, VALUES = np.array(DATA["rows"]), np.array(DATA["values"])
VARIANCE = DATA["prior_variance"]
COUNT, SIZE = ROWS.shape


def by_numpy():
    x, p = np.zeros(SIZE), VARIANCE * np.eye(SIZE)
    for row, value in zip(ROWS, VALUES):
        spread = p @ row
        total = row @ spread + 1.0
        x = x + spread * ((value - row @ x) / total)
        p = p - np.outer(spread, spread) / total
    return x


def by_filterpy():
    from filterpy.kalman import KalmanFilter

    kalman = KalmanFilter(dim_x=SIZE, dim_z=1)
    kalman.P *= VARIANCE
    kalman.R *= 1.0
    for row, value in zip(ROWS, VALUES):
        kalman.update(value, H=row[None])
    return kalman.x[:, 0]


def by_padasip():
    from padasip.filters import FilterRLS

    rls = FilterRLS(SIZE, mu=1.0, eps=1.0 / VARIANCE, w="zeros")
    for row, value in zip(ROWS, VALUES):
        rls.adapt(value, row)
    return rls.w


if __name__ == "__main__":
    report([
        ("NumPy", by_numpy, COUNT),
        ("filterpy, `KalmanFilter.update`", by_filterpy, COUNT),
        ("padasip, `FilterRLS.adapt`", by_padasip, COUNT),
    ])
