"""Hidden effects: one function per kind, each adding its mechanism to a world.

Set a: effects that a mechanical or instrument engineer meets but a catalogue of usual effects would not hold.
Set b: usual effects. Set e: stated geometry that is wrong. Set f: an elastic body in place of springs.
(Sets c, combinations, and d, background and noise alone, are put together in `sessions.py`.)
"""

from . import force, needle, shape, stated, tissue, usual
from .catalogue import MM, REGISTERED, Effect, Parameters

# Seeds draw effects by their place in this list, whatever the order of import.
_ORDER = (tissue, needle, force, shape, usual, stated)
EFFECTS: dict[str, Effect] = {
    kind: hidden
    for module in _ORDER
    for kind, hidden in REGISTERED.items()
    if hidden.apply.__module__ == module.__name__
}

__all__ = ["EFFECTS", "MM", "Effect", "Parameters"]
