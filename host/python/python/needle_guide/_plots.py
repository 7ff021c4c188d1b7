"""Figures with matplotlib, for axes of the caller's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ._population import Population
    from ._results import IdentifiedRun, PredictedInsertion, TrackedRun


def axes(ax: Axes | None) -> Axes:
    """The caller's axes, or new ones.

    Raises:
        ImportError: matplotlib is not installed.
    """
    if ax is not None:
        return ax
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise ImportError("figures need matplotlib: pip install 'needle-guide[frames]'") from error
    return pyplot.subplots(layout="constrained")[1]


def _colours() -> list[Any]:
    from matplotlib import pyplot

    return list(pyplot.rcParams["axes.prop_cycle"].by_key()["color"])


def shape(run: IdentifiedRun, ax: Axes | None) -> Axes:
    """Needle shape of every hold, measured (dots) and fitted (lines)."""
    ax, colours = axes(ax), _colours()
    for number, one in enumerate(run.shapes):
        colour = colours[number % len(colours)]
        ax.plot(one[:, 0], one[:, 1], ".", color=colour)
        ax.plot(one[:, 0], one[:, 2], "-", color=colour)
    ax.set(xlabel="position along the needle, mm", ylabel="deflection, mm", title=run.id)
    return ax


def path(one: PredictedInsertion, ax: Axes | None) -> Axes:
    """Tip over depth: predicted with its 95 % band, and measured."""
    ax = axes(ax)
    ax.fill_between(one.depth_mm, one.tip_y_ci95_mm[:, 0], one.tip_y_ci95_mm[:, 1], alpha=0.2, label="95 % band")
    ax.plot(one.depth_mm, one.tip_y_mm, label="predicted")
    ax.plot(one.depth_mm, one.measured_y_mm, ".", label="measured")
    ax.set(xlabel="depth, mm", ylabel="vertical position of the tip, mm", title=one.id)
    ax.legend()
    return ax


def stiffness(run: TrackedRun, ax: Axes | None) -> Axes:
    """Stiffness of the tissue over depth with its 95 % interval."""
    ax = axes(ax)
    ends = run.stiffness_ci95_n_per_m2
    ax.fill_between(run.depth_mm, ends[:, 0], ends[:, 1], alpha=0.2, label="95 % interval")
    ax.plot(run.depth_mm, run.stiffness_n_per_m2, label="stiffness")
    ax.set(xlabel="depth, mm", ylabel="stiffness, N/m$^2$", title=run.id)
    ax.legend()
    return ax


def forest(found: Population, ax: Axes | None) -> Axes:
    """K of every session with its interval, and the mean of every group with the interval of a new subject."""
    ax, colours = axes(ax), _colours()
    rows = sorted(found.rows, key=lambda row: (row.group, row.session))
    names = [row.session for row in rows] + [f"mean of {group.name}" for group in found.groups]

    def line(place: int, value: float, ends: Sequence[float], **style: Any) -> None:
        low, high = ends
        ax.errorbar(value, place, xerr=np.array([[value - low], [high - value]]), fmt="o", **style)

    for place, row in enumerate(rows):
        line(place, row.k_kpa, row.k_kpa.ci95 or (row.k_kpa,) * 2, color=colours[0] if row.used else "0.6", markersize=3)
    for place, group in enumerate(found.groups, len(rows)):
        if group.new_subject95_kpa is not None:
            line(place, group.k_kpa, group.new_subject95_kpa, color=colours[1], linewidth=1)
        line(place, group.k_kpa, group.k_kpa.ci95 or (group.k_kpa,) * 2, color=colours[1], linewidth=3)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.set(xscale="log", xlabel="K, kPa")
    # Within a decade or two powers of ten say less than plain numbers.
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("{x:g}")
    return ax


def levels(found: Population, ax: Axes | None) -> Axes:
    """Standard deviation of ln K of every level of every group with its interval, percent."""
    ax = axes(ax)
    all_of_them = [(f"{group.name}: {level.name}", level.tau) for group in found.groups for level in group.levels]
    known = [(name, tau) for name, tau in all_of_them if tau is not None]
    for place, (_, tau) in enumerate(known):
        low, high = tau.ci95 or (tau, tau)
        ends = np.array([[tau - low], [high - tau]])
        ax.errorbar(100 * tau, place, xerr=100 * ends, fmt="o", color=_colours()[0])
    ax.set_yticks(range(len(known)), [name for name, _ in known])
    ax.invert_yaxis()
    ax.set(xlabel="standard deviation of ln K, %")
    return ax
