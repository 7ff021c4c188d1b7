"""A prior from other insertions into the same tissue, leave one out: what it changes in the prediction of the tip.

    python host/python/studies/leave_one_out.py SESSION...

Every insertion of these sessions becomes a session of its own. `summarize` makes their records, `population` over the others the prior, and the
insertion is predicted by itself from 30 and 50 mm with and without it. The last column is the prediction with the readings of the other
insertions of its session themselves. Errors are root mean squares of the tip's place beyond the depth, over both axes; covered is the share of readings in
the 95 % band.
"""

from __future__ import annotations

import argparse
import pathlib
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass

import numpy as np

from needle_guide import AnalysisError, Population, Prediction, Session, Summary, UsageError, population, summarize

DEPTHS_MM = (30.0, 50.0)


@dataclass
class Misses:
    """Distances of predicted from measured readings, and which are in their bands."""

    error_mm: float
    inside: int
    readings: int

    def __str__(self) -> str:
        return f"{self.error_mm:.2f} mm, {100 * self.inside / self.readings:.0f} %"


def single(session: pathlib.Path, folder: pathlib.Path) -> list[pathlib.Path]:
    """A session for every insertion, with the files that it names."""
    head, *blocks = re.split(r"(?m)^(?=\[\[insertion\]\])", (session / "session.toml").read_text(encoding="utf-8"))
    made: list[pathlib.Path] = []
    for number, block in enumerate(blocks, 1):
        path = folder / f"{session.name}-{number}"
        path.mkdir()
        (path / "session.toml").write_text(head + block, encoding="utf-8")
        for name in re.findall(r'"([^"]+\.csv)"', block):
            shutil.copy(session / name, path / name)
        made.append(path)
    return made


def misses(predicted: Prediction, until_mm: float, number: int = 0) -> Misses | None:
    """Of an insertion beyond a depth; nothing where it could not be predicted."""
    one = predicted.insertions[number]
    if one.error is not None:
        return None
    beyond = one.depth_mm > until_mm
    squares, inside, readings = 0.0, 0, 0
    axes = [(one.tip_y_mm, one.tip_y_ci95_mm, one.measured_y_mm), (one.tip_x_mm, one.tip_x_ci95_mm, one.measured_x_mm)]
    for tip, band, measured in axes:
        if not len(tip):
            continue
        there = beyond & np.isfinite(measured)
        off, low, high = (values[there] for values in (tip - measured, band[:, 0], band[:, 1]))
        squares += float((off**2).sum())
        inside += int(((low <= measured[there]) & (measured[there] <= high)).sum())
        readings = readings + len(off)
    count = max(1, readings // max(1, sum(bool(len(axis[0])) for axis in axes)))
    return Misses(float(np.sqrt(squares / count)), inside, readings) if readings else None


def reason(record: Summary) -> str:
    """What a record states of K."""
    return record.error or f"{record.k_kpa}, {record.to_dict()['result']['verdict']}"


def describe(found: Population) -> str:
    """Mean of K and what a new insertion is expected to have."""
    if not found.groups:
        return "none"
    group = found.groups[0]
    low, high = group.new_subject95_kpa or (0.0, float("inf"))
    return f"{group.k_kpa}; of a new one {low:.3g} to {high:.3g} kPa; {group.sessions} insertions"


def sum_up(what: str, cells: list[tuple[Misses, Misses]]) -> str:
    """How much smaller the errors of all cells are with something than by itself."""
    if not cells:
        return f"\n{what}: no cell"
    smaller = sum(other.error_mm < alone.error_mm for alone, other in cells)
    before_mm, after_mm = (float(np.mean([cell[part].error_mm for cell in cells])) for part in (0, 1))
    covered = sum(other.inside for _, other in cells) / sum(other.readings for _, other in cells)
    means = f"mean {after_mm:.2f} mm, by itself {before_mm:.2f} mm"
    return f"\n{what}: smaller in {smaller} of {len(cells)} cells; {means}; {100 * covered:.0f} % of the readings in the band"


def main() -> None:
    """Prints a row for every insertion and depth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", nargs="+", type=pathlib.Path)
    sessions: list[pathlib.Path] = parser.parse_args().sessions
    rows: list[str] = []
    cells: list[tuple[Misses, Misses, Misses | None]] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch)
        print("| insertion | K by itself | prior from the others |\n|---|---|---|", flush=True)
        paths = [(session, number, path) for session in sessions for number, path in enumerate(single(session, folder))]
        records = [summarize(path) for _, _, path in paths]
        for (session, number, path), record in zip(paths, records, strict=True):
            prior, text = folder / f"{path.name}.toml", "none"
            try:
                found = population([other for other in records if other is not record])
                prior.write_text(found.prior_toml, encoding="utf-8")
                text = describe(found)
            except (AnalysisError, UsageError) as error:
                text = f"none: {error.message}"
            print(f"| {path.name} | {reason(record)} | {text} |", flush=True)
            if "[[modulus]]" not in (prior.read_text(encoding="utf-8") if prior.exists() else ""):
                continue
            for until_mm in DEPTHS_MM:
                alone = misses(Session(path).predict(until_mm=until_mm, alone=True), until_mm)
                predicted = Session(path).predict(until_mm=until_mm, prior=prior, alone=True)
                used = (predicted.to_dict().get("prior") or {}).get("used")
                given = misses(predicted, until_mm)
                together = misses(Session(session).predict(until_mm=until_mm), until_mm, number)
                rows.append(f"| {path.name} | {until_mm:.0f} mm | {alone} | {given}{'' if used else ' (prior not used)'} | {together} |")
                print(rows[-1], file=sys.stderr, flush=True)
                if alone and given:
                    cells.append((alone, given, together))
    print("\n| insertion | from | by itself | with the prior | with the readings of the others |\n|---|---|---|---|---|")
    print("\n".join(rows))
    print(sum_up("with the prior", [(alone, given) for alone, given, _ in cells]))
    print(sum_up("with the readings of the others", [(alone, together) for alone, _, together in cells if together]))


if __name__ == "__main__":
    main()
