"""The forward model over arrays: force of guide 2, shape of the needle, and their derivatives.

The needle is a beam, clamped in guide 1 and held at a displacement by guide 2, in tissue of springs (theory, eq. 1 to 5). All functions
take the same parameters, each a number or an array; arrays are broadcast against each other, and results have their shape. The
computation releases the interpreter lock and can be interrupted.

>>> from needle_guide import forward
>>> round(float(forward.force_n(k_kpa=12.0, depth_mm=30.0, displacement_mm=1.2)), 3)
1.115
>>> import numpy as np
>>> forward.deflection_mm([70.0, 100.0], k_kpa=np.linspace(5.0, 20.0, 4), depth_mm=30.0).shape
(4, 2)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._errors import UsageError

FloatArray = NDArray[np.float64]

PARAMETERS: tuple[str, ...] = tuple(_core.PARAMETERS)
"""Names of all parameters."""

GAUGE_18_N_M2: float = 200e9 * np.pi / 64 * (1.27e-3**4 - 1.0e-3**4)
"""Bending stiffness of an 18 gauge steel needle, N m^2."""

_DEFAULTS: dict[str, float] = {
    "displacement_mm": 1.0,
    "guide2_mm": 60.0,
    "entry_mm": 70.0,
    "bending_stiffness_n_m2": GAUGE_18_N_M2,
    "gap_mm": 0.0,
    "skin_n_per_mm": 0.0,
    "gradient_per_mm": 0.0,
}


_CHUNK = 100_000
"""Sets per call of the compiled part. Python looks for signals between two calls only, so that their preparation must be short."""


def _broadcast(parameters: dict[str, ArrayLike]) -> tuple[list[FloatArray], tuple[int, ...]]:
    """All parameters, broadcast against each other without copies, and their shape."""
    for name in parameters:
        if name not in PARAMETERS:
            raise UsageError(f"{name}: is not a parameter, expected one of {', '.join(PARAMETERS)}")
    columns: list[FloatArray] = []
    for name in PARAMETERS:
        value = parameters.get(name, _DEFAULTS.get(name))
        if value is None:
            raise UsageError(f"{name}: missing, expected a number or an array")
        try:
            columns.append(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError):
            raise UsageError(f"{name}: holds something else than numbers") from None
    try:
        shape = np.broadcast_shapes(*(column.shape for column in columns))
    except ValueError:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in zip(PARAMETERS, columns, strict=True))
        raise UsageError(f"shapes do not fit each other: {shapes}") from None
    # A parameter that is the same in every set needs no iterator.
    return [column.reshape(()) if column.size == 1 else np.broadcast_to(column, shape) for column in columns], shape


def _solve(
    parameters: dict[str, ArrayLike], places: FloatArray, wrt: list[int]
) -> tuple[tuple[int, ...], tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Shape of the parameters; force, deflection and their derivatives, set by set."""
    columns, shape = _broadcast(parameters)
    count = math.prod(shape)
    results = (
        np.empty(count),
        np.empty((count, len(places))),
        np.empty((count, len(wrt))),
        np.empty((count, len(wrt), len(places))),
    )
    for first in range(0, count, _CHUNK):
        chunk = slice(first, min(first + _CHUNK, count))
        sets = np.empty((chunk.stop - first, len(PARAMETERS)))
        for number, column in enumerate(columns):
            sets[:, number] = column.flat[chunk] if column.ndim else column
        for result, part in zip(results, _core.forward(sets, places, wrt, first), strict=True):
            result[chunk] = part
    return shape, results


def _places(z_mm: ArrayLike) -> FloatArray:
    try:
        places = np.asarray(z_mm, dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError("z_mm: holds something else than numbers") from None
    if places.ndim > 1:
        raise UsageError(f"z_mm: shape {places.shape}, expected a number or one dimension")
    if not np.isfinite(places).all():
        raise UsageError("z_mm: holds a value that is not finite, expected places along the needle")
    return np.atleast_1d(places)


def _columns(wrt: Sequence[str]) -> list[int]:
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    for name in names:
        if name not in PARAMETERS:
            raise UsageError(f"wrt: {name} is not a parameter, expected some of {', '.join(PARAMETERS)}")
    return [PARAMETERS.index(name) for name in names]


def force_n(**parameters: Any) -> FloatArray:
    """Force of guide 2 that holds the needle at its displacement, newtons.

    Args:
        parameters: ``k_kpa`` (foundation modulus) and ``depth_mm`` (of the tip below the surface); ``displacement_mm`` of guide 2 (1),
            ``guide2_mm`` (60) and ``entry_mm`` (70), places of guide 2 and of the surface along the needle from guide 1,
            ``bending_stiffness_n_m2`` (18 gauge steel), ``gap_mm`` (0), depth above which nothing supports the needle,
            ``skin_n_per_mm`` (0), spring at the surface, ``gradient_per_mm`` (0), relative growth of the modulus with depth.

    Returns:
        Array of the shape of the parameters.

    Raises:
        UsageError: a parameter that is missing, not known, of another shape or out of range: ``name[number of the set]``.
    """
    shape, (force, _, _, _) = _solve(parameters, np.empty(0), [])
    return force.reshape(shape)


def deflection_mm(z_mm: ArrayLike, **parameters: Any) -> FloatArray:
    """Deflection of the needle, millimetres.

    Args:
        z_mm: places along the needle from guide 1, millimetres: a number or one dimension.
        parameters: as of :func:`force_n`.

    Returns:
        Array of the shape of the parameters, with an axis for the places at the end.
    """
    places = _places(z_mm)
    shape, (_, deflection, _, _) = _solve(parameters, places, [])
    return deflection.reshape(*shape, len(places))


def force_jacobian(wrt: Sequence[str] = ("k_kpa",), **parameters: Any) -> FloatArray:
    """Derivatives of the force of guide 2, newtons per unit of the parameter.

    By differences of fourth order; relative error about 1e-9, except by lengths where ``gradient_per_mm`` is not 0 (the modulus is
    taken as constant over slices of 0.5 mm).

    Args:
        wrt: parameters that it is differentiated by.
        parameters: as of :func:`force_n`.

    Returns:
        Array of the shape of the parameters, with an axis for ``wrt`` at the end.
    """
    columns = _columns(wrt)
    shape, (_, _, jacobian, _) = _solve(parameters, np.empty(0), columns)
    return jacobian.reshape(*shape, len(columns))


def deflection_jacobian(z_mm: ArrayLike, wrt: Sequence[str] = ("k_kpa",), **parameters: Any) -> FloatArray:
    """Derivatives of the deflection, millimetres per unit of the parameter; as :func:`force_jacobian`.

    Returns:
        Array of the shape of the parameters, with axes for the places and for ``wrt`` at the end.
    """
    places, columns = _places(z_mm), _columns(wrt)
    shape, (_, _, _, jacobian) = _solve(parameters, places, columns)
    return np.moveaxis(jacobian, 1, 2).reshape(*shape, len(places), len(columns))
