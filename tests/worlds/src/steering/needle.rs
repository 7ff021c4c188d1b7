//! The needle in its tissue, marched in time.

use super::sensor::Body;

/// Distance of the springs, m.
const SPRING_M: f64 = 0.5e-3;
/// Length of the elements in the tissue, m.
const ELEMENT_M: f64 = 1e-3;

/// Parameters of the tissue.
#[derive(Debug, Clone, PartialEq)]
pub struct Tissue {
    /// Modulus against depth: value, and values from depths on, Pa and m.
    pub modulus_pa: f64,
    /// Depths from which the modulus is another, m, and its factor.
    pub layers: Vec<[f64; 2]>,
    /// Growth of the modulus per depth, 1/m.
    pub gradient_per_m: f64,
    /// Spring at the surface, N/m.
    pub skin_n_per_m: f64,
    /// Largest load per length at the surface, N/m, and the depth over which it grows by e, m; infinite where it does not yield.
    pub yield_n_per_m: f64,
    /// See `yield_n_per_m`.
    pub yield_depth_m: f64,
    /// Share that relaxes and its time, s.
    pub relaxing: f64,
    /// See `relaxing`.
    pub relaxation_s: f64,
    /// Modulus in y over that in x.
    pub anisotropy: f64,
    /// Shear stiffness between springs, N.
    pub shear_n: f64,
}

/// Law by which the tip cuts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tip {
    /// Under a load.
    Load,
    /// Along the needle, at this angle along the bevel, rad.
    Angle(f64),
}

/// One spring of the tissue, in both planes.
#[derive(Debug, Clone, Copy, Default)]
struct Spring {
    rest_m: [f64; 2],
    flow_m: [f64; 2],
}

/// The needle.
#[derive(Debug, Clone)]
pub struct Needle {
    /// Bending stiffness, N m^2.
    pub stiffness_n_m2: f64,
    /// From guide 1 to guide 2, m.
    pub guide2_m: f64,
    /// From guide 2 to the surface, m.
    pub gap_m: f64,
    /// Rotation in guide 1 per moment, rad/(N m).
    pub clamp_rad_per_n_m: f64,
    /// Compliance of guide 2's frame, m/N.
    pub frame_m_per_n: f64,
    /// Radius of the needle, m.
    pub radius_m: f64,
    /// Stress-free curvature along the bevel, 1/m.
    pub prebend_per_m: f64,
    /// Compression of the needle, N.
    pub axial_n: f64,
    /// The tissue.
    pub tissue: Tissue,
    /// Law by which the tip cuts.
    pub tip: Tip,
    springs: Vec<Spring>,
    /// Tip in both planes, its slope, force at guide 2.
    /// Tip, x and y, m.
    pub tip_m: [f64; 2],
    /// Slope of the needle at its tip, x and y.
    pub slope: [f64; 2],
    /// Force of guide 2 on the needle, x and y, N.
    pub force_n: [f64; 2],
    /// Largest bending strain of the needle.
    pub strain: f64,
    /// Load of a tip that cuts at an angle, N.
    held_n: [f64; 2],
    depth_m: f64,
}

impl Needle {
    /// At the surface.
    pub fn new(tissue: Tissue, tip: Tip, gap_m: f64) -> Self {
        Self {
            stiffness_n_m2: 0.0157,
            guide2_m: 0.06,
            gap_m,
            clamp_rad_per_n_m: 0.0,
            frame_m_per_n: 0.0,
            radius_m: 0.635e-3,
            prebend_per_m: 0.0,
            axial_n: 0.0,
            tissue,
            tip,
            springs: Vec::new(),
            tip_m: [0.0; 2],
            slope: [0.0; 2],
            force_n: [0.0; 2],
            strain: 0.0,
            held_n: [0.0; 2],
            depth_m: 0.0,
        }
    }

    fn modulus_pa(&self, depth_m: f64, plane: usize) -> f64 {
        let factor = self
            .tissue
            .layers
            .iter()
            .filter(|[from_m, _]| depth_m >= *from_m)
            .map(|[_, f]| f)
            .product::<f64>();
        let anisotropy = if plane == 1 { self.tissue.anisotropy } else { 1.0 };
        self.tissue.modulus_pa * factor * anisotropy * (1.0 + self.tissue.gradient_per_m * depth_m).max(0.05)
    }

    fn settle(
        &mut self,
        depth_m: f64,
        time_s: f64,
        guide_m: [f64; 2],
        load_n: [f64; 2],
        bevel_rad: f64,
        pushed: bool,
    ) {
        let push_m = depth_m - self.depth_m;
        let held_tip = match self.tip {
            Tip::Angle(angle_rad) if pushed && !self.springs.is_empty() => {
                let angle = [angle_rad * bevel_rad.cos(), angle_rad * bevel_rad.sin()];
                Some([0, 1].map(|i: usize| self.tip_m[i] + push_m * (self.slope[i] + angle[i])))
            }
            _ => None,
        };
        let load_n = match self.tip {
            Tip::Load => load_n,
            Tip::Angle(_) => self.held_n,
        };
        self.depth_m = depth_m;
        let mut nodes: Vec<f64> = (0..=12).map(|i| self.guide2_m * f64::from(i) / 12.0).collect();
        nodes.extend((1..=4).map(|i| self.guide2_m + self.gap_m * f64::from(i) / 4.0));
        let entry_m = self.guide2_m + self.gap_m;
        let count = (depth_m / ELEMENT_M - 0.2).ceil().max(0.0) as usize;
        nodes.extend((1..count).map(|i| entry_m + ELEMENT_M * i as f64));
        if depth_m > 0.05e-3 {
            nodes.push(entry_m + depth_m);
        }
        let mut bent = vec![[0.0; 2]; nodes.len()];
        let mut solved = [Vec::new(), Vec::new()];
        for pass in 0..3 {
            for plane in 0..2 {
                let mut frame = Banded::new(2 * nodes.len());
                for (i, ends) in nodes.windows(2).enumerate() {
                    frame.element(2 * i, ends[1] - ends[0], self.stiffness_n_m2, -self.axial_n);
                    if ends[0] >= entry_m - 1e-9 && self.tissue.shear_n > 0.0 {
                        frame.element(2 * i, ends[1] - ends[0], 0.0, self.tissue.shear_n);
                    }
                }
                let (turn, tip) = (bevel_rad, frame.right.len());
                if self.prebend_per_m != 0.0 {
                    let moment = self.stiffness_n_m2
                        * self.prebend_per_m
                        * if plane == 0 { turn.cos() } else { turn.sin() };
                    frame.right[tip - 1] += moment;
                    frame.right[1] -= moment;
                }
                for (i, spring) in self.springs.iter().enumerate() {
                    let spring_m = SPRING_M * i as f64;
                    if spring_m > depth_m + 1e-9 {
                        break;
                    }
                    let width_m = if i == 0 {
                        0.5 * SPRING_M
                    } else {
                        SPRING_M.min(depth_m - spring_m + 0.5 * SPRING_M)
                    };
                    let (stiff, spring_rest_m) = self.spring(i, width_m, plane, time_s, spring);
                    let element =
                        nodes.partition_point(|z| *z < entry_m + spring_m - 1e-9).clamp(1, nodes.len() - 1)
                            - 1;
                    let length_m = nodes[element + 1] - nodes[element];
                    let x = ((entry_m + spring_m - nodes[element]) / length_m).clamp(0.0, 1.0);
                    frame.spring(2 * element, x, length_m, stiff, spring_rest_m);
                }
                frame.right[tip - 2] += load_n[plane];
                let tip_n_per_m = 1e7;
                if let Some(tip_m) = held_tip {
                    frame.add(tip - 2, tip - 2, tip_n_per_m);
                    frame.right[tip - 2] += tip_n_per_m * tip_m[plane] - load_n[plane];
                }
                let guide_n_per_m = if self.frame_m_per_n > 0.0 { 1.0 / self.frame_m_per_n } else { 1e8 };
                frame.add(24, 24, guide_n_per_m);
                frame.right[24] += guide_n_per_m * guide_m[plane];
                frame.add(0, 0, 1e9);
                frame.add(
                    1,
                    1,
                    if self.clamp_rad_per_n_m > 0.0 { 1.0 / self.clamp_rad_per_n_m } else { 1e7 },
                );
                let u = frame.solve();
                (self.tip_m[plane], self.slope[plane]) = (u[tip - 2], u[tip - 1]);
                self.force_n[plane] = guide_n_per_m * (guide_m[plane] - u[24]);
                if let Some(tip_m) = held_tip {
                    self.held_n[plane] = tip_n_per_m * (tip_m[plane] - u[tip - 2]);
                }
                for (i, ends) in nodes.windows(2).enumerate() {
                    let l = ends[1] - ends[0];
                    let (a, b) = (u[2 * i], u[2 * i + 2]);
                    bent[i][plane] = -6.0 / (l * l) * (a - b) - (4.0 * u[2 * i + 1] + 2.0 * u[2 * i + 3]) / l;
                }
                solved[plane] = u;
            }
            // A tie that is loaded beyond its limit gives, and the needle is solved again.
            if !self.give(depth_m, &nodes, &solved, time_s) || pass == 2 {
                break;
            }
        }
        self.strain = bent.iter().map(|[x, y]| self.radius_m * x.hypot(*y)).fold(0.0, f64::max);
        self.relax(depth_m, &nodes, &solved, time_s);
    }

    /// Stiffness of a spring over this step, and the place where it would rest.
    fn spring(&self, i: usize, width_m: f64, plane: usize, time_s: f64, spring: &Spring) -> (f64, f64) {
        let spring_m = SPRING_M * i as f64;
        let mut stiff = width_m * self.modulus_pa(spring_m, plane);
        if i == 0 {
            stiff += self.tissue.skin_n_per_m;
        }
        let Tissue { relaxing, relaxation_s, .. } = self.tissue;
        if relaxing <= 0.0 {
            return (stiff, spring.rest_m[plane]);
        }
        // The part that flows, implicitly over the step.
        let persistence = relaxation_s / (relaxation_s + time_s);
        let effective = stiff * (1.0 - relaxing) + stiff * relaxing * persistence;
        let rest_m = spring.rest_m[plane] + stiff * relaxing * persistence * spring.flow_m[plane] / effective;
        (effective, rest_m)
    }

    fn stretch(&self, i: usize, nodes: &[f64], solved: &[Vec<f64>; 2]) -> [f64; 2] {
        let z_m = self.guide2_m + self.gap_m + SPRING_M * i as f64;
        let element = nodes.partition_point(|z| *z < z_m - 1e-9).clamp(1, nodes.len() - 1) - 1;
        let l = nodes[element + 1] - nodes[element];
        let x = ((z_m - nodes[element]) / l).clamp(0.0, 1.0);
        let n = shapes(x, l);
        [0, 1].map(|plane: usize| {
            let u: f64 = (0..4).map(|k| n[k] * solved[plane][2 * element + k]).sum();
            u - self.springs[i].rest_m[plane]
        })
    }

    /// Lets springs beyond their limit give; whether any did.
    fn give(&mut self, depth_m: f64, nodes: &[f64], solved: &[Vec<f64>; 2], time_s: f64) -> bool {
        let mut gave = false;
        if self.tissue.yield_n_per_m.is_infinite() {
            return false;
        }
        for i in 0..self.springs.len() {
            let spring_m = SPRING_M * i as f64;
            if spring_m > depth_m + 1e-9 {
                break;
            }
            let stretch = self.stretch(i, nodes, solved);
            let load = [0, 1].map(|plane: usize| {
                let (stiff, spring_rest_m) = self.spring(i, SPRING_M, plane, time_s, &self.springs[i]);
                stiff * (stretch[plane] - (spring_rest_m - self.springs[i].rest_m[plane]))
            });
            let most_n = SPRING_M * self.tissue.yield_n_per_m * (spring_m / self.tissue.yield_depth_m).exp()
                + if i == 0 { 1e6 * self.tissue.skin_n_per_m } else { 0.0 };
            let size = load[0].hypot(load[1]);
            if size > 1.02 * most_n {
                gave = true;
                for (plane, load_n) in load.into_iter().enumerate() {
                    let (stiff, _) = self.spring(i, SPRING_M, plane, time_s, &self.springs[i]);
                    self.springs[i].rest_m[plane] += load_n * (1.0 - most_n / size) / stiff;
                }
            }
        }
        gave
    }

    fn relax(&mut self, depth_m: f64, nodes: &[f64], solved: &[Vec<f64>; 2], time_s: f64) {
        if self.tissue.relaxing <= 0.0 {
            return;
        }
        let fraction = time_s / (self.tissue.relaxation_s + time_s);
        for i in 0..self.springs.len() {
            if SPRING_M * i as f64 > depth_m + 1e-9 {
                break;
            }
            let stretch = self.stretch(i, nodes, solved);
            for (flow_m, stretch_m) in self.springs[i].flow_m.iter_mut().zip(stretch) {
                *flow_m += fraction * (stretch_m - *flow_m);
            }
        }
    }
}

impl Body for Needle {
    fn advance(&mut self, depth_m: f64, time_s: f64, guide_m: [f64; 2], load_n: [f64; 2], bevel_rad: f64) {
        if depth_m <= self.depth_m + 1e-9 {
            self.settle(depth_m.min(self.depth_m), time_s, guide_m, load_n, bevel_rad, false);
            return;
        }
        let (start_m, push_m) = (self.depth_m, depth_m - self.depth_m);
        loop {
            let next_m = SPRING_M * self.springs.len() as f64;
            let step_end_m = next_m.min(depth_m);
            let fraction = (step_end_m - self.depth_m) / push_m;
            self.settle(step_end_m, fraction * time_s, guide_m, load_n, bevel_rad, true);
            if next_m <= depth_m {
                self.springs.push(Spring { rest_m: self.tip_m, flow_m: [0.0; 2] });
            }
            if step_end_m >= depth_m || self.depth_m - start_m >= push_m {
                break;
            }
        }
    }

    fn tip_m(&self) -> [f64; 2] {
        self.tip_m
    }

    fn force_n(&self) -> [f64; 2] {
        self.force_n
    }

    fn strain(&self) -> f64 {
        self.strain
    }
}

fn shapes(x: f64, l: f64) -> [f64; 4] {
    let y = 1.0 - x;
    [y * y * (1.0 + 2.0 * x), l * x * y * y, x * x * (3.0 - 2.0 * x), -l * x * x * y]
}

/// Symmetric, three bands beside the diagonal.
struct Banded {
    rows: Vec<[f64; 4]>,
    right: Vec<f64>,
}

impl Banded {
    fn new(count: usize) -> Self {
        Self { rows: vec![[0.0; 4]; count], right: vec![0.0; count] }
    }

    fn add(&mut self, i: usize, j: usize, value: f64) {
        if j <= i {
            self.rows[i][i - j] += value;
        }
    }

    fn element(&mut self, at: usize, l: f64, bending: f64, tension: f64) {
        let b = bending / (l * l * l);
        let t = tension / (30.0 * l);
        let rows = [
            [12.0 * b + 36.0 * t, (6.0 * b + 3.0 * t) * l, -12.0 * b - 36.0 * t, (6.0 * b + 3.0 * t) * l],
            [0.0, 4.0 * (b + t) * l * l, -(6.0 * b + 3.0 * t) * l, (2.0 * b - t) * l * l],
            [0.0, 0.0, 12.0 * b + 36.0 * t, -(6.0 * b + 3.0 * t) * l],
            [0.0, 0.0, 0.0, 4.0 * (b + t) * l * l],
        ];
        for (i, row) in rows.iter().enumerate() {
            for (j, value) in row.iter().enumerate().skip(i) {
                self.add(at + j, at + i, *value);
            }
        }
    }

    fn spring(&mut self, at: usize, x: f64, l: f64, stiff: f64, rest_m: f64) {
        let n = shapes(x, l);
        for i in 0..4 {
            for j in 0..=i {
                self.add(at + i, at + j, stiff * n[i] * n[j]);
            }
            self.right[at + i] += stiff * rest_m * n[i];
        }
    }

    fn solve(mut self) -> Vec<f64> {
        let count = self.right.len();
        for i in 0..count {
            for back in (1..=i.min(3)).rev() {
                let j = i - back;
                let mut value = self.rows[i][back];
                for more in back + 1..=i.min(3) {
                    let k = i - more;
                    if j - k <= 3 {
                        value -= self.rows[i][more] * self.rows[j][j - k] * self.rows[k][0];
                    }
                }
                self.rows[i][back] = value / self.rows[j][0];
            }
            for back in 1..=i.min(3) {
                self.rows[i][0] -= self.rows[i][back].powi(2) * self.rows[i - back][0];
            }
        }
        for i in 0..count {
            for back in 1..=i.min(3) {
                self.right[i] -= self.rows[i][back] * self.right[i - back];
            }
        }
        for i in 0..count {
            self.right[i] /= self.rows[i][0];
        }
        for i in (0..count).rev() {
            for ahead in 1..=3 {
                if i + ahead < count {
                    self.right[i] -= self.rows[i + ahead][ahead] * self.right[i + ahead];
                }
            }
        }
        self.right
    }
}
