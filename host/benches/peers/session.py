"""A session's folder into arrays in SI: `session.toml` and the CSV files that it names. The result: the sum of every column over all
runs."""

import csv
import tomllib
from pathlib import Path

import numpy as np

from timing import given, report

FOLDER = Path(given()["folder"])
COLUMNS = {
    "force": [("time_s", 1.0), ("displacement_y_mm", 1e-3), ("force_y_n", 1.0), ("displacement_x_mm", 1e-3), ("force_x_n", 1.0)],
    "shape": [("z_mm", 1e-3), ("deflection_y_mm", 1e-3), ("deflection_x_mm", 1e-3)],
}


def sums(load):
    with open(FOLDER / "session.toml", "rb") as file:
        session = tomllib.load(file)
    total = []
    for kind, columns in COLUMNS.items():
        loaded = [load(FOLDER / run[kind], columns) for run in session["lateral"]]
        total += [sum(float(np.sum(columns[i])) for columns in loaded) for i in range(len(columns))]
    return total


def by_pandas(path, columns):
    import pandas

    table = pandas.read_csv(path, comment="#")
    return [factor * table[name].to_numpy() for name, factor in columns]


def by_csv(path, columns):
    with open(path, newline="") as file:
        rows = csv.DictReader(file)
        values = [[float(row[name]) for name, _ in columns] for row in rows]
    return list(np.array(values).T * np.array([[factor] for _, factor in columns]))


if __name__ == "__main__":
    report([
        ("pandas, `read_csv`, and tomllib", lambda: sums(by_pandas)),
        ("Python's own csv and tomllib", lambda: sums(by_csv)),
    ])
