"""Where a model and measurements disagree, and which law is missing, for a model that is a Python function.

>>> import numpy as np
>>> from needle_guide import discrepancy
>>> def force(parameters, terms, run):
...     return parameters["mass"] * run["acceleration"] + parameters["viscous"] * run["speed"]
>>> def measured(name, hz, judges):
...     t = np.arange(0.0, 6.0, 0.02)
...     v, a = np.sin(hz * t) + 0.3 * np.sin(2.3 * hz * t), hz * np.cos(hz * t) + 0.69 * hz * np.cos(2.3 * hz * t)
...     noise = 0.03 * np.random.default_rng(int(hz)).standard_normal(t.size)
...     dry = 0.5 * np.sign(v)
...     channels = {"force": 2.2 * a + 0.8 * v + dry + noise}
...     return discrepancy.Run(name, t, channels, {"speed": v, "acceleration": a}, judges=judges)
>>> found = discrepancy.diagnose(
...     force,
...     [measured("slow", 3.0, False), measured("fast", 4.0, True)],
...     parameters={"mass": (2.0, 1.0), "viscous": (1.0, 1.0)},
...     sites={"friction": {"adds_to": "force", "regressors": ["speed"], "unit": "N"}},
... )
>>> found.missing
['friction/speed/sign']
>>> 0.4 < found.terms["friction/speed/sign"]["a"] < 0.6
True
>>> list(found.parts)
['friction/reversal']

A site is a place in the model at which a law may be missing. Where the law is simply added to a channel, ``adds_to`` names it, and the
regressors are known columns of the runs. Else the model adds ``terms("friction", speed=v)`` in its equations.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from ._errors import UsageError
from ._values import Document, Quantity, Records, Result

FloatArray = NDArray[np.float64]
Terms = _core.DiscrepancyTerms
"""The laws that a model adds: ``terms(site, regressor=value, ...)`` is a number or an array, zero in the plain model."""

Model = Callable[[dict[str, float], Terms, Mapping[str, FloatArray]], Any]
"""``model(parameters, terms, run)`` returns an array for every channel by name, or one array where there is one channel. ``run`` has
``time_s`` and the known columns."""

__all__ = ["Diagnosis", "Model", "Run", "Terms", "diagnose"]


@dataclass(frozen=True)
class Run:
    """One experiment.

    Attributes:
        name: its name, for messages.
        time_s: instants, increasing.
        channels: what the model predicts, by name; NaN where there is no reading.
        columns: what is known: inputs, places.
        sds: standard deviations of readings of a channel, relative to each other: their scale is estimated.
        units: units of channels.
        judges: whether it is held out of all fits and judges them.
    """

    name: str
    time_s: ArrayLike
    channels: Mapping[str, ArrayLike]
    columns: Mapping[str, ArrayLike] = field(default_factory=dict)
    sds: Mapping[str, ArrayLike] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    judges: bool = False


class Diagnosis(Result):
    """What a diagnosis has found: the document ``discrepancy.diagnosis/1``."""

    def __init__(self, document: Document, text: str) -> None:
        super().__init__(document, list(document["notes"]))
        self._text = text

    def __str__(self) -> str:
        return self._text

    def _repr_html_(self) -> str:
        import html

        return f"<pre>{html.escape(self._text)}</pre>"

    @property
    def verdict(self) -> str:
        """``adequate``, ``explained``, ``ambiguous``, ``partial`` or ``unexplained``."""
        return str(self._document["verdict"])

    @property
    def missing(self) -> list[str]:
        """Laws that were added, as ``site/regressor/form``."""
        return [_identifier(term) for term in self._document["terms"]]

    @property
    def terms(self) -> dict[str, dict[str, Quantity]]:
        """Numbers of these laws."""
        return {_identifier(term): {one["name"]: _quantity(one) for one in term["values"]} for term in self._document["terms"]}

    @property
    def parts(self) -> dict[str, Quantity]:
        """Named parts of what the laws of a site add together, whichever laws these are: ``site/offset``, in both directions alike, as the mean over the
        data, and ``site/reversal``, half the change from one direction to the other: of a force all dry friction."""
        kinds = {"offset": self._document["offsets"], "reversal": self._document["reversals"]}
        return {f"{one['name']}/{kind}": _quantity(one) for kind, parts in kinds.items() for one in parts if one["is_named"]}

    @property
    def parameters(self) -> dict[str, Quantity]:
        """Parameters of the model with these laws."""
        return {one["name"]: _quantity(one) for one in self._document["parameters"]}

    def _records(self) -> Records:
        return [{"name": name, **value.__dict__, "value": float(value)} for name, value in self.parameters.items()]


def _identifier(term: Mapping[str, Any]) -> str:
    return "/".join(part for part in (term["site"], term["regressor"], term["form"]) if part)


def _quantity(one: Mapping[str, Any]) -> Quantity:
    low, high = one["ci95"]
    return Quantity(one["value"], one["unit"], (low, high), one["sd"])


def diagnose(
    model: Model,
    data: Sequence[Run],
    *,
    parameters: Mapping[str, Mapping[str, Any] | tuple[float, float]],
    sites: Mapping[str, Mapping[str, Any] | Sequence[str]],
    effects: Sequence[str] = (),
    everyday: float = 0.01,
    timeout_s: float = 60.0,
    progress: Callable[[str], object] | None = None,
) -> Diagnosis:
    """Finds where a model disagrees with data, which laws are missing, and by how much they reduce the misfit.

    Args:
        model: the forward model; the same arguments have to give the same prediction.
        data: runs; those that judge confirm what is found in the others.
        parameters: by name the mean and standard deviation of the prior, or a mapping with ``mean``, ``sd``, ``unit`` and ``range``.
        sites: by name the regressors, or a mapping with ``regressors`` (names, or mappings with ``name``, ``unit``, ``range``,
            ``resolution`` and ``history``), ``unit``, ``adds_to`` and ``forms``.
        effects: laws that are tried, as ``site/regressor/form``, ``*`` for any; all where there are none.
        everyday: what a model that is right may leave of each regressor, as a fraction of the standard deviation of a channel.
        timeout_s: longest time of one call of the model. A call that takes longer is an error once it returns; Ctrl-C ends one that does not.
        progress: called with what is being done.

    Raises:
        UsageError: arguments that make no sense or do not belong together.
        AnalysisError: the model fails, returns something else than finite numbers, changes its size or is too slow; an exception of
            the model is its cause.
    """
    stated = {
        "parameters": [{"name": name, **_parameter(name, one)} for name, one in parameters.items()],
        "sites": [{"name": name, **_site(one)} for name, one in sites.items()],
        "effects": list(effects),
        "everyday": everyday,
        "timeout_s": timeout_s,
    }
    document, text = _core.discrepancy(model, [_run(run) for run in data], json.dumps(stated), progress)
    return Diagnosis(json.loads(document), text)


def _parameter(name: str, one: Mapping[str, Any] | tuple[float, float]) -> dict[str, Any]:
    if isinstance(one, Mapping):
        return dict(one)
    try:
        mean, sd = one
    except (TypeError, ValueError):
        raise UsageError(f"parameters: {name} is {one!r}, expected (mean, sd) or a mapping") from None
    return {"mean": float(mean), "sd": float(sd)}


def _site(one: Mapping[str, Any] | Sequence[str]) -> dict[str, Any]:
    site: dict[str, Any] = dict(one) if isinstance(one, Mapping) else {"regressors": list(one)}
    site["regressors"] = [{"name": each} if isinstance(each, str) else dict(each) for each in site.get("regressors", ())]
    return site


def _array(values: ArrayLike, what: str) -> FloatArray:
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{what}: holds something else than numbers") from None
    if array.ndim != 1:
        raise UsageError(f"{what}: has {array.ndim} dimensions, expected 1")
    return array


def _run(run: Run) -> dict[str, object]:
    time_s = _array(run.time_s, f"run {run.name}, time_s")
    columns = {name: _array(values, f"run {run.name}, {name}") for name, values in run.columns.items()}
    sds = {name: _array(values, f"run {run.name}, sds of {name}") for name, values in run.sds.items()}
    channels = {name: _array(values, f"run {run.name}, {name}") for name, values in run.channels.items()}
    return {
        "name": run.name,
        "time_s": time_s,
        "channels": [(name, run.units.get(name, ""), values, sds.get(name)) for name, values in channels.items()],
        "columns": list(columns.items()),
        "judges": run.judges,
        "run": {"time_s": time_s, **columns},
    }
