"""Times of the peers: the least of repeats for about a second, after one call that warms up."""

import json
import sys
import time


def seconds(work, least=3, most=300, budget=1.0):
    """Least seconds of a call: when nothing else disturbs it."""
    work()
    times = []
    while len(times) < least or (sum(times) < budget and len(times) < most):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def report(peers):
    """Prints what was measured: name, function and what part of its result is compared, as (name, work) or (name, work, calls)."""
    out = []
    for name, work, *calls in peers:
        try:
            result = [float(value) for value in work()]
            out.append({"name": name, "seconds": seconds(work) / (calls[0] if calls else 1), "result": result})
        except Exception as error:  # A peer that does not run here is reported, not hidden.
            out.append({"name": name, "error": f"{type(error).__name__}: {error}"})
    json.dump(out, sys.stdout)


def given():
    """Input from the caller."""
    return json.load(open(sys.argv[1]))
