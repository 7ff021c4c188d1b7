"""What a rig, its needle and its tissue are, drawn by a seed: plain, standard, or with one effect that nothing states."""
import numpy as np

HIDDEN = ("cut_angle", "gap", "rear_rotation", "anisotropy", "inclusion", "membrane", "prebend", "drift", "backlash", "tip_bias")
LIMITS = {"travel": 6.0, "speed": 4.0, "force": 12.0, "strain": 0.004}
MODULUS, LOAD = 0.015, 0.2       # of the prior: N/mm^2, N
WANDER = 0.015                   # of the load, per square root of a millimetre


class World:
    """A plant's true values; `stated` is what it says of itself."""

    def __init__(self, tissue, seed, hidden=None, limits=None):
        rng = np.random.default_rng([seed, {"plain": 0, "standard": 1}[tissue], 62])
        self.limits = {**LIMITS, **(limits or {})}
        self.max_depth = 110.0
        self.stiffness = rng.uniform(0.012, 0.020) * 1e6
        self.radius = 0.5 * 1.27
        self.guide2 = rng.uniform(50, 70)
        gap = rng.uniform(15, 30)
        self.surface = self.guide2 + gap
        self.k = MODULUS * rng.uniform(0.5, 1.5)
        self.clamp, self.prebend, self.cut_angle = 0.0, np.zeros(2), None
        self.zones, self.thin, self.across = [], [], 1.0
        self.slope = rng.uniform(-0.010, 0.010, 2)
        load = LOAD * rng.uniform(0.5, 1.5)
        steps = rng.normal(0, WANDER * load, (int(self.max_depth) + 2, 2))
        self.loads = np.array([load, 0.0]) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
        self.tip_noise, self.force_noise = rng.uniform(0.1, 0.3), 0.02
        self.force_offset = rng.normal(0, 0.05, 2)
        # Offset, lead and backlash together stay within what is stated.
        self.guide_error = 0.3
        self.offset = rng.uniform(-0.08, 0.08, 2)
        self.lead = rng.uniform(-0.012, 0.012)
        self.backlash = rng.uniform(0.05, 0.20)
        self.bias, self.drift = np.zeros(2), np.zeros(2)
        self.yield_mm, self.relaxing, self.time_s = None, 0.0, 1.0
        if tissue == "standard":
            boundary, other = rng.uniform(20, 70), MODULUS * rng.uniform(0.5, 1.5)
            self.zones.append((boundary, self.max_depth + 1, other / self.k))
            self.thin.append((0.0, 2.0, rng.uniform(1.0, 3.0) * 2.0 * self.k))
            if rng.random() < 0.5:
                self.yield_mm = rng.uniform(1.0, 2.0)
            else:
                self.relaxing, self.time_s = rng.uniform(0.1, 0.35), rng.uniform(3, 15)
        self.stated_gap = gap
        self.effect(hidden, rng)
        self.noise_seed = int(rng.integers(1 << 31))

    def effect(self, hidden, rng):
        """One effect that the statement does not hold."""
        sign, turn = rng.choice([-1, 1]), rng.uniform(0, 2 * np.pi)
        along = np.array([np.cos(turn), np.sin(turn)])
        size = rng.uniform(0.5, 1.0)
        if hidden == "cut_angle":
            self.cut_angle = 0.02 * size * np.array([1.0, 0.0])
        elif hidden == "gap":
            self.surface += sign * 4.0 * size
        elif hidden == "rear_rotation":
            self.clamp = 0.8 * size * self.guide2 / (4 * self.stiffness)
        elif hidden == "anisotropy":
            self.across = 1.0 + 0.8 * size
        elif hidden == "inclusion":
            begin = rng.uniform(30, 65)
            self.zones.append((begin, begin + 20, 1.0 + 3.0 * size))
        elif hidden == "membrane":
            self.thin.append((rng.uniform(30, 70), 1.0, 20.0 * size * self.k))
        elif hidden == "prebend":
            self.prebend = 1.2e-4 * size * along
        elif hidden == "drift":
            self.drift = 0.4 * size * along
        elif hidden == "backlash":
            self.backlash = 0.5 + 0.4 * size
        elif hidden == "tip_bias":
            self.bias = 0.4 * size * along
        elif hidden is not None:
            raise ValueError(f"hidden is {hidden}, expected one of {', '.join(HIDDEN)}")

    def modulus(self, depth, plane):
        """Stiffness of the tissue per length, at a depth."""
        value = self.k * (self.across if plane else 1.0)
        for begin, end, factor in self.zones:
            if begin <= depth < end:
                value *= factor
        return value

    def layers(self, depths):
        """Further stiffness per length of thin layers, at depths."""
        stiff = np.zeros(len(depths))
        for begin, thick, spring in self.thin:
            inside = (depths >= begin) & (depths < begin + thick)
            stiff[inside] += spring / thick
        return stiff

    def load(self, depth, bevel):
        """Load of the tip at a depth: it turns with the bevel."""
        at = min(depth, len(self.loads) - 1.001)
        low = int(at)
        along, across = self.loads[low] + (at - low) * (self.loads[low + 1] - self.loads[low])
        c, s = np.cos(bevel), np.sin(bevel)
        return np.array([c * along - s * across, s * along + c * across])

    def rest(self, path, relaxed):
        """Where springs are at rest: their elastic part on the path, the other follows the needle."""
        return (1 - self.relaxing) * path + self.relaxing * relaxed

    def yielded(self, path, moved):
        """Tissue that is pressed further than it bears keeps the rest."""
        if self.yield_mm is not None and len(path):
            pressed = moved - path
            size = np.hypot(pressed[:, 0], pressed[:, 1])
            beyond = size > self.yield_mm
            path[beyond] += pressed[beyond] * (1 - self.yield_mm / size[beyond])[:, None]

    def relax(self, relaxed, moved, seconds):
        """The part that relaxes comes nearer to the needle."""
        if self.relaxing:
            relaxed += (moved - relaxed) * (1 - np.exp(-seconds / self.time_s))

    def statement(self):
        """First line of the plant."""
        limits = self.limits
        return {
            "plant": "needle/1",
            "needle": {"EI_n_m2": 1e-6 * self.stiffness, "outer_diameter_mm": 2 * self.radius},
            "rig": {"guide1_to_guide2_mm": self.guide2, "guide2_to_surface_mm": self.stated_gap,
                    "move_while_pushing": False, "can_rotate": False},
            "limits": {"guide_travel_mm": limits["travel"], "guide_speed_mm_s": limits["speed"], "guide_force_n": limits["force"],
                       "push_speed_mm_s": 5.0, "rotation_speed_deg_s": 90.0, "needle_strain": limits["strain"]},
            "max_depth_mm": self.max_depth, "depth_step_mm": 1.0, "tip_noise_mm": self.tip_noise, "tip_delay_s": 0.2,
            "tip_rate_hz": 10.0, "force_noise_n": self.force_noise, "guide_error_mm": self.guide_error, "bevel_deg": 0.0,
            "prior": {"foundation_kpa": 1e3 * MODULUS, "foundation_range": [0.5, 1.5], "tip_load_n": LOAD,
                      "tip_load_range": [0.5, 1.5], "slope_mrad": 10.0},
        }
