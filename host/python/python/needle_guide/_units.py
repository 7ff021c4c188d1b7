"""Units of the parameters of effects, from the catalogue."""

from __future__ import annotations

import functools
import json

from . import _core
from ._values import Document, Quantity, interval


@functools.cache
def _units() -> dict[tuple[str, str], str]:
    """Unit of every parameter of every effect."""
    effects = json.loads(_core.call(["effects"], None)[0])["effects"]
    return {(one["id"], of["name"]): of["unit"] for one in effects for of in one["parameters"]}


def parameter(effect: str, name: str, value: Document) -> Quantity:
    """A parameter of an effect with its unit and its interval."""
    return Quantity(value["value"], _units().get((effect, name), ""), interval(value["ci95"]))
