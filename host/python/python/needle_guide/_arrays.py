"""Sessions from arrays in memory."""

from __future__ import annotations

import os
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._errors import ArgumentError, NeedleGuideError, UsageError

Columns = Mapping[str, Any]

_FORCE = (
    ("time_s", "displacement_y_mm", "force_y_n"),
    ("displacement_x_mm", "force_x_n", "lost_before", "step", "moving"),
)
_SHAPE = (
    ("z_mm", "deflection_y_mm"),
    (
        "time_s",
        "deflection_x_mm",
        "deflection_y_sd_mm",
        "deflection_x_sd_mm",
        "beam_deg",
        "probe_mm_per_s",
        "z_shared_sd_mm",
        "deflection_y_shared_1_mm",
        "deflection_y_shared_2_mm",
        "deflection_y_shared_3_mm",
        "deflection_x_shared_1_mm",
        "deflection_x_shared_2_mm",
        "deflection_x_shared_3_mm",
    ),
)
_PATH = (
    ("depth_mm", "tip_y_mm"),
    (
        "tip_x_mm",
        "time_s",
        "rotation_deg",
        "guide2_y_mm",
        "guide2_x_mm",
        "base_force_y_n",
        "tip_direction_y_mrad",
        "tip_direction_x_mrad",
    ),
)
_STEERING = (("time_s", "depth_mm", "base_y_mm", "base_force_y_n", "tip_y_mm"), ())
# Kind of run: its files with their columns, and its numbers.
_KINDS: dict[str, tuple[dict[str, tuple[tuple[str, ...], tuple[str, ...]]], tuple[str, ...]]] = {
    "lateral": ({"force": _FORCE, "shape": _SHAPE}, ("depth_mm",)),
    "insertion": ({"path": _PATH}, ()),
    "steering": ({"data": _STEERING}, ()),
}
_WHOLE = ("lost_before", "step", "moving")


def write(
    folder: pathlib.Path,
    tables: Mapping[str, Mapping[str, object]],
    runs: Mapping[str, Sequence[Mapping[str, Any]]],
) -> None:
    """Writes a session folder.

    Raises:
        UsageError: names the array or the field that is wrong.
    """
    lines = []
    for name, fields in tables.items():
        if fields:
            lines += [f"[{name}]", *(f"{key} = {_toml(f'{name}.{key}', value)}" for key, value in fields.items()), ""]
    for kind, some in runs.items():
        ids: set[str] = set()
        for number, run in enumerate(some):
            where = f"{kind}[{number}]"
            lines += [f"[[{kind}]]", *_run(folder, kind, where, run, ids), ""]
    (folder / "session.toml").write_text("\n".join(lines), encoding="utf-8")


def _run(folder: pathlib.Path, kind: str, where: str, run: Mapping[str, Any], ids: set[str]) -> list[str]:
    files, numbers = _KINDS[kind]
    expected = ("id", *numbers, *files)
    if not isinstance(run, Mapping):
        raise UsageError(f"{where}: {type(run).__name__}, expected a mapping with {', '.join(expected)}")
    for name in run:
        if name not in expected:
            raise UsageError(f"{where}: {name}: is not known, expected {_meant(name, expected)}")
    for name in expected:
        if name not in run:
            raise UsageError(f"{where}: {name}: missing")
    identifier = str(run["id"])
    if identifier in ids:
        raise UsageError(f'{where}: id: "{identifier}" is there twice, expected one run per id')
    ids.add(identifier)
    lines = [f"id = {_toml(f'{where}: id', identifier)}"]
    lines += [f"{name} = {_toml(f'{where}: {name}', float(run[name]))}" for name in numbers]
    for name, columns in files.items():
        file = f"{kind}-{len(ids)}.{name}.csv"
        text = _csv(f"{where}: {name}", run[name], *columns)
        (folder / file).write_text(text, encoding="utf-8")
        lines.append(f'{name} = "{file}"')
    return lines


def _csv(where: str, columns: Columns, required: tuple[str, ...], optional: tuple[str, ...]) -> str:
    if not hasattr(columns, "keys"):
        raise UsageError(f"{where}: {type(columns).__name__}, expected a mapping of names to arrays, or a DataFrame")
    known = required + optional
    names = [str(name) for name in columns.keys()]  # noqa: SIM118 - of a DataFrame too
    for name in names:
        if name not in known:
            raise UsageError(f"{where}.{name}: is not known, expected {_meant(name, known)}")
    for name in required:
        if name not in names:
            raise UsageError(f"{where}.{name}: missing, expected an array")
    arrays: dict[str, Any] = {}
    count = None
    for name in names:
        try:
            values = np.ma.filled(np.ma.asarray(columns[name], dtype=np.float64), np.nan)
        except (TypeError, ValueError):
            raise UsageError(f"{where}.{name}: holds something else than numbers") from None
        if values.ndim != 1:
            raise UsageError(f"{where}.{name}: shape {values.shape}, expected one dimension")
        if count is None:
            count = len(values)
        elif len(values) != count:
            raise UsageError(f"{where}.{name}: {len(values)} values, expected {count} as {names[0]} has")
        unusable = ~np.isfinite(values)
        if name in required and unusable.any():
            first = int(np.argmax(unusable))
            masked = bool(np.ma.getmaskarray(columns[name])[first]) if np.ma.isMaskedArray(columns[name]) else False
            what = "masked" if masked else "not finite"
            raise UsageError(f"{where}.{name}: value {first} is {what}, expected a number")
        arrays[name] = values
    rows = [",".join(names)]
    for row in zip(*arrays.values(), strict=True):
        rows.append(",".join(_cell(name, float(value)) for name, value in zip(names, row, strict=True)))
    return "\n".join(rows) + "\n"


def of_arguments(error: NeedleGuideError, folder: pathlib.Path) -> ArgumentError:
    """An error about a session that was written here, with the names of arguments in place of those of its files."""

    def column(match: re.Match[str]) -> str:
        kind, number, file, line = match.groups()
        row = "" if line is None else f", value {int(line) - 2}"
        return f"{kind}[{int(number) - 1}]: {file}{row}"

    message = error.message.replace(f"{folder}{os.sep}", "")
    message = re.sub(r"(lateral|insertion|steering)-(\d+)\.(\w+)\.csv(?::(\d+))?(?::\d+)?", column, message)
    message = re.sub(r"session\.toml(:\d+)?(:\d+)?: ", "", message).replace(str(folder), "the session")
    return ArgumentError(message, field=error.field)


def _cell(name: str, value: float) -> str:
    if not np.isfinite(value):
        return ""
    return str(int(value)) if name in _WHOLE else repr(value)


def _meant(name: str, known: tuple[str, ...]) -> str:
    """The known name of the same quantity, where the unit is another; else all of them."""
    stem = name.rsplit("_", 1)[0]
    same = [one for one in known if one.rsplit("_", 1)[0] in (stem, name)]
    if len(same) == 1:
        return f"{same[0]}: the unit is part of the name"
    return "one of " + ", ".join(known)


def _toml(where: str, value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        if not np.isfinite(value):
            raise UsageError(f"{where}: {value}, expected a finite number")
        return repr(float(value))
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        if any(ord(character) < 32 for character in escaped):
            raise UsageError(f"{where}: holds a control character, expected plain text")
        return f'"{escaped}"'
    raise UsageError(f"{where}: {type(value).__name__}, expected a number or a text")
