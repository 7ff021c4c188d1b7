"""Draws of the commands as ArviZ reads them; needs ArviZ (`pip install 'needle-guide[frames]'`)."""

from __future__ import annotations

import json
import pathlib
import subprocess
from typing import Any

import numpy as np
import pytest

from needle_guide import Session

arviz = pytest.importorskip("arviz", reason="ArviZ is not installed: pip install 'needle-guide[frames]'")

GROUPS = {"posterior", "prior", "posterior_predictive", "log_likelihood", "observed_data"}


def drawn(guide: str, command: str, session: Session, folder: pathlib.Path) -> tuple[Any, dict[str, Any]]:
    """Draws of a command, and the document that it prints."""
    path = folder / f"{command}.json"
    arguments = [guide, command, str(session.path), "--draws", str(path), "--seed", "5", "--json"]
    run = subprocess.run(arguments, capture_output=True, text=True, check=True)
    return arviz.from_json(path), json.loads(run.stdout)


def share(values: Any, interval: list[float]) -> float:
    """Share of draws within an interval."""
    low, high = interval
    return float(np.mean((np.asarray(values) >= low) & (np.asarray(values) <= high)))


@pytest.mark.parametrize("command", ["identify", "predict", "diagnose"])
def test_arviz_opens_the_draws_of_a_command(
    command: str, guide: str, example: Session, tmp_path: pathlib.Path
) -> None:
    data, found = drawn(guide, command, example, tmp_path)
    assert set(data.groups()) >= GROUPS
    assert dict(data.posterior.sizes)["chain"] == 4
    assert dict(data.posterior.sizes)["draw"] == 250
    assert data.attrs["seed"] == "5"
    # Observed readings, predicted ones and their densities have the same names and places.
    for name, observed in data.observed_data.items():
        assert data.posterior_predictive[name].dims == ("chain", "draw", *observed.dims)
        assert data.log_likelihood[name].shape[2:] == observed.shape
        assert np.isfinite(data.log_likelihood[name]).all()
        if command != "predict":
            # Before the data less is known of every reading than with them.
            before, after = data.prior_predictive[name], data.posterior_predictive[name]
            assert before.dims == after.dims
            assert float(before.std(("chain", "draw")).mean()) > float(after.std(("chain", "draw")).mean())
    # A thousand draws: four standard deviations of a share of 95 % are 2.8 %.
    if command == "predict":
        for one in found["insertions"]:
            inside = share(data.posterior[f"{one['id']}.tip_force_y_n"], one["tip_force_ci95_n"])
            assert abs(inside - 0.95) < 0.03
    else:
        interval = found["pooled"]["ci95_kpa"] if command == "identify" else found["k_ci95_kpa"]
        assert abs(share(data.posterior["k_kpa"], interval) - 0.95) < 0.03
    # ArviZ computes with them.
    summary = arviz.summary(data, group="posterior")
    assert summary["r_hat"].dropna().max() < 1.05
    name = next(iter(data.observed_data))
    assert np.isfinite(arviz.loo(data, var_name=name).elpd_loo)
