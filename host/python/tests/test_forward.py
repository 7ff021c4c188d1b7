"""The forward model against an independent solution."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from needle_guide import UsageError, _core, forward


def elements(k_kpa: float, depth_mm: float, z_mm: np.ndarray, count: int = 400) -> tuple[float, np.ndarray]:
    """Force and shape at 1 mm by cubic beam elements with consistent springs: no code of the package."""
    ends = [0.0, 60e-3, 70e-3, 70e-3 + 1e-3 * depth_mm]
    nodes = np.unique(np.concatenate([np.linspace(a, b, count // 3 + 1) for a, b in zip(ends, ends[1:], strict=False)]))
    size = 2 * len(nodes)
    matrix = np.zeros((size, size))
    for i, (a, b) in enumerate(zip(nodes, nodes[1:], strict=False)):
        h = b - a
        bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h], [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])
        springs = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h], [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])
        k = 1e3 * k_kpa if 0.5 * (a + b) > 70e-3 else 0.0
        matrix[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += forward.GAUGE_18_N_M2 / h**3 * bending + k * h / 420 * springs
    guide2 = 2 * int(np.argmin(abs(nodes - 60e-3)))
    load = np.zeros(size)
    load[guide2] = 1.0
    free = np.arange(2, size)
    solution = np.zeros(size)
    solution[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    force_n = 1e-3 / solution[guide2]
    return force_n, np.interp(1e-3 * z_mm, nodes, solution[0::2]) * force_n * 1e3


@pytest.mark.parametrize(("k_kpa", "depth_mm"), [(5.0, 20.0), (12.0, 30.0), (60.0, 80.0)])
def test_force_and_shape_are_those_of_beam_elements(k_kpa: float, depth_mm: float) -> None:
    z_mm = np.linspace(0.0, 70.0 + depth_mm, 29)
    force_n, shape_mm = elements(k_kpa, depth_mm, z_mm)
    assert forward.force_n(k_kpa=k_kpa, depth_mm=depth_mm) == pytest.approx(force_n, rel=1e-5)
    assert forward.deflection_mm(z_mm, k_kpa=k_kpa, depth_mm=depth_mm) == pytest.approx(shape_mm, abs=2e-4)


def test_parameters_are_in_the_order_of_the_compiled_part() -> None:
    assert list(forward.PARAMETERS) == _core.PARAMETERS


def test_guide_2_is_where_it_is_held() -> None:
    at = forward.deflection_mm(60.0, k_kpa=[3.0, 30.0], depth_mm=40.0, displacement_mm=1.7)
    assert at.shape == (2, 1)
    assert at == pytest.approx(np.full((2, 1), 1.7), rel=1e-12)


def test_sets_are_broadcast() -> None:
    k_kpa, depth_mm = np.array([[5.0], [10.0]]), np.array([20.0, 30.0, 40.0])
    all_at_once = forward.force_n(k_kpa=k_kpa, depth_mm=depth_mm)
    assert all_at_once.shape == (2, 3)
    for i in range(2):
        for j in range(3):
            assert all_at_once[i, j] == forward.force_n(k_kpa=k_kpa[i, 0], depth_mm=depth_mm[j])
    assert forward.force_n(k_kpa=1.0, depth_mm=1.0).shape == ()
    assert forward.force_n(k_kpa=[], depth_mm=1.0).shape == (0,)


VALUES = {
    "k_kpa": 12.0,
    "depth_mm": 33.0,
    "displacement_mm": 1.3,
    "guide2_mm": 58.0,
    "entry_mm": 71.0,
    "bending_stiffness_n_m2": 0.02,
    "gap_mm": 4.0,
    "skin_n_per_mm": 0.2,
    "gradient_per_mm": 0.0,
}


@pytest.mark.parametrize("name", [name for name in forward.PARAMETERS if name != "gradient_per_mm"])
def test_derivatives_are_those_of_complex_free_extrapolation(name: forward.Parameter) -> None:
    """Richardson extrapolation with other steps than those of the module."""
    z_mm = np.array([30.0, 75.0, 104.0])

    def central(step: float) -> tuple[np.ndarray, np.ndarray]:
        up, down = ({**VALUES, name: VALUES[name] + sign * step} for sign in (1.0, -1.0))
        force = (forward.force_n(**up) - forward.force_n(**down)) / (2 * step)
        shape = (forward.deflection_mm(z_mm, **up) - forward.deflection_mm(z_mm, **down)) / (2 * step)
        return force, shape

    step = 3e-3 * abs(VALUES[name])
    coarse, fine = central(step), central(0.5 * step)
    force, shape = ((4 * b - a) / 3 for a, b in zip(coarse, fine, strict=True))
    assert forward.force_jacobian([name], **VALUES)[0] == pytest.approx(force, rel=1e-6)
    found = forward.deflection_jacobian(z_mm, [name], **VALUES)
    assert found.shape == (3, 1)
    assert found[:, 0] == pytest.approx(shape, rel=1e-5, abs=1e-9)


def test_a_derivative_at_the_end_of_the_range_is_one_sided() -> None:
    at_zero = {**VALUES, "gap_mm": 0.0, "skin_n_per_mm": 0.0}
    found = forward.force_jacobian(["gap_mm", "skin_n_per_mm"], **at_zero)
    inside = [
        (forward.force_n(**{**at_zero, name: 2 * step}) - forward.force_n(**at_zero)) / (2 * step)
        for name, step in (("gap_mm", 1e-4), ("skin_n_per_mm", 1e-6))
    ]
    assert found == pytest.approx(inside, rel=1e-4)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"k_kpa": [12.0, -3.0], "depth_mm": 30.0}, r"k_kpa\[1\]: -3 is out of range, expected 0 or more"),
        ({"k_kpa": 12.0, "depth_mm": 30.0, "guide2_mm": 80.0}, r"entry_mm\[0\]: 70 is out of range"),
        ({"k_kpa": [1.0, 2.0], "depth_mm": [1.0, 2.0, 3.0]}, r"k_kpa \(2,\), depth_mm \(3,\)"),
        ({"k_kpa": "stiff", "depth_mm": 30.0}, "k_kpa: holds something else than numbers"),
        ({"k_kpa": np.nan, "depth_mm": 30.0}, r"k_kpa\[0\]"),
    ],
)
def test_a_wrong_parameter_is_named(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        forward.force_n(**parameters)


def test_a_parameter_that_does_not_exist_or_is_missing_is_an_error_of_the_call() -> None:
    with pytest.raises(TypeError, match="k_pa"):
        forward.force_n(k_pa=12.0, depth_mm=30.0)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="depth_mm"):
        forward.force_n(k_kpa=12.0)  # type: ignore[call-arg]
    with pytest.raises(UsageError, match="wrt: k_pa is not a parameter"):
        forward.force_jacobian(["k_pa"], k_kpa=12.0, depth_mm=30.0)  # type: ignore[list-item]


def test_what_is_masked_stays_masked_whatever_it_holds() -> None:
    k_kpa = np.ma.MaskedArray([-9999.0, 5.0, np.nan, 7.0], mask=[True, False, True, False])
    depth_mm = np.ma.MaskedArray([[30.0], [-1.0]], mask=[[False], [True]])
    found = forward.force_n(k_kpa=k_kpa, depth_mm=depth_mm)
    assert isinstance(found, np.ma.MaskedArray)
    assert np.ma.getmaskarray(found).tolist() == [[True, False, True, False], [True] * 4]
    assert found[0, 1] == forward.force_n(k_kpa=5.0, depth_mm=30.0)
    by = forward.deflection_jacobian([80.0, 90.0], ["k_kpa"], k_kpa=k_kpa, depth_mm=30.0)
    assert by.shape == (4, 2, 1) and np.ma.getmaskarray(by)[2].all() and not np.ma.getmaskarray(by)[3].any()
    all_masked = forward.force_n(k_kpa=np.ma.MaskedArray(np.zeros(3), mask=True), depth_mm=30.0)
    assert np.ma.getmaskarray(all_masked).all()
    with pytest.raises(UsageError, match=r"k_kpa\[3\]: -7"):
        forward.force_n(k_kpa=np.ma.MaskedArray([-1.0, 5.0, 6.0, -7.0], mask=[True, False, False, False]), depth_mm=30.0)


def test_many_sets_are_solved_in_parts_that_signals_can_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forward, "_CHUNK", 4)
    z_mm, k_kpa = [65.0, 90.0], np.linspace(5.0, 15.0, 10).reshape(2, 5)
    values = {"k_kpa": k_kpa, "depth_mm": np.linspace(20.0, 40.0, 5)}
    force, shape = forward.force_n(**values), forward.deflection_mm(z_mm, **values)
    by = forward.deflection_jacobian(z_mm, ["k_kpa", "depth_mm"], **values)
    assert (force.shape, shape.shape, by.shape) == ((2, 5), (2, 5, 2), (2, 5, 2, 2))
    for i in range(2):
        for j in range(5):
            one = {"k_kpa": k_kpa[i, j], "depth_mm": values["depth_mm"][j]}
            assert force[i, j] == forward.force_n(**one)
            assert (shape[i, j] == forward.deflection_mm(z_mm, **one)).all()
            assert (by[i, j] == forward.deflection_jacobian(z_mm, ["k_kpa", "depth_mm"], **one)).all()
    with pytest.raises(UsageError, match=r"k_kpa\[9\]: -1 is out of range"):
        forward.force_n(k_kpa=[12.0] * 9 + [-1.0], depth_mm=30.0)

    calls: list[int] = []
    compiled = _core.forward

    def counting(sets: np.ndarray, *rest: Any) -> Any:
        calls.append(len(sets))
        if len(calls) == 2:
            raise KeyboardInterrupt
        return compiled(sets, *rest)

    monkeypatch.setattr(_core, "forward", counting)
    with pytest.raises(KeyboardInterrupt):
        forward.force_n(**values)
    assert calls == [4, 4]


def test_other_threads_run_meanwhile() -> None:
    counted = 0
    done = threading.Event()

    def count() -> None:
        nonlocal counted
        while not done.is_set():
            counted += 1

    thread = threading.Thread(target=count)
    before = counted
    thread.start()
    forward.force_jacobian(forward.PARAMETERS, k_kpa=np.linspace(1.0, 50.0, 20_000), depth_mm=30.0)
    during = counted - before
    done.set()
    thread.join()
    assert during > 100
