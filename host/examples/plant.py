#!/usr/bin/env python3
"""A needle in soft tissue as a plant for `guide steer` (needle/1): one JSON object a line, on standard input and output.

The needle is a beam in finite differences, the tissue a row of springs (Winkler), each at rest where the tip was when it passed. What a
rig has besides: a limit of the needle's strain, guides with backlash, a tip load that wanders, and bad readings of the tip.
Usage: plant.py [SEED] [FOUNDATION_KPA]
"""
import json
import math
import random
import sys

H = 2.5                       # distance of the nodes, mm
EI, RADIUS = 0.0157e6, 0.635  # bending stiffness, N mm^2, and radius, mm
GUIDE2, ENTRY = 24, 32        # nodes: guide 2 at 60 mm, surface at 80 mm
DEPTH, TRAVEL, SPEED, FORCE, STRAIN = 120, 6.0, 4.0, 8.0, 0.004    # mm, mm, mm/s, N
LOAD, WANDER = 0.22, 0.015    # load of the tip, N, and what of it is added at random per square root of a millimetre
BACKLASH = 0.16               # of guide 2, mm
NOISE, DELAY, RATE, BAD = 0.15, 0.2, 10.0, 0.05    # of the tip's readings: mm, s, Hz, share


def solve(rows, right):
    """Gauss elimination of a symmetric matrix with two bands beside the diagonal."""
    n = len(right)
    a = [r[:] for r in rows]
    b = right[:]
    for i in range(n):
        for k in (1, 2):
            if i + k < n and a[i][k]:
                f = a[i][k] / a[i][0]
                for m in range(k, 3):
                    a[i + k][m - k] -= f * a[i][m]
                b[i + k] -= f * b[i]
    for i in reversed(range(n)):
        b[i] = (b[i] - sum(a[i][k] * b[i + k] for k in (1, 2) if i + k < n)) / a[i][0]
    return b


class Needle:
    """One plane of the needle."""

    def __init__(self, k_kpa):
        self.k = 1e-3 * k_kpa          # N/mm^2
        self.path = []                 # where the tip was when it passed each node beyond the surface, mm

    def at(self, depth, guide, load):
        """Tip, force of guide 2, last node passed and curvature of all nodes, with the tip at a depth."""
        tip = ENTRY + int(depth / H + 1e-9)
        beyond = depth - H * (tip - ENTRY)
        n = tip + 1
        rows = [[0.0, 0.0, 0.0] for _ in range(n)]
        right = [0.0] * n
        s = EI / H ** 3
        for m in range(1, n - 1):
            for i, x in enumerate((1, -2, 1)):
                for j, y in enumerate((1, -2, 1)):
                    if j >= i:
                        rows[m - 1 + i][j - i] += s * x * y
        rows[1][0] += 2 * s            # clamped in guide 1: the image before it is the node after it
        for i, rest in enumerate(self.path):
            if ENTRY + i < n:
                stiff = self.k * H * (0.5 if i == 0 else 1.0)
                rows[ENTRY + i][0] += stiff
                right[ENTRY + i] += stiff * rest
        # The load stands beyond the last node.
        right[tip] += load * (1 + beyond / H)
        right[tip - 1] -= load * beyond / H
        stiff = 1e5
        rows[0][0] += 1e7
        rows[GUIDE2][0] += stiff
        right[GUIDE2] += stiff * guide
        u = solve(rows, right)
        bent = [2 * u[1] / H ** 2] + [(u[m - 1] - 2 * u[m] + u[m + 1]) / H ** 2 for m in range(1, n - 1)]
        return u[tip] + beyond * (u[tip] - u[tip - 1]) / H, stiff * (guide - u[GUIDE2]), u[tip], bent

    def push(self, depth, guide, load):
        """The tip goes on to a depth and leaves the path behind."""
        while H * len(self.path) <= depth + 1e-9:
            self.path.append(self.at(H * len(self.path), guide, load)[2])


def bad(rng, read, last):
    """A reading as sensors have them now and then: reported as bad, a jump, or the last one again."""
    kind = rng.randrange(3)
    if kind == 0:
        return read, False
    if kind == 1:
        far, turn = rng.uniform(1, 15), rng.uniform(0, 2 * math.pi)
        return [read[0] + far * math.cos(turn), read[1] + far * math.sin(turn)], True
    return last, True


def main():
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    k_kpa = float(sys.argv[2]) if len(sys.argv) > 2 else 18.0
    rng = random.Random(seed)
    write = lambda what: print(json.dumps(what), flush=True)
    write({"plant": "needle/1", "needle": {"EI_n_m2": 1e-6 * EI, "outer_diameter_mm": 2 * RADIUS},
         "rig": {"guide1_to_guide2_mm": H * GUIDE2, "guide2_to_surface_mm": H * (ENTRY - GUIDE2),
                 "move_while_pushing": False, "can_rotate": False},
         "limits": {"guide_travel_mm": TRAVEL, "guide_speed_mm_s": SPEED, "guide_force_n": FORCE, "push_speed_mm_s": 5.0,
                    "rotation_speed_deg_s": 90.0, "needle_strain": STRAIN},
         "max_depth_mm": DEPTH, "depth_step_mm": 1.0, "tip_noise_mm": NOISE, "tip_delay_s": DELAY, "tip_rate_hz": RATE,
         "force_noise_n": 0.02, "guide_error_mm": BACKLASH, "bevel_deg": 0.0,
         "prior": {"foundation_kpa": 15.0, "foundation_range": [0.5, 1.5], "tip_load_n": 0.2, "tip_load_range": [0.5, 1.5],
                   "slope_mrad": 5.0}})
    planes = [Needle(k_kpa), Needle(k_kpa)]
    slope = [rng.gauss(0, 0.005), rng.gauss(0, 0.005)]
    loads = [[LOAD], [0.0]]            # along the bevel and across it, at every millimetre
    for _ in range(DEPTH + 1):
        for load in loads:
            load.append(load[-1] + rng.gauss(0, WANDER * LOAD))
    now = {"t_s": 0.0, "depth_mm": 0.0, "guide_x_mm": 0.0, "guide_y_mm": 0.0, "bevel_deg": 0.0}
    guide = [0.0, 0.0]                 # where guide 2 truly is
    arriving, shown, sampled, seq = [], (0, [0.0, 0.0], False), 0, 0
    tip, peak, bent_most, broken = [0.0, 0.0], 0.0, 0.0, {"force": 0, "strain": 0}
    for line in sys.stdin:
        to = json.loads(line)
        if to.get("done"):
            write({"true_tip_x_mm": tip[0], "true_tip_y_mm": tip[1], "depth_mm": now["depth_mm"],
                 "limits_broken": broken, "peak_force_n": peak, "peak_strain": bent_most})
            return 0
        if to["t_s"] <= now["t_s"] or not -1e-9 <= to["depth_mm"] - now["depth_mm"] <= 1.0 + 1e-9:
            write({"error": "time grows, and depth by 0 to 1 mm a step"})
            return 2
        before = tip
        for i, axis in enumerate(("guide_x_mm", "guide_y_mm")):
            guide[i] = min(max(guide[i], to[axis] - BACKLASH / 2), to[axis] + BACKLASH / 2)
        load = [load[int(to["depth_mm"])] for load in loads]
        for i in (0, 1):
            planes[i].push(to["depth_mm"], guide[i], load[i])
        ends = [planes[i].at(to["depth_mm"], guide[i], load[i]) for i in (0, 1)]
        tip = [ends[i][0] + slope[i] * to["depth_mm"] for i in (0, 1)]
        force = [ends[i][1] for i in (0, 1)]
        size, bent = math.hypot(*force), RADIUS * max(math.hypot(x, y) for x, y in zip(ends[0][3], ends[1][3]))
        peak, bent_most = max(peak, size), max(bent_most, bent)
        broken["force"] += size > FORCE
        broken["strain"] += bent > STRAIN
        while sampled / RATE <= to["t_s"] + 1e-9:
            share = min(1.0, max(0.0, (sampled / RATE - now["t_s"]) / (to["t_s"] - now["t_s"])))
            read, valid = [before[i] + share * (tip[i] - before[i]) + rng.gauss(0, NOISE) for i in (0, 1)], True
            if arriving and rng.random() < BAD:
                read, valid = bad(rng, read, arriving[-1][1])
            arriving.append((sampled / RATE, read, valid))
            sampled += 1
        while arriving and arriving[0][0] + DELAY <= to["t_s"] + 1e-9:
            shown, seq = arriving.pop(0), seq + 1
        now = to
        write({**now, "force_x_n": force[0] + rng.gauss(0, 0.02), "force_y_n": force[1] + rng.gauss(0, 0.02),
             "tip_seq": seq, "tip_t_s": shown[0], "tip_x_mm": shown[1][0], "tip_y_mm": shown[1][1], "valid": shown[2]})
    return 0


if __name__ == "__main__":
    sys.exit(main())
