"""The workflow for models that are Python functions."""

from __future__ import annotations

import json
import pathlib
import time
from typing import Any

import numpy as np
import pytest

from needle_guide import AnalysisError, Quantity, UsageError, discrepancy

NOTEBOOK = pathlib.Path(__file__).parents[2] / "manual" / "src" / "notebooks" / "pendulum.ipynb"


def test_the_notebook_names_the_hidden_friction_of_a_pendulum() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert sum(1 for line in code.splitlines() if line.strip()) < 40
    steps: dict[str, Any] = {}
    exec(compile(code, str(NOTEBOOK), "exec"), steps)
    found = steps["found"]
    assert found.missing == ["pivot/speed/sign"], str(found)
    low, high = found.terms["pivot/speed/sign"]["a"].ci95
    assert low < steps["HIDDEN"] < high, str(found)
    assert found.schema == "discrepancy.diagnosis/1"


def interval(quantity: Quantity) -> tuple[float, float]:
    assert quantity.ci95 is not None
    return quantity.ci95


def line(parameters, terms, run):  # type: ignore[no-untyped-def]
    return parameters["slope"] * run["x"]


def runs() -> list[discrepancy.Run]:
    t = np.arange(100.0)
    x = np.sin(t / 7.0)
    noise = 0.1 * np.random.default_rng(1).standard_normal(t.size)
    return [discrepancy.Run("one", t, {"y": 2.0 * x + noise}, {"x": x})]


def diagnose(model, **changed):  # type: ignore[no-untyped-def]
    stated: dict[str, Any] = {
        "parameters": {"slope": (1.0, 1.0)},
        "sites": {"y": {"adds_to": "y", "regressors": ["x"]}},
        **changed,
    }
    return discrepancy.diagnose(model, runs(), **stated)


def test_an_asymmetric_friction_states_its_dry_friction_and_its_offset() -> None:
    def measured(name: str, hz: float, judges: bool) -> discrepancy.Run:
        # From the first motion on: at rest dry friction has any value.
        t = np.arange(0.1, 8.0, 0.02)
        v = np.sin(hz * t) + 0.3 * np.sin(2.3 * hz * t)
        noise = 0.03 * np.random.default_rng(int(10 * hz)).standard_normal(t.size)
        force = 0.8 * v + np.where(v > 0.0, 0.7, -0.3) + noise
        return discrepancy.Run(name, t, {"force": force}, {"speed": v}, judges=judges)

    found = discrepancy.diagnose(
        lambda parameters, terms, run: parameters["viscous"] * run["speed"],
        [measured("slow", 3.0, False), measured("fast", 4.1, True)],
        parameters={"viscous": (1.0, 1.0)},
        sites={"friction": {"adds_to": "force", "regressors": ["speed"], "unit": "N"}},
    )
    assert set(found.parts) == {"friction/offset", "friction/reversal"}, str(found)
    for name, true in {"friction/offset": 0.2, "friction/reversal": 0.5}.items():
        low, high = interval(found.parts[name])
        assert low < true < high and found.parts[name].unit == "N", str(found)


def test_steps_are_reported() -> None:
    steps: list[str] = []
    found = diagnose(line, progress=steps.append)
    assert found.verdict == "adequate" and "fitting the plain model" in steps
    low, high = interval(found.parameters["slope"])
    assert low < 2.0 < high


def test_faults_of_a_model_have_their_messages() -> None:
    def fails(parameters, terms, run):  # type: ignore[no-untyped-def]
        raise ZeroDivisionError("no mass")

    with pytest.raises(AnalysisError, match="the model failed in run one.*no mass") as raised:
        diagnose(fails)
    assert isinstance(raised.value.__cause__, ZeroDivisionError)

    with pytest.raises(AnalysisError, match="predicts NaN in run one, channel y, reading 1"):
        diagnose(lambda parameters, terms, run: np.full(100, np.nan))
    with pytest.raises(AnalysisError, match="99 values of y in run one; expected 100"):
        diagnose(lambda parameters, terms, run: run["x"][:-1])

    def slow(parameters, terms, run):  # type: ignore[no-untyped-def]
        time.sleep(0.2)
        return run["x"]

    with pytest.raises(AnalysisError, match="no answer within 0.01 s"):
        diagnose(slow, timeout_s=0.01)


def test_arguments_that_make_no_sense_are_usage_errors() -> None:
    with pytest.raises(UsageError, match="is none of the forms"):
        diagnose(line, effects=["y/x/wobble"])
    with pytest.raises(UsageError, match="no column"):
        diagnose(line, sites={"y": {"adds_to": "y", "regressors": ["z"]}})
    with pytest.raises(AnalysisError, match="changes no prediction"):
        diagnose(line, sites={"y": {"regressors": [{"name": "x", "range": [-1, 1]}]}})
    with pytest.raises(UsageError, match="all of them are held out"):
        discrepancy.diagnose(line, [discrepancy.Run("one", [0.0], {"y": [1.0]}, judges=True)], parameters={}, sites={})
