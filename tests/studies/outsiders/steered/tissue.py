"""A needle in tissue by the flexibility of a clamped beam: no mesh of the needle, its deflection is a sum of closed forms.

The needle is clamped in guide 1 (z = 0). A unit force at b deflects it at a by min^2 (3 max - min) / (6 EI), the deflection of a
cantilever. Guide 2 imposes a position. Tissue acts at nodes a millimetre apart, each a spring at rest where the tip was as it passed.
Units: mm, N, s; moduli in N/mm^2.
"""
import numpy as np

STEP = 1.0     # distance of the nodes of tissue, mm


def cantilever(a, b, stiffness):
    """Deflection at a by a unit force at b."""
    a, b = np.broadcast_arrays(np.asarray(a, float), np.asarray(b, float))
    low, high = np.minimum(a, b), np.maximum(a, b)
    return low ** 2 * (3 * high - low) / (6 * stiffness)


class Needle:
    """Both planes of the needle, with what it has cut so far."""

    def __init__(self, world):
        self.world = world
        self.nodes = world.surface + STEP * np.arange(0, int(world.max_depth / STEP) + 1)
        self.moduli = [np.array([world.modulus(z - world.surface, plane) for z in self.nodes]) for plane in (0, 1)]
        self.factors = {}
        count = len(self.nodes)
        self.path = np.zeros((count, 2))
        self.relaxed = np.zeros((count, 2))
        self.cut = 0                       # nodes passed
        self.depth = 0.0
        self.steering_load = np.zeros(2)   # of a tip that cuts at an angle
        self.tip, self.tip_slope = np.zeros(2), np.zeros(2)
        self.force = np.zeros(2)
        self.strain = 0.0
        self.held = np.zeros(2)

    def flexibility(self, a, b):
        """Deflection at a by a unit force at b, with the rotation of the clamp."""
        a = np.asarray(a, float)
        return cantilever(a, b, self.world.stiffness) + self.world.clamp * a * np.asarray(b, float)

    def matrices(self, count, at_last):
        """Inverse of what relates the tissue's forces to its displacements with `count` nodes passed, by plane.

        Trapezoidal rule up to the last node; with the tip beyond it (not `at_last`) it has a whole cell: the next one, at rest as it is
        cut, then has no force, and the path does not depend on its weight.
        """
        if (count, at_last) not in self.factors:
            z, guide = self.nodes[:count], self.world.guide2
            at_guide = self.flexibility(z, guide)
            own = float(self.flexibility(guide, guide))
            between = self.flexibility(z[:, None], z[None, :]) - np.outer(at_guide, at_guide) / own
            weights = np.full(count, STEP)
            weights[0] *= 0.5
            if at_last and count > 1:
                weights[-1] *= 0.5
            planes = []
            for plane in (0, 1):
                springs = self.moduli[plane][:count] * weights + STEP * self.world.layers(z - self.world.surface)
                planes.append((np.linalg.inv(np.diag(1 / springs) + between), springs))
            self.factors[count, at_last] = (planes, at_guide, own)
        return self.factors[count, at_last]

    def solve(self, depth, guide, load):
        """Equilibrium with the tip at a depth: tip, slope of the tip, deflection of the nodes, force of guide 2, forces of the tissue."""
        world, count = self.world, self.cut
        end, held = world.surface + depth, world.guide2
        own = float(self.flexibility(held, held))
        load_at_guide = float(self.flexibility(held, end))
        bend = world.prebend
        lift = guide - 0.5 * bend * held ** 2 - load_at_guide * load
        z = self.nodes[:count]
        forces = np.zeros((count, 2))
        if count:
            planes, at_guide, own = self.matrices(count, end - z[-1] < 1e-9)
            free = (0.5 * np.outer(z ** 2, bend) + np.outer(self.flexibility(z, end), load) + np.outer(at_guide / own, lift))
            rest = world.rest(self.path[:count], self.relaxed[:count])
            for plane in (0, 1):
                forces[:, plane] = planes[plane][0] @ (rest[:, plane] - free[:, plane])
            reaction = (lift - at_guide @ forces) / own
            springs = np.stack([planes[0][1], planes[1][1]], axis=1)
            moved = rest - forces / springs
        else:
            reaction, moved = lift / own, np.zeros((0, 2))
        tip = (0.5 * bend * end ** 2 + float(self.flexibility(end, end)) * load + float(self.flexibility(end, held)) * reaction
               + self.flexibility(z, end) @ forces)
        turned = (bend * end + self.turn(end, end) * load + self.turn(end, held) * reaction
                  + (self.turn(end, z) @ forces if count else 0.0))
        return tip, turned, moved, reaction, forces

    def turn(self, a, b):
        """Slope at a >= b by a unit force at b."""
        b = np.asarray(b, float)
        return b ** 2 / (2 * self.world.stiffness) + self.world.clamp * b

    def bent(self, depth, load, reaction, forces):
        """Largest strain of bending anywhere: moments are linear between forces."""
        world = self.world
        places = np.concatenate([[world.guide2], self.nodes[:self.cut], [world.surface + depth]])
        every = np.vstack([reaction[None, :], forces, load[None, :]])
        at = np.concatenate([[0.0], places])
        arms = np.maximum(places[None, :] - at[:, None], 0.0)
        moments = arms @ every
        return world.radius * float(np.max(np.hypot(moments[:, 0], moments[:, 1]))) / world.stiffness

    def to(self, depth, guide, load_of, seconds):
        """One step in straight lines: the tip goes on to a depth, guide 2 to a position."""
        world = self.world
        start, begun = self.depth, self.held.copy()
        length = depth - start
        stations = [z - world.surface for z in self.nodes[self.cut:] if z - world.surface <= depth + 1e-9]
        for station in [*stations, depth]:
            share = 1.0 if length <= 0 else (station - start) / length
            here = begun + min(max(share, 0.0), 1.0) * (guide - begun)
            load = load_of(station)
            if world.cut_angle is not None:
                load = load + self.kept_on_course(station, here, load)
            if self.cut < len(self.nodes) and abs(self.nodes[self.cut] - world.surface - station) < 1e-9:
                tip = self.solve(station, here, load)[0]
                self.path[self.cut] = tip
                self.relaxed[self.cut] = tip
                self.cut += 1
            tip, turned, moved, reaction, forces = self.solve(station, here, load)
            world.yielded(self.path[:self.cut], moved)
            world.relax(self.relaxed[:self.cut], moved, seconds / (len(stations) + 1))
            self.tip_slope, self.depth = turned, station
            self.tip, self.force = tip, reaction
            self.strain = self.bent(station, load, reaction, forces)
        self.held = np.array(guide, float)

    def kept_on_course(self, station, guide, load):
        """Further load of a tip that goes on at an angle to its axis; as it was while the needle rests."""
        if station > self.depth and self.cut:
            aim = self.tip + (station - self.depth) * (self.tip_slope + self.world.cut_angle)
            ahead = self.solve(station, guide, load)[0]
            yields = self.solve(station, guide, load + np.array([1.0, 0.0]))[0][0] - ahead[0]
            self.steering_load = np.clip((aim - ahead) / yields, -0.6, 0.6)
        return self.steering_load
