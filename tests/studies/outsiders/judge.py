"""Run a diagnosis over the sessions of `worlds.py` and tabulate what it says against what is true.

    python judge.py OUT_DIR GUIDE_BINARY [--jobs N] [--kind KIND,...] [--limit N] [--timeout S] [--table]

calls `GUIDE_BINARY diagnose FOLDER --json` for every line of OUT_DIR/truth.jsonl (a folder that already has a result is
skipped), appends one line per session to OUT_DIR/results.jsonl, and prints a table per kind:

* n, and how many sessions had each verdict,
* what was named, with how often; a class of more than one is written with its size,
* K: in how many of n the interval of K held the mean modulus over the touched depth, and (any) at least one modulus
  that a lab may mean: mean, surface, first or last run, relaxed, or the equivalent of plain springs,
* the median of the interval's width over its middle, and of the time.

For an elastic body, which has no K of its own, both count the equivalent modulus of plain springs.
`--table` prints the table of the results so far without running anything.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import time
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

Record = dict[str, Any]
MODULI = ("k_mean_kpa", "k_surface_kpa", "k_first_run_kpa", "k_last_run_kpa", "k_relaxed_kpa", "k_equivalent_kpa")


def lines(path: Path) -> list[Record]:
    """Documents of a file of one JSON document per line; of those with one folder the last counts."""
    if not path.exists():
        return []
    last = {r["folder"]: r for r in map(json.loads, filter(None, path.read_text().splitlines()))}
    return list(last.values())


def diagnose(out: Path, binary: str, truth: Record, timeout: float) -> Record:
    """Run the diagnosis on one session."""
    begin = time.monotonic()
    result: Record = {"folder": truth["folder"], "kind": truth["kind"], "set": truth["set"], "error": None}
    environment = {**os.environ, "RAYON_NUM_THREADS": os.environ.get("RAYON_NUM_THREADS", "1")}
    try:
        done = subprocess.run(
            [binary, "diagnose", str(out / truth["folder"]), "--json"],
            capture_output=True,
            text=True,
            timeout=timeout,
            env=environment,
            check=False,
        )
        result["exit_code"] = done.returncode
        document = json.loads(done.stdout)
        if "verdict" not in document:
            raise ValueError(done.stdout[:300])
    except subprocess.TimeoutExpired:
        result["error"] = f"no answer within {timeout:.0f} s"
    except (ValueError, OSError) as error:
        result["error"] = f"{error}"[:300]
    else:
        result["verdict"] = document["verdict"]
        result["named"] = document.get("effects", [])
        for key in (
            "k_kpa",
            "k_ci95_kpa",
            "k_status",
            "mean_modulus",
            "foundation",
            "gap",
            "adequacy",
            "remaining",
            "near_margin",
            "partial",
            "limits",
            "warnings",
        ):
            result[key] = document.get(key)
        result["where"] = (document.get("where") or [])[:5]
    result["seconds"] = time.monotonic() - begin
    return result


def held(interval: list[float] | None, values: list[float | None]) -> bool:
    """Whether an interval holds one of the values."""
    return interval is not None and any(v is not None and interval[0] <= v <= interval[1] for v in values)


def intervals(result: Record) -> list[list[float] | None]:
    """Interval of K as printed, and that of the mean modulus where there is one."""
    mean = (result.get("mean_modulus") or {}).get("modulus_kpa") or {}
    # Where the tissue is taken for an elastic body the mean is that of Young's modulus, which is no K.
    is_body = (result.get("foundation") or {}).get("used") == "body"
    return [result.get("k_ci95_kpa"), None if is_body else mean.get("ci95")]


def label(effect: Record) -> str:
    """Name of a named effect, with the size of its class and its formula where it has one."""
    others = len(set(effect.get("class") or []) - {effect.get("id")})
    formula = next((effect[k] for k in ("formula", "form", "law") if isinstance(effect.get(k), str)), "")
    return f"{effect.get('id')}" + (f" (of {others + 1})" if others else "") + (f" [{formula}]" if formula else "")


def table(truths: list[Record], results: list[Record]) -> str:
    """The table per kind."""
    truth_of = {t["folder"]: t for t in truths}
    by_kind: dict[tuple[str, str], list[Record]] = defaultdict(list)
    for result in results:
        if result["folder"] in truth_of:
            by_kind[result["set"], result["kind"]].append(result)
    out = [f"{'set kind':34s} {'n':>3s}  {'verdicts':38s} {'K':>5s} {'any':>5s} {'width':>7s} {'time':>7s}  named"]
    totals: Counter[str] = Counter()
    for (group, kind), rows in sorted(by_kind.items()):
        verdicts = Counter("error" if r["error"] else r["verdict"] for r in rows)
        totals.update(verdicts)
        named: Counter[str] = Counter()
        widths, hits, any_hits = [], 0, 0
        for r in rows:
            named.update(label(e) for e in r.get("named") or [])
            truth = truth_of[r["folder"]]
            first = truth["k_equivalent_kpa"] if truth.get("k_mean_kpa") is None else truth["k_mean_kpa"]
            printed = intervals(r)
            hits += any(held(i, [first]) for i in (printed[1:] if printed[1] else printed[:1]))
            any_hits += any(held(i, [truth.get(m) for m in MODULI]) for i in printed)
            if printed[0]:
                widths.append(2 * (printed[0][1] - printed[0][0]) / (printed[0][1] + printed[0][0]))
        out.append(
            f"{group}   {kind:30s} {len(rows):3d}  "
            f"{', '.join(f'{v} {n}' for v, n in verdicts.most_common()):38s} "
            f"{hits:2d}/{len(rows):<2d} {any_hits:2d}/{len(rows):<2d} "
            f"{100 * statistics.median(widths) if widths else float('nan'):6.2f}% "
            f"{statistics.median(r['seconds'] for r in rows):6.1f}s  "
            f"{'; '.join(f'{k} {n}' for k, n in named.most_common(6))}"
        )
    out.append("all: " + ", ".join(f"{v} {n}" for v, n in totals.most_common()))
    return "\n".join(out)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Judge a diagnosis by sessions whose truth is known")
    parser.add_argument("out", type=Path, help="folder of worlds.py, with truth.jsonl")
    parser.add_argument("binary", nargs="?", help="the program")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--kind", help="only these kinds, with commas")
    parser.add_argument("--limit", type=int, help="at most so many sessions")
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds per session")
    parser.add_argument("--table", action="store_true", help="print the table of the results so far, run nothing")
    options = parser.parse_args()
    truths = lines(options.out / "truth.jsonl")
    if not options.table:
        if not options.binary:
            parser.error("GUIDE_BINARY is missing")
        done = {r["folder"] for r in lines(options.out / "results.jsonl") if not r["error"]}
        wanted = [
            t
            for t in truths
            if t["folder"] not in done
            and (out_folder := options.out / t["folder"]).is_dir()
            and (out_folder / "session.toml").exists()
        ]
        if options.kind:
            wanted = [t for t in wanted if t["kind"] in options.kind.split(",")]
        wanted = wanted[: options.limit]
        with ThreadPoolExecutor(options.jobs) as pool, (options.out / "results.jsonl").open("a") as file:
            for result in pool.map(lambda t: diagnose(options.out, options.binary, t, options.timeout), wanted):
                file.write(json.dumps(result) + "\n")
                file.flush()
                print(
                    f"{result['folder']:36s} {result.get('verdict') or result['error']}  {result['seconds']:.0f} s  "
                    f"{', '.join(label(e) for e in result.get('named') or [])}",
                    flush=True,
                )
    print(table(truths, lines(options.out / "results.jsonl")))


if __name__ == "__main__":
    main()
