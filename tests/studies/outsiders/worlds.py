"""Measurement sessions with a hidden effect, for blind tests of a diagnosis.

    python worlds.py OUT_DIR --kind KIND|all --set a|b|c|d|e|f --count N --seed S

writes OUT_DIR/<kind>_<seed>/ (session.toml and CSV files, format 1) and appends one line per session to
OUT_DIR/truth.jsonl. Seeds run from S to S + N - 1; the strength goes round 1, 2, 3 with the seed unless --strength is
given. `--list` prints the kinds.

Every session has eight lateral runs (15, 22 and 30 mm along y, twice each; 22 and 30 mm along x), guide 2 led through
holds, force and displacement read at 100 Hz, and a shape in five holds. Every session also has the small imperfections
of a real lab (`background.py`), whose sizes are drawn by the seed. `visibility.py` says how much the effect changes.
"""

from __future__ import annotations

import argparse
import json
import os
import zlib
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: the matrices are small, threads only cost time

import numpy as np  # noqa: E402

from effects import EFFECTS, MM  # noqa: E402
from physics import Readings  # noqa: E402
from sessions import Session, build, group_of, kinds, read  # noqa: E402
from visibility import moduli, visibility  # noqa: E402


def write(folder: Path, session: Session, seen: list[Readings], rng: np.random.Generator, name: str) -> None:
    """Write a session of format 1, with noise."""
    folder.mkdir(parents=True, exist_ok=True)
    g, noise = session.world.stated, session.noise
    lines = [
        "[session]",
        "format = 1",
        f'name = "{name}"',
        "",
        "[needle]",
        f"youngs_modulus_gpa = {g.youngs / 1e9:.1f}",
        f"outer_diameter_mm = {g.outer / MM:.3f}",
        f"inner_diameter_mm = {g.inner / MM:.3f}",
        "",
        "[rig]",
        f"guide2_mm = {g.guide2 / MM:.1f}",
        f"entry_mm = {g.entry / MM:.1f}",
        "",
    ]
    if session.world.noise_stated:
        lines += ["[noise]", *[f"{key} = {value:.5f}" for key, value in noise.items()], ""]
    for r in seen:
        run = r.run
        lines += [
            "[[lateral]]",
            f'id = "{run.name}"',
            f"depth_mm = {run.depth / MM:.1f}",
            f'force = "{run.name}.force.csv"',
            f'shape = "{run.name}.shape.csv"',
            "",
        ]
        force = r.force + rng.normal(0, noise["force_n"], r.force.shape)
        moved = r.displacement / MM + rng.normal(0, noise["displacement_mm"], r.displacement.shape)
        np.savetxt(
            folder / f"{run.name}.force.csv",
            np.column_stack([r.time, moved[0], force[0], moved[1], force[1]]),
            fmt=["%.2f" if run.rate_hz == 100.0 else "%.5f", "%.6f", "%.6f", "%.6f", "%.6f"],
            delimiter=",",
            comments="",
            header="time_s,displacement_y_mm,force_y_n,displacement_x_mm,force_x_n",
        )
        rows = np.concatenate(
            [
                np.column_stack(
                    [w.time, w.z / MM, (w.deflection / MM + rng.normal(0, noise["shape_mm"], w.deflection.shape)).T]
                )
                for w in r.sweeps
            ]
        )
        np.savetxt(
            folder / f"{run.name}.shape.csv",
            rows,
            fmt=["%.4f", "%.3f", "%.6f", "%.6f"],
            delimiter=",",
            comments="",
            header="time_s,z_mm,deflection_y_mm,deflection_x_mm",
        )
    (folder / "session.toml").write_text("\n".join(lines))


def make(out: Path, kind: str, seed: int, strength: int, files: bool = True) -> dict[str, object]:
    """Make one session and return its truth."""
    session = build(kind, seed, strength)
    seen = [read(session.world, run) for run in session.runs]
    seen_size = visibility(session, seen, kind, seed, strength)
    folder = f"{kind}_{seed}"
    tag = zlib.crc32(kind.encode())
    if files:
        write(
            out / folder,
            session,
            seen,
            np.random.default_rng([seed, tag, 5]),
            f"phantom {(tag ^ seed * 7919) % 10000:04d}",
        )
    hidden = [
        {
            "kind": e.kind,
            "set": e.group,
            "site": e.site,
            "depends_on": e.depends_on,
            "formula": e.formula,
            "parameters": p,
        }
        for e, p in session.hidden
    ]
    largest = max((abs(float(r.force.max())) for r in seen), default=0.0)
    scale = float(str(seen_size["k_scale_of_plain_world"]))
    only = hidden[0] if len(hidden) == 1 else None
    return {
        "folder": folder,
        "kind": kind,
        "set": group_of(kind),
        "seed": seed,
        "strength": strength + 1,
        "site": only["site"] if only else [h["site"] for h in hidden],
        "depends_on": only["depends_on"] if only else [h["depends_on"] for h in hidden],
        "formula": only["formula"] if only else [h["formula"] for h in hidden],
        "parameters": only["parameters"] if only else [h["parameters"] for h in hidden],
        "effects": hidden,
        **moduli(session, scale),
        **seen_size,
        "largest_reading_n": largest,
        "noise": session.noise,
        "noise_stated": session.world.noise_stated,
        "background": session.background,
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Measurement sessions with a hidden effect, for blind tests")
    parser.add_argument("out", type=Path, nargs="?", help="folder for the sessions and truth.jsonl")
    parser.add_argument("--kind", default="all", help="kind, several with commas, or all")
    parser.add_argument("--set", choices=list("abcdef"), help="only the kinds of this set")
    parser.add_argument("--count", type=int, default=1, help="sessions per kind")
    parser.add_argument("--seed", type=int, default=1, help="first seed")
    parser.add_argument("--strength", type=int, choices=[1, 2, 3], help="strength of all (default: 1, 2, 3 in turn)")
    parser.add_argument("--dry", action="store_true", help="write truth.jsonl only, no sessions")
    parser.add_argument("--list", action="store_true", help="print the kinds")
    options = parser.parse_args()
    wanted = kinds(options.set) if options.kind == "all" else options.kind.split(",")
    unknown = [k for k in wanted if k not in kinds(None)]
    if unknown:
        parser.error(f"no such kind: {', '.join(unknown)}")
    if options.list:
        for kind in wanted:
            e = EFFECTS.get(kind)
            print(f"{group_of(kind)} {kind:30s}" + (f" {e.site}: {e.formula}" if e else ""))
        return
    if options.out is None:
        parser.error("OUT_DIR is missing")
    options.out.mkdir(parents=True, exist_ok=True)
    for kind in wanted:
        for i in range(options.count):
            seed = options.seed + i
            strength = options.strength - 1 if options.strength else seed % 3
            truth = make(options.out, kind, seed, strength, not options.dry)
            with (options.out / "truth.jsonl").open("a") as file:
                file.write(json.dumps(truth) + "\n")
            print(
                f"{truth['folder']:36s} strength {strength + 1}  removable chi2 {truth['removable_chi2']:10.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
