"""Statistics over sessions beside statsmodels and SciPy, and beside R's metafor where Rscript and metafor are installed.

    pip install statsmodels
    python host/python/studies/meta_analysis.py
    python host/python/studies/meta_analysis.py --coverage 200

Every value is printed twice or three times, and the program fails where two differ by more than 1e-6 of the value. With `--coverage`, nested
populations are drawn instead, so many of each design, and how often the intervals of both hold the truth is printed.
"""

# The packages beside which values are put are no dependency of the wheel or of its tests.
# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import json
import math
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray
from scipy import optimize, stats
from statsmodels.stats.meta_analysis import combine_effects

from needle_guide import Quantity, Summary, population

Array = NDArray[np.float64]
AGREE = 1e-6
SEED = 311

# 13 trials of BCG (Colditz and others 1994), the documented example of metafor: vaccinated with and without tuberculosis, the same of the
# others, latitude.
BCG = [
    (4, 119, 11, 128, 44),
    (6, 300, 29, 274, 55),
    (3, 228, 11, 209, 42),
    (62, 13536, 248, 12619, 52),
    (33, 5036, 47, 5761, 13),
    (180, 1361, 372, 1079, 44),
    (8, 2537, 10, 619, 19),
    (505, 87886, 499, 87892, 13),
    (29, 7470, 45, 7232, 27),
    (17, 1699, 65, 1600, 42),
    (186, 50448, 141, 27197, 18),
    (5, 2493, 3, 2338, 33),
    (27, 16886, 29, 17825, 33),
]


@dataclass
class Data:
    """Values with known variances; a covariate or groups."""

    name: str
    y: Array
    v: Array
    x: Array | None = None
    groups: list[int] = field(default_factory=list)

    def design(self) -> Array:
        """Constant and covariate."""
        one = np.ones_like(self.y)
        return np.stack([one] if self.x is None else [one, self.x], axis=1)


def bcg(latitude: bool) -> Data:
    """Half the logarithm of the relative risk: a session whose ln K has a standard deviation above 0.7 counts as no measurement."""
    table = np.array(BCG, dtype=np.float64)
    tp, tn, cp, cn, at = table.T
    y = 0.5 * (np.log(tp / (tp + tn)) - np.log(cp / (cp + cn)))
    v = 0.25 * (1 / tp - 1 / (tp + tn) + 1 / cp - 1 / (cp + cn))
    return Data(f"BCG, 13 trials{', latitude' if latitude else ''}", y, v, at if latitude else None)


def drawn(count: int, covariate: bool) -> Data:
    """Sessions of unequal precision around a mean, or around a line."""
    random = np.random.default_rng(SEED + count)
    v = random.uniform(0.02, 0.3, count) ** 2
    x = random.uniform(20.0, 80.0, count)
    mean = 2.5 + (0.01 * x if covariate else 0.0)
    y = mean + random.normal(0.0, 0.15, count) + random.normal(0.0, np.sqrt(v))
    return Data(f"{count} drawn{', covariate' if covariate else ''}", y, v, x if covariate else None)


def nested(subjects: int) -> Data:
    """One to four sessions of each subject, equal precision: the residual variance of a mixed model is then v and that of sessions."""
    random = np.random.default_rng(SEED + 1000 + subjects)
    groups = [subject for subject in range(subjects) for _ in range(1 + subject % 4)]
    shared = random.normal(2.5, 0.25, subjects)
    y = shared[groups] + random.normal(0.0, 0.1, len(groups)) + random.normal(0.0, 0.05, len(groups))
    return Data(f"{len(groups)} of {subjects} subjects", y, np.full(len(groups), 0.05**2), groups=groups)


def records(data: Data) -> list[Summary]:
    """Records of sessions with these values."""
    lines: list[str] = []
    for number, (y, v) in enumerate(zip(data.y, data.v, strict=True)):
        sd = math.sqrt(v)
        result: dict[str, Any] = {
            "verdict": "adequate",
            "foundation": "springs",
            "k_kpa": math.exp(y),
            "k_ci95_kpa": [math.exp(y - 1.96 * sd), math.exp(y + 1.96 * sd)],
            "ln_k_kpa": y,
            "ln_k_sd": sd,
            "ln_modulus_without_effects": [y, sd],
            "amplitudes": [],
            "named": [],
            "correlation_per_mille": [],
            **{name: {} for name in ("discrepancy", "noise", "log_evidence")},
        }
        record: dict[str, Any] = {"schema": "needle.summary/1", "session": f"s{number:04}", "program": "study", "result": result}
        if data.x is not None:
            record["covariates"] = {"x": data.x[number]}
        if data.groups:
            record["subject"] = f"p{data.groups[number]:03}"
        lines.append(json.dumps(record))
    return [Summary(line) for line in lines]


def ours(data: Data) -> dict[str, float]:
    """By `guide population`, through records of sessions."""
    found = population(records(data), covariate=[] if data.x is None else ["x"]).to_dict()
    if found["sessions"]["used"] != len(data.y):
        raise SystemExit(f"{data.name}: {found['sessions']['used']} of {len(data.y)} values are used, {found['listed']}")
    group = found["groups"][0]
    values: dict[str, float] = {"tau, REML": group["tau"], "mean": group["ln_k"][0]}
    if data.groups:
        subject, session = group["levels"]
        values = {"tau of subjects, REML": subject["tau"], "tau of sessions, REML": session["tau"], "mean": group["ln_k"][0]}
        return {**values, "ICC": subject["icc"]}
    values |= {"Q": group["q"], "I^2, percent": group["i_squared_percent"]}
    values |= {"tau, Paule and Mandel": group["tau_paule_mandel"]}
    values |= {"tau, 2.5 %": group["tau_ci95"][0], "tau, 97.5 %": group["tau_ci95"][1]}
    if data.x is not None:
        values |= {"slope": group["slopes"]["x"]["value"]}
    return values


def q_at(data: Data, tau2: float) -> float:
    """Weighted squares around the weighted fit, by statsmodels."""
    fit = sm.WLS(data.y, data.design(), weights=1 / (data.v + tau2)).fit()
    return float(fit.ssr)


def root(function: Callable[[float], float]) -> float:
    """The variance at which a falling function is zero; zero where there is none."""
    if function(0.0) <= 0:
        return 0.0
    return optimize.root_scalar(function, bracket=(0.0, 100.0), method="brentq", xtol=1e-16, rtol=1e-14).root


def reml_slope(data: Data, tau2: float) -> float:
    """Derivative of the restricted log likelihood by the variance, from dense matrices: y' P P y - tr P."""
    inverse, x = np.diag(1 / (data.v + tau2)), data.design()
    projection = inverse - inverse @ x @ np.linalg.solve(x.T @ inverse @ x, x.T @ inverse)
    weighted = projection @ data.y
    return float(weighted @ weighted - np.trace(projection))


def theirs(data: Data) -> dict[str, float]:
    """By statsmodels and SciPy."""
    if data.groups:
        fit = sm.MixedLM(data.y, data.design(), groups=data.groups).fit(reml=True, method="bfgs", gtol=1e-11, maxiter=2000)
        between, within = float(np.asarray(fit.cov_re)[0, 0]), float(fit.scale)
        values = {"tau of subjects, REML": math.sqrt(between), "tau of sessions, REML": math.sqrt(within - data.v[0])}
        return {**values, "mean": float(fit.fe_params[0]), "ICC": between / (between + within)}
    n, p = data.design().shape
    tau2 = root(lambda tau2: reml_slope(data, tau2))
    fit = sm.WLS(data.y, data.design(), weights=1 / (data.v + tau2)).fit()
    # statsmodels scales by Hartung and Knapp's factor, which here is not below 1.
    covariance = np.asarray(fit.cov_params()) / min(1.0, float(fit.scale))
    at = np.array([1.0] if data.x is None else [1.0, float(data.x.mean())])
    mean, se = float(at @ fit.params), math.sqrt(at @ covariance @ at)
    t, t_new = (float(stats.t.ppf(0.975, freedom)) for freedom in (n - p, n - p - 1))
    new = math.sqrt(tau2 + se**2)
    weights, x = np.diag(1 / data.v), data.design()
    trace = float(np.trace(weights - weights @ x @ np.linalg.solve(x.T @ weights @ x, x.T @ weights)))
    low, high = (root(lambda tau2, share=share: q_at(data, tau2) - float(stats.chi2.ppf(share, n - p))) for share in (0.975, 0.025))
    paule_mandel = root(lambda tau2: q_at(data, tau2) - (n - p))
    values = {
        "tau, REML": math.sqrt(tau2),
        "mean": mean,
        "its standard error": se,
        "mean, 2.5 %": mean - t * se,
        "mean, 97.5 %": mean + t * se,
        "Q": q_at(data, 0.0),
        "I^2, percent": 100 * tau2 / (tau2 + (n - p) / trace),
        "tau, Paule and Mandel": math.sqrt(paule_mandel),
        "tau, 2.5 %": math.sqrt(low),
        "tau, 97.5 %": math.sqrt(high),
        "new, 2.5 %": mean - t_new * new,
        "new, 97.5 %": mean + t_new * new,
    }
    if data.x is None:
        # That of the meta-analysis of statsmodels. Its own iteration of Paule and Mandel ends at zero where rounding passes the root.
        return {**values, "Q": float(combine_effects(data.y, data.v).q)}
    slope, error = float(fit.params[1]), math.sqrt(covariance[1, 1])
    return {**values, "slope": slope, "slope, 2.5 %": slope - t * error, "slope, 97.5 %": slope + t * error}


METAFOR = """
library(metafor, warn.conflicts = FALSE, quietly = TRUE)
d <- read.csv(file("stdin")); tight <- list(threshold = 1e-14, maxiter = 10000)
mods <- if ("x" %in% names(d)) ~ x else ~ 1
fit <- rma(y, v, mods = mods, data = d, method = "REML", test = "adhoc", control = tight)
pm <- rma(y, v, mods = mods, data = d, method = "PM", control = list(tol = 1e-14, maxiter = 10000))
free <- confint(fit, control = list(tol = 1e-14))$random["tau", c("ci.lb", "ci.ub")]
at <- if ("x" %in% names(d)) predict(fit, newmods = mean(d$x)) else predict(fit)
out <- c(sqrt(fit$tau2), at$pred, at$se, at$ci.lb, at$ci.ub, fit$QE, fit$I2, sqrt(pm$tau2), free)
if ("x" %in% names(d)) out <- c(out, fit$beta[2], fit$ci.lb[2], fit$ci.ub[2])
cat(sprintf("%.15g", out))
"""


def metafor(data: Data) -> dict[str, float]:
    """By R's metafor, where it is installed. Its prediction interval has other degrees of freedom."""
    if data.groups or shutil.which("Rscript") is None:
        return {}
    names = ["y", "v"] if data.x is None else ["y", "v", "x"]
    columns = [data.y, data.v] if data.x is None else [data.y, data.v, data.x]
    rows = [",".join(f"{value:.17g}" for value in row) for row in zip(*columns, strict=True)]
    table = "\n".join([",".join(names), *rows]) + "\n"
    run = subprocess.run(["Rscript", "-e", METAFOR], input=table, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        print(f"metafor: {run.stderr.strip().splitlines()[-1]}", file=sys.stderr)
        return {}
    keys = ["tau, REML", "mean", "its standard error", "mean, 2.5 %", "mean, 97.5 %", "Q", "I^2, percent"]
    keys += ["tau, Paule and Mandel", "tau, 2.5 %", "tau, 97.5 %", "slope", "slope, 2.5 %", "slope, 97.5 %"]
    return dict(zip(keys, map(float, run.stdout.split()), strict=False))


def holds(value: Quantity | None, truth: float) -> bool:
    """Whether an interval holds the truth."""
    return value is not None and value.ci95 is not None and value.ci95[0] <= truth <= value.ci95[1]


# Subjects, sessions of each or on average, whether all have as many, share of sessions that are far off.
DESIGNS = (
    (3, 20, True, 0.0),
    (6, 10, True, 0.0),
    (6, 10, False, 0.0),
    (20, 3, True, 0.0),
    (6, 10, True, 1 / 30),
    (30, 4, False, 1 / 30),
)


def coverage(count: int) -> None:
    """Prints how often intervals hold the truth: of the mean by both, of the spreads by `guide population` alone (statsmodels has none)."""
    print("| subjects x sessions | far off | mean, statsmodels | mean | sd of subjects | sd of sessions |\n|---|---|---|---|---|---|")
    mean, between, within, error = 2.5, 0.15, 0.05, 0.04
    for subjects, sessions, is_balanced, far in DESIGNS:
        held = np.zeros(4)
        sizes = [sessions if is_balanced else 1 + (7 * subject + 3) % (2 * sessions) for subject in range(subjects)]
        groups = np.repeat(np.arange(subjects), sizes)
        for number in range(count):
            random = np.random.default_rng([SEED, subjects, is_balanced, far > 0.0, number])
            y = mean + random.normal(0.0, between, subjects)[groups]
            y += random.normal(0.0, math.hypot(within, error), len(groups))
            y += (random.random(len(y)) < far) * 12.0 * math.hypot(within, error) * random.choice([-1.0, 1.0], len(y))
            data = Data("drawn", y, np.full(len(groups), error**2), groups=groups.tolist())
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                fit = sm.MixedLM(y, data.design(), groups=groups).fit(reml=True)
            low, high = np.asarray(fit.conf_int())[0]
            group = population(records(data)).groups[0]
            subject, session = group.levels
            ends = group.k_kpa.ci95 or (math.nan, math.nan)
            of_mean = ends[0] <= math.exp(mean) <= ends[1]
            held += [low <= mean <= high, of_mean, holds(subject.tau, between), holds(session.tau, within)]
        shares = " | ".join(f"{100 * one / count:.1f} %" for one in held)
        about, share = "" if is_balanced else "about ", "1 of 30" if far > 0.0 else "none"
        print(f"| {subjects} x {about}{sessions} | {share} | {shares} |", flush=True)


def main() -> None:
    """Prints the values beside each other."""
    parser = argparse.ArgumentParser(description="statistics over sessions beside statsmodels, SciPy and metafor")
    parser.add_argument("--coverage", type=int, default=0, help="populations of every design to draw")
    if wanted := parser.parse_args().coverage:
        coverage(wanted)
        return
    print("| data | value | `guide population` | statsmodels, SciPy | metafor |\n|---|---|---|---|---|")
    apart: list[str] = []
    for data in (bcg(False), bcg(True), drawn(8, False), drawn(40, False), drawn(60, True), nested(30)):
        found, other, third = ours(data), theirs(data), metafor(data)
        for name, value in found.items():
            values = [value, other[name], *([third[name]] if name in third else [])]
            texts = [f"{one:.8g}" for one in values]
            print(f"| {data.name} | {name} | {' | '.join(texts + ['-'] * (3 - len(texts)))} |")
            if any(not math.isclose(value, one, rel_tol=AGREE, abs_tol=1e-9) for one in values[1:]):
                apart.append(f"{data.name}: {name}")
    if apart:
        raise SystemExit(f"differ by more than {AGREE}: {'; '.join(apart)}")


if __name__ == "__main__":
    main()
