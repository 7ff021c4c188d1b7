"""Time and memory of `guide population` over many records: processor time, and the most memory that the process has had.

    python host/python/benches/population.py [RECORDS...]

Records are those of the example session with other names, labels, dates, moduli and scores. 100 000 take 2 GB below the temporary folder.
"""

from __future__ import annotations

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

from needle_guide import Session

TISSUES = (("gel", 12.0, 0.08), ("liver", 5.0, 0.15), ("muscle", 20.0, 0.25))
SEED = 77


def write(record: dict[str, Any], path: pathlib.Path, count: int) -> None:
    """Writes so many records."""
    random = np.random.default_rng(SEED)
    result = record["result"]
    informations = np.array([one["information"] for one in result["amplitudes"]])
    with path.open("w", encoding="utf-8") as file:
        for number in range(count):
            tissue, k_kpa, spread = TISSUES[number % len(TISSUES)]
            sd = float(random.uniform(0.03, 0.15))
            ln_k = float(np.log(k_kpa) + random.normal(0.0, spread) + random.normal(0.0, sd))
            scores = random.normal(0.0, np.sqrt(informations))
            amplitudes = [{**one, "score": float(score)} for one, score in zip(result["amplitudes"], scores, strict=True)]
            changed = {"ln_k_kpa": ln_k, "ln_k_sd": sd, "k_kpa": float(np.exp(ln_k)), "verdict": "adequate", "named": [], "amplitudes": amplitudes}
            labels = {"rig": f"r{number % 20}", "tissue": tissue, "subject": f"p{number}", "date": f"2026-{1 + number % 12:02}-{1 + number % 28:02}"}
            file.write(json.dumps({**record, "session": f"s{number:06}", **labels, "result": {**result, **changed}}) + "\n")


def main() -> None:
    """Prints a row per number of records."""
    counts = [int(one) for one in sys.argv[1:]] or [1_000, 10_000, 100_000]
    record = json.loads(Session.example().summarize().to_json())
    guide = pathlib.Path(sys.executable).with_name("guide")
    print("| records | file, MB | elapsed, s | processor, s | memory, MB |\n|---|---|---|---|---|")
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "all.jsonl"
            write(record, path, count)
            begun = time.perf_counter()
            process = subprocess.Popen([guide, "population", path, "--by", "tissue"], stdout=subprocess.DEVNULL)
            _, status, usage = os.wait4(process.pid, 0)
            elapsed_s = time.perf_counter() - begun
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode != 0:
                raise SystemExit(f"guide population: exit code {process.returncode}")
            size_mb = path.stat().st_size / 1e6
            print(f"| {count} | {size_mb:.0f} | {elapsed_s:.1f} | {usage.ru_utime + usage.ru_stime:.1f} | {usage.ru_maxrss / 1e3:.0f} |", flush=True)


if __name__ == "__main__":
    main()
