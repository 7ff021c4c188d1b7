"""Numbers with their interval, and what all results have in common."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pandas import DataFrame

Document = dict[str, Any]
Records = list[dict[str, Any]]
FloatArray = NDArray[np.float64]


class Quantity(float):
    """A number with its unit, its 95 % interval and its standard deviation.

    It is a ``float``, so that it can be used wherever one can.

    >>> k = Quantity(17.1, "kPa", ci95=(14.7, 19.9), sd=1.1)
    >>> print(k)
    17.10 kPa (14.70 to 19.90)
    >>> k.ci95, round(2.0 * k, 1)
    ((14.7, 19.9), 34.2)
    """

    unit: str
    ci95: tuple[float, float] | None
    sd: float | None

    def __new__(
        cls,
        value: float,
        unit: str = "",
        ci95: tuple[float, float] | None = None,
        sd: float | None = None,
    ) -> Quantity:
        self = super().__new__(cls, value)
        self.unit = unit
        self.ci95 = ci95
        self.sd = sd
        return self

    def __getnewargs__(self) -> tuple[float, str, tuple[float, float] | None, float | None]:  # type: ignore[override]
        return float(self), self.unit, self.ci95, self.sd

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if self.ci95 is None:
            return f"{float(self):.2f}{unit}"
        return f"{float(self):.2f}{unit} ({self.ci95[0]:.2f} to {self.ci95[1]:.2f})"

    def __repr__(self) -> str:
        return f"Quantity({float(self)!r}, {self.unit!r}, ci95={self.ci95!r}, sd={self.sd!r})"


def interval(ends: Any) -> tuple[float, float] | None:
    """An interval of a document."""
    return None if ends is None else (float(ends[0]), float(ends[1]))


def quantity(of: Mapping[str, Any], name: str, unit: str, ci95: str = "", sd: str = "") -> Quantity | None:
    """A number of a document, with interval and standard deviation where they are stated under these names."""
    value = of.get(name)
    if value is None:
        return None
    spread = of.get(sd)
    return Quantity(value, unit, interval(of.get(ci95)), None if spread is None else float(spread))


def array(values: Any) -> FloatArray:
    """Numbers of a document; NaN where there is none."""
    return np.asarray([np.nan if value is None else value for value in values or ()], dtype=np.float64)


def band(low: Any, high: Any) -> FloatArray:
    """Ends of intervals, one row each: shape (n, 2)."""
    return np.stack([array(low), array(high)], axis=1)


def columns(names: Mapping[str, Quantity | None]) -> dict[str, Any]:
    """Numbers as columns of a table, each with the ends of its interval."""
    found: dict[str, Any] = {}
    for name, value in names.items():
        found[name] = None if value is None else float(value)
        ends = (None, None) if value is None or value.ci95 is None else value.ci95
        stem, unit = _split(name)
        found[f"{stem}_low{unit}"], found[f"{stem}_high{unit}"] = ends
    return found


_UNITS = ("_n_per_m2", "_n_s_per_m2", "_kpa", "_mm", "_n")


def _split(name: str) -> tuple[str, str]:
    """A name and its unit."""
    unit = next((unit for unit in _UNITS if name.endswith(unit)), "")
    return name.removesuffix(unit), unit


def frame(records: Records) -> DataFrame:
    """A table of pandas.

    Raises:
        ImportError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise ImportError("tables need pandas: pip install 'needle-guide[frames]'") from error
    return pandas.DataFrame.from_records(records)


class Figures(dict[str, str]):
    """Figures by name, each the text of an SVG picture; notebooks show all of them."""

    def _repr_html_(self) -> str:
        return "\n".join(f"<div>{svg}</div>" for svg in self.values())

    def save(self, folder: str) -> list[str]:
        """Writes every figure as a file ``NAME.svg`` into a folder that is there; returns their paths."""
        import pathlib
        import re

        paths = []
        for name, svg in self.items():
            path = pathlib.Path(folder) / (re.sub(r"[^A-Za-z0-9_.-]", "_", name) + ".svg")
            path.write_text(svg, encoding="utf-8")
            paths.append(str(path))
        return paths


class Result:
    """What a command has found.

    Attributes:
        notes: remarks of the command beside its result.
        figures: its figures.
    """

    def __init__(
        self, document: Document, notes: list[str] | None = None, figures: Mapping[str, str] | None = None
    ) -> None:
        self._document = document
        self.notes = list(notes or [])
        self.figures = Figures(figures or {})

    def to_dict(self) -> Document:
        """The document that the command prints with ``--json``, as a copy."""
        copy: Document = json.loads(json.dumps(self._document))
        return copy

    def plot(self, name: str | None = None) -> Figures:
        """The figures, or the one of this name: what the command draws with ``--plots``.

        Raises:
            UsageError: there is no figure of that name.
        """
        if name is None:
            return self.figures
        if name not in self.figures:
            from ._errors import UsageError

            raise UsageError(f'name: "{name}" is not drawn, expected one of {", ".join(self.figures) or "none"}')
        return Figures({name: self.figures[name]})

    def to_dataframe(self) -> DataFrame:
        """The result as a table of pandas, one row per part; units are in the names of its columns.

        Raises:
            ImportError: pandas is not installed.
        """
        return frame(self._records())

    def _records(self) -> Records:
        """Rows of that table."""
        return [dict(self._rows())]

    @property
    def schema(self) -> str:
        """Name and version of the document."""
        return str(self._document["schema"])

    @property
    def warnings(self) -> list[str]:
        """What limits the result."""
        return [str(warning) for warning in self._document.get("warnings") or ()]

    def _rows(self) -> list[tuple[str, str]]:
        """Name and text of the lines of the table that notebooks show."""
        return []

    def _repr_html_(self) -> str:
        rows = self._rows() + [("warning", warning) for warning in self.warnings]
        cells = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in rows)
        return f"<table><caption>{html.escape(self.schema)}</caption>{cells}</table>"

    def __repr__(self) -> str:
        rows = ", ".join(f"{name}: {text}" for name, text in self._rows()[:4])
        return f"<{type(self).__name__} {rows}>"
