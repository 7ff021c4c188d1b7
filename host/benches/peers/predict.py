"""One reading taken into a mixture of normal distributions, and mean and deviation of the path at every millimetre from it, all parts
at once. As many parts, unknowns and depths as the prediction has; other numbers. The result: whether it is what a loop over the
parts gives, which is 0."""

import numpy as np

from timing import given, report

DATA = given()
PARTS, SIZE, DEPTHS = DATA["parts"], DATA["unknowns"], DATA["depths"]
RANDOM = np.random.default_rng(1)
MEAN = RANDOM.normal(size=(PARTS, SIZE))
ROOT = RANDOM.normal(size=(PARTS, SIZE, SIZE)) / np.sqrt(SIZE)
COVARIANCE = ROOT @ ROOT.transpose(0, 2, 1) + np.eye(SIZE)
ROW = RANDOM.normal(size=(PARTS, SIZE))
PATH = RANDOM.normal(size=(PARTS, DEPTHS, SIZE))
MEASURED, VARIANCE = 0.3, 0.2


def update():
    spread = np.matmul(COVARIANCE, ROW[:, :, None])[:, :, 0]
    total = np.sum(ROW * spread, axis=1) + VARIANCE
    error = MEASURED - np.sum(ROW * MEAN, axis=1)
    mean = MEAN + spread * (error / total)[:, None]
    covariance = COVARIANCE - spread[:, :, None] * (spread / total[:, None])[:, None, :]
    ln = -0.5 * (error**2 / total + np.log(total))
    share = np.exp(ln - ln.max())
    share /= share.sum()
    value = np.matmul(PATH, mean[:, :, None])[:, :, 0]
    variance = np.sum(np.matmul(PATH, covariance) * PATH, axis=2)
    first = share @ value
    return first, np.sqrt(share @ (value**2 + variance) - first**2)


def difference():
    whole = update()
    lns, values, variances = [], [], []
    for mean, covariance, row, path in zip(MEAN, COVARIANCE, ROW, PATH):
        total = row @ covariance @ row + VARIANCE
        error = MEASURED - row @ mean
        gain = covariance @ row / total
        lns.append(-0.5 * (error**2 / total + np.log(total)))
        covariance = covariance - np.outer(gain, gain) * total
        values.append(path @ (mean + gain * error))
        variances.append(np.diag(path @ covariance @ path.T))
    share = np.exp(np.array(lns) - max(lns))
    share /= share.sum()
    first = share @ np.array(values)
    deviation = np.sqrt(share @ (np.array(values) ** 2 + np.array(variances)) - first**2)
    return max(np.max(np.abs(first - whole[0])), np.max(np.abs(deviation - whole[1])))


def work():
    update()
    return [0.0]


if __name__ == "__main__":
    assert difference() < 1e-10
    report([("NumPy, all parts at once", work)])
