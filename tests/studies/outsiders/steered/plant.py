#!/usr/bin/env python3
"""A plant of `guide steer`, written from the manual's page "Plants" alone: needle/1 on standard input and output.

Usage: plant.py TISSUE SEED [--hide EFFECT] [--limit NAME=VALUE]...
"""
import argparse
import json
import sys

import numpy as np

from tissue import Needle
from world import HIDDEN, LIMITS, World

RATE, DELAY, BAD = 10.0, 0.2, 0.05


class Guide:
    """Guide 2: what is commanded, and where it truly is."""

    def __init__(self, world):
        self.world = world
        self.commanded = np.zeros(2)
        self.at = world.offset.copy()

    def to(self, commanded, seconds):
        """Moves as a drive would: within travel and speed; returns which of the two were exceeded."""
        limits = self.world.limits
        exceeded = (bool(np.any(np.abs(commanded) > limits["travel"] + 1e-6)),
                    bool(np.any(np.abs(commanded - self.commanded) > limits["speed"] * seconds + 1e-6)))
        reach = limits["speed"] * seconds
        commanded = np.clip(commanded, -limits["travel"], limits["travel"])
        self.commanded = np.clip(commanded, self.commanded - reach, self.commanded + reach)
        aim = (1 + self.world.lead) * self.commanded + self.world.offset
        half = 0.5 * self.world.backlash
        self.at = np.clip(self.at, aim - half, aim + half)
        return exceeded


class Tracker:
    """Tip sensor: delayed, noisy, and now and then wrong."""

    def __init__(self, world):
        self.world = world
        self.rng = np.random.default_rng(world.noise_seed)
        self.waiting, self.count, self.seq = [], 0, 0
        self.last = (0.0, np.zeros(2), False)

    def step(self, begun, ended, before, after):
        """Reads at its rate between two times, in straight lines; what has arrived by the end."""
        while self.count / RATE <= ended + 1e-9:
            when = self.count / RATE
            share = min(1.0, max(0.0, (when - begun) / max(ended - begun, 1e-9)))
            read = before + share * (after - before) + self.rng.normal(0, self.world.tip_noise, 2)
            read = read + self.world.bias + self.world.drift * min(1.0, when / 40.0)
            valid = True
            if self.waiting and self.rng.random() < BAD:
                kind = self.rng.integers(3)
                valid = kind != 0
                if kind == 1:
                    read = read + self.rng.normal(0, 6.0, 2)
                if kind == 2:
                    read = self.waiting[-1][1]
            self.waiting.append((when, read, bool(valid)))
            self.count += 1
        while self.waiting and self.waiting[0][0] + DELAY <= ended + 1e-9:
            self.last = self.waiting.pop(0)
            self.seq += 1
        return self.last


def options():
    """Options of the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("tissue", choices=["plain", "standard"])
    parser.add_argument("seed", type=int)
    parser.add_argument("--hide", choices=HIDDEN)
    parser.add_argument("--limit", action="append", default=[], metavar="NAME=VALUE")
    stated = parser.parse_args()
    limits = {}
    for text in stated.limit:
        name, _, value = text.partition("=")
        if name not in LIMITS:
            parser.error(f"--limit {text}: expected one of {', '.join(LIMITS)}")
        limits[name] = float(value)
    return stated, limits


def main():
    stated, limits = options()
    world = World(stated.tissue, stated.seed, stated.hide, limits)
    needle, guide, tracker = Needle(world), Guide(world), Tracker(world)
    write = lambda line: print(json.dumps(line), flush=True)
    write(world.statement())
    now, depth = 0.0, 0.0
    needle.to(0.0, guide.at, lambda d: world.load(d, 0.0), 0.1)
    tip, tare = needle.tip, needle.force
    peak, strain = 0.0, 0.0
    broken = dict.fromkeys(("travel", "speed", "force", "push_speed", "rotation_speed", "moved_while_pushed", "strain"), 0)
    bevel = 0.0
    for line in sys.stdin:
        to = json.loads(line)
        if to.get("done"):
            write({"true_tip_x_mm": tip[0], "true_tip_y_mm": tip[1], "depth_mm": depth, "limits_broken": broken,
                   "peak_force_n": peak, "peak_strain": strain})
            return 0
        seconds, pushed = to["t_s"] - now, to["depth_mm"] - depth
        if not 0 < seconds <= 10 or not -1e-9 <= pushed <= 1 + 1e-9 or to["depth_mm"] > world.max_depth:
            write({"error": "time or depth against the rules"})
            return 2
        commanded = np.array([to["guide_x_mm"], to["guide_y_mm"]])
        broken["moved_while_pushed"] += bool(pushed > 1e-9 and np.any(np.abs(commanded - guide.commanded) > 1e-9))
        broken["push_speed"] += bool(pushed > 5.0 * seconds + 1e-9)
        turned = abs(to["bevel_deg"] - np.degrees(bevel))
        broken["rotation_speed"] += bool(turned > 90 * seconds + 1e-6)
        travel, speed = guide.to(commanded, seconds)
        broken["travel"] += travel
        broken["speed"] += speed
        bevel = np.radians(to["bevel_deg"])
        before = tip
        needle.to(to["depth_mm"], guide.at, lambda d: world.load(d, bevel), seconds)
        depth = to["depth_mm"]
        tip = needle.tip + world.slope * depth
        force = float(np.hypot(*needle.force))
        peak, strain = max(peak, force), max(strain, needle.strain)
        broken["force"] += force > world.limits["force"]
        broken["strain"] += needle.strain > world.limits["strain"]
        when, read, valid = tracker.step(now, to["t_s"], before, tip)
        now = to["t_s"]
        sensed = needle.force - tare + world.force_offset + tracker.rng.normal(0, world.force_noise, 2)
        write({"t_s": now, "depth_mm": depth, "guide_x_mm": guide.commanded[0], "guide_y_mm": guide.commanded[1],
               "bevel_deg": to["bevel_deg"], "force_x_n": sensed[0], "force_y_n": sensed[1], "tip_seq": tracker.seq,
               "tip_t_s": when, "tip_x_mm": read[0], "tip_y_mm": read[1], "valid": valid})
    return 0


if __name__ == "__main__":
    sys.exit(main())
