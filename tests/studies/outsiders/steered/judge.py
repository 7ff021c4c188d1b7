#!/usr/bin/env python3
"""Steers needles of this generator, or those of another program, and prints what came of it.

python judge.py GUIDE OUT --tissue plain --runs 200 --seed 1            # appends to OUT/results.jsonl, can be continued
python judge.py GUIDE OUT --runs 40 --seed 1 --halve strain --target other
python judge.py GUIDE OUT --runs 20 --seed 1 --hide cut_angle
python judge.py GUIDE OUT --table
"""
import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import example
from targets import DEPTH, target
from world import HIDDEN, LIMITS

HERE = Path(__file__).parent
RADII = (0.25, 0.5, 1.0)


def halved(which):
    """Limits of which one, or all, are half of what they usually are."""
    return {name: 0.5 * value for name, value in LIMITS.items() if which in (name, "all")}


def judged(options, case, seed):
    """One run, as a row of results."""
    tissue, halve, aim, hidden = case
    limits = halved(halve)
    if tissue == "example":
        of = (lambda number, own: example.target(number, own, DEPTH))
        plant = [sys.executable, str(HERE / "example.py"), str(seed), *[f"{name}={value}" for name, value in limits.items()]]
    else:
        of = (lambda number, own: target(tissue, number, hidden, own, 0))
        plant = [sys.executable, str(HERE / "plant.py"), tissue, str(seed), *(["--hide", hidden] if hidden else []),
                 *[f"--limit={name}={value}" for name, value in limits.items()]]
    # Another needle's target is within the usual limits of that needle: this one may not reach it.
    (to, still) = of(seed, limits)
    if aim == "other":
        to = of(seed + 500_000, {})[0]
    folder = Path(options.out) / "-".join([tissue, halve, aim, str(hidden), str(seed)])
    command = [options.guide, "steer", str(folder), "--json", "--plant", " ".join(plant), f"--target-mm={to[0]:.3f},{to[1]:.3f},{DEPTH}"]
    process = subprocess.run(command, capture_output=True, text=True)
    document = json.loads(process.stdout)
    run, fault = document["run"], document["fault"]
    record = folder / "steer.jsonl"
    replayed = None
    if options.replay and record.exists():
        again = subprocess.run([options.guide, "steer", "--replay", str(record), "--json"], capture_output=True, text=True)
        replayed = json.loads(again.stdout).get("run") == run
    record.unlink(missing_ok=True)
    folder.rmdir() if folder.exists() else None
    row = {"tissue": tissue, "halve": halve, "aim": aim, "hidden": hidden, "seed": seed, "replayed": replayed,
           "unsteered_mm": float(np.hypot(*(still - np.array(to)))), "fault": fault and fault["name"]}
    if run is None:
        return row
    end, decisions = run["end"] or {}, run["decisions"]
    truth = np.array([end["true_tip_x_mm"], end["true_tip_y_mm"]])
    return row | {
        "outcome": run["outcome"]["kind"], "name": run["outcome"].get("name"), "miss_mm": float(np.hypot(*(truth - np.array(to)))),
        "within": {str(one["radius_mm"]): one["probability"] for one in run["within_before"]},
        "limits_before": sum(one["probability"] for one in run["limits_before"]),
        "named": any(one["limits"] for one in decisions), "broken": end.get("limits_broken"), "strain": end.get("peak_strain"),
        "force": end.get("peak_force_n"), "last": decisions[-1]["within"] if decisions else [],
    }


def table(rows):
    """Rows of results by case, as Markdown."""
    print("| tissue | hidden | halved | target | runs | mean, mm | median | 95 % | largest | above 2 mm | unsteered mean | refused | stopped | fault | silent | "
          "limits broken | replays exact | stated / observed within 0.25, 0.5, 1 mm, % |")
    print("|" + "---|" * 18)
    cases = {}
    for row in rows:
        cases.setdefault((row["tissue"], row["hidden"], row["halve"], row["aim"]), []).append(row)
    for (tissue, hidden, halve, aim), of in cases.items():
        steered = [row for row in of if row.get("outcome") in ("arrived", "stopped")]
        arrived = [row for row in steered if row["outcome"] == "arrived"]
        misses = np.sort([row["miss_mm"] for row in steered]) if steered else np.array([np.nan])
        # A miss of more than half a millimetre that neither a word nor a probability below a half has announced.
        silent = sum(row["miss_mm"] > 0.5 and not row["named"] and row["within"].get("0.5", 1) > 0.5 for row in arrived)
        broken = sum(bool(row["broken"]) and sum(row["broken"].values()) > 0 for row in steered)
        replays = [row["replayed"] for row in of if row["replayed"] is not None]
        stated = [row for row in steered if row["within"]]
        calibration = ", ".join(
            f"{100 * np.mean([row['within'][str(radius)] for row in stated]):.0f} / {100 * np.mean([row['miss_mm'] <= float(radius) for row in stated]):.0f}"
            for radius in ("0.25", "0.5", "1.0")) if stated else ""
        print(f"| {tissue} | {hidden or ''} | {halve} | {aim} | {len(of)} | {misses.mean():.2f} | {np.median(misses):.2f} | {np.quantile(misses, 0.95):.2f} | "
              f"{misses.max():.2f} | {np.sum(misses > 2)} | {np.mean([row['unsteered_mm'] for row in of]):.2f} | "
              f"{sum(row.get('outcome') == 'refused' for row in of)} | {sum(row.get('outcome') == 'stopped' for row in of)} | "
              f"{sum(row['fault'] is not None for row in of)} | {silent} | {broken} | {sum(replays)} of {len(replays)} | {calibration} |")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("guide")
    parser.add_argument("out")
    parser.add_argument("--tissue", default="plain,standard", help="plain, standard, or example: the manual's plant in Python")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of the first needle")
    parser.add_argument("--halve", default="none", help=f"none, all, or of {', '.join(LIMITS)}; several with commas")
    parser.add_argument("--target", default="own", help="own, other, or both with a comma")
    parser.add_argument("--hide", default="", help=f"all, or of {', '.join(HIDDEN)}")
    parser.add_argument("--replay", action="store_true", help="carry every record out again")
    parser.add_argument("--table", action="store_true", help="the table only")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    Path(options.out).mkdir(parents=True, exist_ok=True)
    results = Path(options.out) / "results.jsonl"
    rows = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    if not options.table:
        known = {(row["tissue"], row["halve"], row["aim"], row["hidden"], row["seed"]) for row in rows}
        hidden = HIDDEN if options.hide == "all" else options.hide.split(",")
        cases = [(tissue, halve, aim, one or None) for one in hidden for tissue in options.tissue.split(",")
                 for halve in options.halve.split(",") for aim in options.target.split(",")]
        # Seed by seed, so that what is stopped early has all cases.
        for seed in range(options.seed, options.seed + options.runs):
            for case in cases:
                if (*case, seed) in known:
                    continue
                row = judged(options, case, seed)
                with results.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                rows.append(row)
    table(rows)


if __name__ == "__main__":
    main()
