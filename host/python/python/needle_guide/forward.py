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
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._errors import UsageError

FloatArray = NDArray[np.float64]

Parameter = Literal[
    "k_kpa",
    "depth_mm",
    "displacement_mm",
    "guide2_mm",
    "entry_mm",
    "bending_stiffness_n_m2",
    "gap_mm",
    "skin_n_per_mm",
    "gradient_per_mm",
]
"""Name of a parameter."""

PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
"""Names of all parameters, as the compiled part orders them."""

GAUGE_18_N_M2: float = 200e9 * np.pi / 64 * (1.27e-3**4 - 1.0e-3**4)
"""Bending stiffness of an 18 gauge steel needle, N m^2."""

_CHUNK = 100_000
"""Sets per call of the compiled part. Python looks for signals between two calls only, so that their preparation must be short."""


def _broadcast(parameters: dict[str, ArrayLike]) -> tuple[list[FloatArray], tuple[int, ...], NDArray[np.bool_] | None]:
    """All parameters, broadcast against each other without copies, their shape, and which sets are masked in one of them."""
    columns: list[FloatArray] = []
    masks: list[NDArray[np.bool_]] = []
    for name, value in parameters.items():
        try:
            columns.append(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError):
            raise UsageError(f"{name}: holds something else than numbers") from None
        if isinstance(value, np.ma.MaskedArray):
            masks.append(np.ma.getmaskarray(value))
    try:
        shape = np.broadcast_shapes(*(column.shape for column in columns))
    except ValueError:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in zip(parameters, columns, strict=True))
        raise UsageError(f"shapes do not fit each other: {shapes}") from None
    mask = np.logical_or.reduce([np.broadcast_to(mask, shape) for mask in masks]) if masks else None
    # A parameter that is the same in every set needs no iterator.
    columns = [column.reshape(()) if column.size == 1 else np.broadcast_to(column, shape) for column in columns]
    return columns, shape, mask


_Results = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def _solve(parameters: dict[str, ArrayLike], places: FloatArray, wrt: list[int]) -> _Results:
    """Force, deflection and their derivatives, in the shape of the parameters."""
    columns, shape, mask = _broadcast(parameters)
    count = math.prod(shape)
    if mask is not None and not mask.all():
        # What is masked may hold anything: another set is solved in its place, so that errors count sets as the caller does.
        source = np.where(mask.ravel(), int(np.argmin(mask)), np.arange(count))
        columns = [column.flat[source] if column.ndim else column for column in columns]
    elif mask is not None:
        count = 0
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

    def shaped(found: FloatArray) -> FloatArray:
        if mask is None:
            return found.reshape((*shape, *found.shape[1:]))
        whole = np.empty((math.prod(shape), *found.shape[1:]))
        whole[: len(found)] = found
        masked: FloatArray = np.ma.MaskedArray(whole.reshape((*shape, *found.shape[1:])))
        masked[mask] = np.ma.masked
        return masked

    return shaped(results[0]), shaped(results[1]), shaped(results[2]), shaped(results[3])


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


def _columns(wrt: Parameter | Sequence[Parameter]) -> list[int]:
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    for name in names:
        if name not in PARAMETERS:
            raise UsageError(f"wrt: {name} is not a parameter, expected some of {', '.join(PARAMETERS)}")
    return [PARAMETERS.index(name) for name in names]


def _named(*values: ArrayLike) -> dict[str, ArrayLike]:
    """The parameters by their names."""
    return dict(zip(PARAMETERS, values, strict=True))


def force_n(
    *,
    k_kpa: ArrayLike,
    depth_mm: ArrayLike,
    displacement_mm: ArrayLike = 1.0,
    guide2_mm: ArrayLike = 60.0,
    entry_mm: ArrayLike = 70.0,
    bending_stiffness_n_m2: ArrayLike = GAUGE_18_N_M2,
    gap_mm: ArrayLike = 0.0,
    skin_n_per_mm: ArrayLike = 0.0,
    gradient_per_mm: ArrayLike = 0.0,
) -> FloatArray:
    """Force of guide 2 that holds the needle at its displacement, newtons.

    Args:
        k_kpa: foundation modulus.
        depth_mm: depth of the tip below the surface.
        displacement_mm: of guide 2.
        guide2_mm: place of guide 2 along the needle from guide 1.
        entry_mm: place of the surface along the needle from guide 1.
        bending_stiffness_n_m2: of the needle, N m^2 (18 gauge steel).
        gap_mm: depth above which nothing supports the needle.
        skin_n_per_mm: spring at the surface.
        gradient_per_mm: relative growth of the modulus with depth.

    Returns:
        Array of the shape of the parameters, masked where one of them is.

    Raises:
        UsageError: a parameter of another shape or out of range: ``name[number of the set]``.
    """
    parameters = _named(
        k_kpa,
        depth_mm,
        displacement_mm,
        guide2_mm,
        entry_mm,
        bending_stiffness_n_m2,
        gap_mm,
        skin_n_per_mm,
        gradient_per_mm,
    )
    return _solve(parameters, np.empty(0), [])[0]


def deflection_mm(
    z_mm: ArrayLike,
    *,
    k_kpa: ArrayLike,
    depth_mm: ArrayLike,
    displacement_mm: ArrayLike = 1.0,
    guide2_mm: ArrayLike = 60.0,
    entry_mm: ArrayLike = 70.0,
    bending_stiffness_n_m2: ArrayLike = GAUGE_18_N_M2,
    gap_mm: ArrayLike = 0.0,
    skin_n_per_mm: ArrayLike = 0.0,
    gradient_per_mm: ArrayLike = 0.0,
) -> FloatArray:
    """Deflection of the needle, millimetres.

    Args:
        z_mm: places along the needle from guide 1, millimetres: a number or one dimension.

    The parameters are those of :func:`force_n`.

    Returns:
        Array of the shape of the parameters, with an axis for the places at the end.
    """
    parameters = _named(
        k_kpa,
        depth_mm,
        displacement_mm,
        guide2_mm,
        entry_mm,
        bending_stiffness_n_m2,
        gap_mm,
        skin_n_per_mm,
        gradient_per_mm,
    )
    return _solve(parameters, _places(z_mm), [])[1]


def force_jacobian(
    wrt: Parameter | Sequence[Parameter] = ("k_kpa",),
    *,
    k_kpa: ArrayLike,
    depth_mm: ArrayLike,
    displacement_mm: ArrayLike = 1.0,
    guide2_mm: ArrayLike = 60.0,
    entry_mm: ArrayLike = 70.0,
    bending_stiffness_n_m2: ArrayLike = GAUGE_18_N_M2,
    gap_mm: ArrayLike = 0.0,
    skin_n_per_mm: ArrayLike = 0.0,
    gradient_per_mm: ArrayLike = 0.0,
) -> FloatArray:
    """Derivatives of the force of guide 2, newtons per unit of the parameter.

    By differences of fourth order; relative error about 1e-9, except by lengths where ``gradient_per_mm`` is not 0 (the modulus is
    taken as constant over slices of 0.5 mm).

    Args:
        wrt: parameters that it is differentiated by.

    The parameters are those of :func:`force_n`.

    Returns:
        Array of the shape of the parameters, with an axis for ``wrt`` at the end.
    """
    parameters = _named(
        k_kpa,
        depth_mm,
        displacement_mm,
        guide2_mm,
        entry_mm,
        bending_stiffness_n_m2,
        gap_mm,
        skin_n_per_mm,
        gradient_per_mm,
    )
    return _solve(parameters, np.empty(0), _columns(wrt))[2]


def deflection_jacobian(
    z_mm: ArrayLike,
    wrt: Parameter | Sequence[Parameter] = ("k_kpa",),
    *,
    k_kpa: ArrayLike,
    depth_mm: ArrayLike,
    displacement_mm: ArrayLike = 1.0,
    guide2_mm: ArrayLike = 60.0,
    entry_mm: ArrayLike = 70.0,
    bending_stiffness_n_m2: ArrayLike = GAUGE_18_N_M2,
    gap_mm: ArrayLike = 0.0,
    skin_n_per_mm: ArrayLike = 0.0,
    gradient_per_mm: ArrayLike = 0.0,
) -> FloatArray:
    """Derivatives of the deflection, millimetres per unit of the parameter; as :func:`force_jacobian`.

    Returns:
        Array of the shape of the parameters, with axes for the places and for ``wrt`` at the end.
    """
    parameters = _named(
        k_kpa,
        depth_mm,
        displacement_mm,
        guide2_mm,
        entry_mm,
        bending_stiffness_n_m2,
        gap_mm,
        skin_n_per_mm,
        gradient_per_mm,
    )
    return np.moveaxis(_solve(parameters, _places(z_mm), _columns(wrt))[3], -2, -1)
