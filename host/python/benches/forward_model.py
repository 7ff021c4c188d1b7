"""What calls cost, how soon Ctrl-C ends one, and the forward model beside the same model in NumPy: processor time, one core.

    OPENBLAS_NUM_THREADS=1 python host/python/benches/forward_model.py
"""

from __future__ import annotations

import os
import resource
import signal
import statistics
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import needle_guide
from needle_guide import forward

Array = NDArray[np.float64]
PLACES_MM = np.linspace(0.0, 100.0, 20)


def numpy_model(k_kpa: Array, depth_mm: float, z_mm: Array) -> tuple[Array, Array]:
    """Force and deflection at 1 mm of guide 2, many moduli at once: cubics to guide 2 and to the surface, then the four
    solutions of the beam on springs; the ten conditions between them as one system of equations per modulus."""
    count, guide2_m, entry_m = len(k_kpa), 0.06, 0.07
    inside_m, free_m = 1e-3 * depth_mm, entry_m - guide2_m
    per_m = (1e3 * k_kpa / (4 * forward.GAUGE_18_N_M2)) ** 0.25

    def solutions(y_m: Array, order: int) -> Array:
        growing, falling = (1 + 1j) * per_m, (-1 + 1j) * per_m
        at_surface = np.exp(falling * y_m) * falling**order
        at_tip = np.exp(growing * y_m - per_m * inside_m) * growing**order
        parts = [at_surface.real, at_surface.imag, at_tip.real, at_tip.imag]
        return np.asarray(np.stack(parts, 1), dtype=np.float64)

    matrix, right = np.zeros((count, 10, 10)), np.zeros((count, 10))
    matrix[:, 0, :3] = guide2_m**2, guide2_m**3, -1
    matrix[:, 1, [0, 1, 3]] = 2 * guide2_m, 3 * guide2_m**2, -1
    matrix[:, 2, [0, 1, 4]] = 2, 6 * guide2_m, -2
    matrix[:, 3, :2], right[:, 3] = (guide2_m**2, guide2_m**3), 1e-3
    powers = [[1, free_m, free_m**2, free_m**3], [0, 1, 2 * free_m, 3 * free_m**2], [0, 0, 2, 6 * free_m], [0, 0, 0, 6]]
    for order, power in enumerate(powers):
        matrix[:, 4 + order, 2:6] = power
        matrix[:, 4 + order, 6:] = -solutions(np.zeros(count), order)
    for order in (2, 3):
        matrix[:, 6 + order, 6:] = solutions(np.full(count, inside_m), order)
    size = np.abs(matrix).max(2, keepdims=True)
    found = np.linalg.solve(matrix / size, (right / size[:, :, 0])[..., None])[..., 0]
    deflection_m = np.empty((count, len(z_mm)))
    for number, z_m in enumerate(1e-3 * z_mm):
        if z_m <= guide2_m:
            deflection_m[:, number] = found[:, 0] * z_m**2 + found[:, 1] * z_m**3
        elif z_m <= entry_m:
            deflection_m[:, number] = found[:, 2:6] @ ((z_m - guide2_m) ** np.arange(4))
        else:
            deflection_m[:, number] = (solutions(np.full(count, z_m - entry_m), 0) * found[:, 6:]).sum(1)
    force_n = np.asarray(np.abs(6 * forward.GAUGE_18_N_M2 * (found[:, 5] - found[:, 1])), dtype=np.float64)
    return force_n, 1e3 * deflection_m


def processor_s(work: Callable[[], object], repeats: int = 7) -> float:
    """Least processor time of the process."""
    taken = []
    for _ in range(repeats):
        before = resource.getrusage(resource.RUSAGE_SELF)
        work()
        after = resource.getrusage(resource.RUSAGE_SELF)
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(taken)


def elapsed_us(work: Callable[[], object], repeats: int) -> float:
    """Median time of a call, microseconds."""
    taken = []
    for _ in range(repeats):
        before = time.perf_counter()
        work()
        taken.append(time.perf_counter() - before)
    return 1e6 * statistics.median(taken)


def interrupted_after_s(work: Callable[[], object], wait_s: float) -> float:
    """Time from Ctrl-C to the end of a call, which would last longer than `wait_s`."""
    sent: list[float] = []

    def interrupt() -> None:
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(wait_s, interrupt)
    timer.start()
    try:
        work()
    except KeyboardInterrupt:
        return time.perf_counter() - sent[0]
    timer.cancel()
    raise SystemExit(f"the call has ended within {wait_s} s")


def main() -> None:
    """Prints the figures."""
    few, many, one = np.linspace(5.0, 40.0, 2_000), np.linspace(5.0, 40.0, 20_000), np.array([12.0])
    force_n, shape_mm = numpy_model(few, 30.0, PLACES_MM)
    assert np.allclose(force_n, forward.force_n(k_kpa=few, depth_mm=30.0), rtol=1e-9)
    assert np.allclose(shape_mm, forward.deflection_mm(PLACES_MM, k_kpa=few, depth_mm=30.0), atol=1e-9)
    ours = processor_s(lambda: forward.deflection_mm(PLACES_MM, k_kpa=many, depth_mm=30.0)) / len(many)
    batched = processor_s(lambda: numpy_model(few, 30.0, PLACES_MM)) / len(few)
    single = processor_s(lambda: [numpy_model(one, 30.0, PLACES_MM) for _ in range(200)]) / 200
    print(f"a set of parameters, 20 places: {1e6 * ours:.2f} us")
    print(f"NumPy, all sets at once:        {1e6 * batched:.2f} us, {batched / ours:.1f} times as long")
    print(f"NumPy, set by set:              {1e6 * single:.0f} us, {single / ours:.0f} times as long")
    print(f"call of the forward model:      {elapsed_us(lambda: forward.force_n(k_kpa=12.0, depth_mm=30.0), 300):.0f} us")
    sets = np.linspace(5.0, 40.0, 3_000_000)
    for wait_s in (0.05, 0.5):
        taken_s = interrupted_after_s(lambda: forward.force_jacobian(forward.PARAMETERS, k_kpa=sets, depth_mm=30.0), wait_s)
        print(f"Ctrl-C after {wait_s:.2f} s in 3 million sets:  {taken_s:.3f} s")
    effects = ["effects", "tissue.layers"]
    print(f"call of a command:              {elapsed_us(lambda: needle_guide.call(effects), 100):.0f} us")


if __name__ == "__main__":
    main()
