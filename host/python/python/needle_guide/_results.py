"""Typed results of the commands over one session."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import _plots
from ._units import parameter
from ._values import Document, FloatArray, Quantity, Records, Result, array, band, columns, quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Finding:
    """An error or a warning about a session.

    Attributes:
        severity: "error" or "warning".
        what: what is there.
        expected: what was expected, where there is one answer.
        file: the file.
        line: line in it, from 1.
        column: column in that line, in characters from 1.
    """

    severity: str
    what: str
    expected: str | None
    file: str
    line: int | None
    column: int | None

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        return f"{place}: {self.what}" + (f", expected {self.expected}" if self.expected else "")


class Check(Result):
    """Whether a session can be used, and by which command."""

    @property
    def usable(self) -> bool:
        """Whether any command can use it."""
        return bool(self._document["usable"])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Errors and warnings."""
        names = ("severity", "what", "expected", "file", "line", "column")
        return tuple(Finding(*(one.get(name) for name in names)) for one in self._document["findings"])

    @property
    def usable_by(self) -> tuple[str, ...]:
        """Commands that can use it."""
        return tuple(one["command"] for one in self._document["abilities"] if one["usable"])

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("usable", "yes" if self.usable else "no"),
            ("usable by", ", ".join(self.usable_by)),
            *((one.severity, str(one)) for one in self.findings),
        ]

    def _records(self) -> Records:
        return [asdict(one) for one in self.findings]


class IdentifiedRun:
    """One lateral run."""

    def __init__(self, document: Document) -> None:
        self._document = document

    @property
    def id(self) -> str:
        """Name of the run."""
        return str(self._document["id"])

    @property
    def depth_mm(self) -> float:
        """Insertion depth, millimetres."""
        return float(self._document["depth_mm"])

    @property
    def k_kpa(self) -> Quantity | None:
        """Foundation modulus by the likelihood of the beam, kilopascals."""
        return self.method_k_kpa("likelihood")

    def method_k_kpa(self, method: str) -> Quantity | None:
        """The same by "likelihood", "likelihood_without_force", "energy" or "energy_as_printed"."""
        return quantity(self._document["methods"].get(method) or {}, "k_kpa", "kPa", "ci95_kpa", "sd_kpa")

    @property
    def shapes(self) -> tuple[FloatArray, ...]:
        """Shape of every hold: rows of position along the needle, measured and fitted deflection, millimetres; shape (points, 3)."""
        columns = ("z_mm", "measured_mm", "fitted_mm")
        return tuple(np.stack([array(one[name]) for name in columns], axis=1) for one in self._document["shape"])

    @property
    def error(self) -> str | None:
        """Why it could not be used."""
        error = self._document.get("error")
        return None if error is None else str(error)

    def plot_shape(self, ax: Axes | None = None) -> Axes:
        """Draws the needle shape of every hold, measured and fitted, with matplotlib."""
        return _plots.shape(self, ax)

    def __repr__(self) -> str:
        return f"<IdentifiedRun {self.id}: {self.error or self.k_kpa}>"


class Identification(Result):
    """Modulus of the tissue from the lateral runs of a session."""

    @property
    def k_kpa(self) -> Quantity:
        """Foundation modulus K over all runs, kilopascals, with the interval that includes the model's error."""
        found = quantity(self._document["pooled"], "k_kpa", "kPa", "ci95_kpa", "sd_kpa")
        assert found is not None  # noqa: S101 - the document always has it
        return found

    @property
    def youngs_modulus_kpa(self) -> Quantity | None:
        """Young's modulus E, kilopascals; none where the data do not allow it."""
        return quantity(self._document.get("youngs_modulus_kpa") or {}, "value", "kPa", "ci95")

    @property
    def foundation(self) -> str | None:
        """Model of the tissue: "springs" or "body"."""
        found = self._document.get("foundation")
        return None if found is None else str(found["used"])

    @property
    def runs(self) -> tuple[IdentifiedRun, ...]:
        """Every run by itself."""
        return tuple(IdentifiedRun(one) for one in self._document["runs"])

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("K", str(self.k_kpa))]
        if self.youngs_modulus_kpa is not None:
            rows.append(("Young's modulus", str(self.youngs_modulus_kpa)))
        return rows + [(f"K of {run.id}", str(run.k_kpa or run.error)) for run in self.runs]

    def _records(self) -> Records:
        """One row per run."""
        return [
            {"run": run.id, "depth_mm": run.depth_mm, **columns({"k_kpa": run.k_kpa}), "error": run.error}
            for run in self.runs
        ]


class PredictedInsertion:
    """One insertion: measured up to a depth, predicted beyond."""

    def __init__(self, document: Document) -> None:
        self._document = document

    @property
    def id(self) -> str:
        """Name of the insertion."""
        return str(self._document["id"])

    @property
    def tip_force_n(self) -> Quantity | None:
        """Vertical load on the tip at the last depth that was used, newtons."""
        return quantity(self._document, "tip_force_n", "N", "tip_force_ci95_n", "tip_force_sd_n")

    @property
    def tip_force_x_n(self) -> Quantity | None:
        """Horizontal load, newtons."""
        return quantity(self._document, "tip_force_x_n", "N", "tip_force_x_ci95_n", "tip_force_x_sd_n")

    @property
    def k_kpa(self) -> Quantity | None:
        """Foundation modulus, kilopascals."""
        return quantity(self._document.get("learned") or {}, "k_kpa", "kPa", "k_ci95_kpa")

    @property
    def gap_mm(self) -> Quantity | None:
        """Effective gap: distance from guide 2 to where the tissue holds the needle, millimetres."""
        return quantity(self._document.get("learned") or {}, "gap_mm", "mm", "gap_ci95_mm")

    @property
    def depth_mm(self) -> FloatArray:
        """Depths, millimetres: shape (n,), as all arrays of the path."""
        return array(self._document.get("depth_mm"))

    @property
    def tip_y_mm(self) -> FloatArray:
        """Vertical position of the tip, millimetres."""
        return array(self._document.get("tip_y_mm"))

    @property
    def tip_y_ci95_mm(self) -> FloatArray:
        """Its 95 % band, millimetres: shape (n, 2)."""
        return band(self._document.get("lo95_y_mm"), self._document.get("hi95_y_mm"))

    @property
    def measured_y_mm(self) -> FloatArray:
        """Measured position, millimetres; NaN where there is none."""
        return array(self._document.get("measured_y_mm"))

    @property
    def tip_x_mm(self) -> FloatArray:
        """Horizontal position of the tip, millimetres; empty where it was not measured."""
        return array(self._document.get("tip_x_mm"))

    @property
    def tip_x_ci95_mm(self) -> FloatArray:
        """Its 95 % band, millimetres: shape (n, 2)."""
        return band(self._document.get("lo95_x_mm"), self._document.get("hi95_x_mm"))

    @property
    def measured_x_mm(self) -> FloatArray:
        """Measured position, millimetres; NaN where there is none."""
        return array(self._document.get("measured_x_mm"))

    @property
    def error(self) -> str | None:
        """Why it could not be predicted."""
        error = self._document.get("error")
        return None if error is None else str(error)

    def plot_path(self, ax: Axes | None = None) -> Axes:
        """Draws the predicted tip with its band, and the measured one, with matplotlib."""
        return _plots.path(self, ax)

    def __repr__(self) -> str:
        return f"<PredictedInsertion {self.id}: {self.error or self.tip_force_n}>"


class Prediction(Result):
    """Tip load and path of every insertion of a session."""

    @property
    def insertions(self) -> tuple[PredictedInsertion, ...]:
        """The insertions."""
        return tuple(PredictedInsertion(one) for one in self._document["insertions"])

    def _rows(self) -> list[tuple[str, str]]:
        return [(f"tip load of {one.id}", str(one.tip_force_n or one.error)) for one in self.insertions]

    def _records(self) -> Records:
        """One row per depth of every insertion."""
        return [
            {
                "insertion": one.id,
                "depth_mm": depth_mm,
                "tip_y_mm": tip_y_mm,
                "tip_y_low_mm": low,
                "tip_y_high_mm": high,
                "measured_y_mm": measured_y_mm,
            }
            for one in self.insertions
            for depth_mm, tip_y_mm, (low, high), measured_y_mm in zip(
                one.depth_mm, one.tip_y_mm, one.tip_y_ci95_mm, one.measured_y_mm, strict=True
            )
        ]


class TrackedRun:
    """One steering run, over its insertion depth; all arrays have shape (n,) or (n, 2)."""

    def __init__(self, document: Document) -> None:
        self._document = document

    @property
    def id(self) -> str:
        """Name of the run."""
        return str(self._document["id"])

    @property
    def depth_mm(self) -> FloatArray:
        """Depths, millimetres."""
        return array(self._document["depth_mm"])

    @property
    def stiffness_n_per_m2(self) -> FloatArray:
        """Stiffness of the tissue, newtons per square metre; NaN where it is not identifiable yet."""
        return array(self._document["stiffness_n_per_m2"])

    @property
    def stiffness_ci95_n_per_m2(self) -> FloatArray:
        """Its 95 % interval."""
        return band(self._document["stiffness_lo95_n_per_m2"], self._document["stiffness_hi95_n_per_m2"])

    @property
    def damping_n_s_per_m2(self) -> FloatArray:
        """Damping of the tissue, newton seconds per square metre; NaN where it is not identifiable yet."""
        return array(self._document["damping_n_s_per_m2"])

    @property
    def damping_ci95_n_s_per_m2(self) -> FloatArray:
        """Its 95 % interval."""
        return band(self._document["damping_lo95_n_s_per_m2"], self._document["damping_hi95_n_s_per_m2"])

    @property
    def tip_y_mm(self) -> FloatArray:
        """Computed position of the tip, millimetres."""
        return array(self._document["tip_y_mm"])

    @property
    def measured_tip_y_mm(self) -> FloatArray:
        """Measured position of the tip, millimetres."""
        return array(self._document["measured_tip_y_mm"])

    @property
    def last_stiffness_n_per_m2(self) -> Quantity | None:
        """Stiffness at the end of the run."""
        last = self._document.get("last") or {}
        return quantity(last.get("stiffness_n_per_m2") or {}, "value", "N/m^2", "ci95")

    def plot_stiffness(self, ax: Axes | None = None) -> Axes:
        """Draws the stiffness of the tissue over depth with its interval, with matplotlib."""
        return _plots.stiffness(self, ax)

    def __repr__(self) -> str:
        return f"<TrackedRun {self.id}: {self.last_stiffness_n_per_m2}>"


class Tracking(Result):
    """Stiffness and damping of the tissue online, over the steering runs of a session."""

    @property
    def runs(self) -> tuple[TrackedRun, ...]:
        """The runs."""
        return tuple(TrackedRun(one) for one in self._document["runs"])

    def _rows(self) -> list[tuple[str, str]]:
        return [(f"stiffness of {one.id}", str(one.last_stiffness_n_per_m2)) for one in self.runs]

    def _records(self) -> Records:
        """One row per depth of every run."""
        return [
            {
                "run": run.id,
                "depth_mm": depth_mm,
                "stiffness_n_per_m2": stiffness,
                "stiffness_low_n_per_m2": low,
                "stiffness_high_n_per_m2": high,
            }
            for run in self.runs
            for depth_mm, stiffness, (low, high) in zip(
                run.depth_mm, run.stiffness_n_per_m2, run.stiffness_ci95_n_per_m2, strict=True
            )
        ]


@dataclass(frozen=True)
class Effect:
    """An effect that the plain model lacks.

    Attributes:
        id: name in the catalogue, such as "tissue.layers".
        parameters: values with their intervals, by name; units are in the names.
        log_evidence_gain: rise of the log evidence by it, nats.
        competing: effects that explain the data equally well, itself included.
    """

    id: str
    parameters: dict[str, Quantity]
    log_evidence_gain: float
    competing: tuple[str, ...]


class Diagnosis(Result):
    """Where model and measurement disagree, and which effect is missing."""

    @property
    def verdict(self) -> str:
        """Verdict, such as "named" or "ambiguous"."""
        return str(self._document["verdict"])

    @property
    def k_kpa(self) -> Quantity:
        """Foundation modulus with the effects in the model, kilopascals."""
        found = quantity(self._document, "k_kpa", "kPa", "k_ci95_kpa")
        assert found is not None  # noqa: S101 - the document always has it
        return found

    @property
    def tip_load_n(self) -> Quantity | None:
        """Load on the tip, newtons."""
        return quantity(self._document, "tip_load_n", "N", "tip_load_ci95_n")

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects that were named."""
        return tuple(_effect(one) for one in self._document["effects"])

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("verdict", self.verdict), ("K", str(self.k_kpa))]
        for effect in self.effects:
            values = ", ".join(f"{name} {value}" for name, value in effect.parameters.items())
            rows.append((effect.id, values))
        return rows

    def _records(self) -> Records:
        """One row per parameter of every effect."""
        return [
            {
                "effect": effect.id,
                "parameter": name,
                "unit": value.unit,
                **columns({"value": value}),
                "log_evidence_gain": effect.log_evidence_gain,
            }
            for effect in self.effects
            for name, value in effect.parameters.items()
        ]


def _effect(one: Document) -> Effect:
    values = {name: parameter(one["id"], name, value) for name, value in one["parameters"].items()}
    return Effect(str(one["id"]), values, float(one["log_evidence_gain"]), tuple(one["class"]))


class Summary(Result):
    """Record of a session for statistics over many (``needle.summary/1``); a session that failed has an error."""

    def __init__(self, line: str) -> None:
        super().__init__(json.loads(line))
        self._line = line

    @property
    def session(self) -> str:
        """Path of the session as it was given; of one from arrays its name."""
        return str(self._document["session"])

    @property
    def error(self) -> str | None:
        """Why there is no result."""
        error = self._document.get("error")
        return None if error is None else str(error)

    @property
    def k_kpa(self) -> Quantity | None:
        """Foundation modulus with the effects in the model, kilopascals."""
        return quantity(self._document.get("result") or {}, "k_kpa", "kPa", "k_ci95_kpa")

    def to_json(self) -> str:
        """One line of JSON, as ``guide summarize`` writes it, without its end."""
        return self._line

    def _rows(self) -> list[tuple[str, str]]:
        return [("session", self.session), ("K", str(self.k_kpa if self.error is None else self.error))]

    def _records(self) -> Records:
        labels = ("session", "date", "site", "subject", "rig", "needle", "tissue")
        stated = {name: self._document.get(name) for name in labels}
        return [{**stated, **(self._document.get("covariates") or {}), **columns({"k_kpa": self.k_kpa}), "error": self.error}]
