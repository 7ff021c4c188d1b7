//! Continuity and boundary conditions of the pieces, solved by two sweeps (theory, eq. 4).
//!
//! The part beyond a section acts on it as a spring with a load: with `m = u''` and `q = u''' + (P - G)/EI u'`, `m = b
//! u + c u' + m_0` and `q = s u - b u' + q_0`; three numbers, as springs are symmetric. At the tip all but `q_0` are 0.
//! From the tip to guide 1 every piece makes a spring and a load at its start of those at its end; from guide 1 back to
//! the tip every piece hands on deflection and slope. Neither way magnifies rounding, as no growing solution is
//! followed: long needles in stiff tissue are no harder than others. The spring is finite unless what lies beyond the
//! section, clamped there, buckles; that does not happen before the whole needle buckles.
//!
//! Within a piece lengths are in units of the piece's: state `[u, h u', h^2 m, h^3 q]`. `[G0, G1, G2, G3]` being value and derivatives at
//! the end of the fundamental solution, the state at the start is that at the end times
//!
//! ```text
//! G3 + a G1      -G2            G1      -G0
//! t G0            G3           -G2       G1
//! -t G1           t G0 + a G2   G3      -G2
//! t (G2 + a G0)  -t G1          t G0     G3 + a G1
//! ```

use crate::series::Equation;

/// Number of loads that are solved for at once: at guide 2 and at the tip.
pub(super) const LOADS: usize = 2;
/// A number per load.
pub(super) type PerLoad = [f64; LOADS];

/// Spring and load of the part beyond a section.
#[derive(Clone, Copy, Default)]
pub(super) struct Beyond {
    /// b, c and s.
    spring: [f64; 3],
    /// `m_0` and `q_0`.
    moment: PerLoad,
    shear: PerLoad,
}

impl Beyond {
    /// Adds a spring, in units of EI, and the unit force of a load, `1/EI`, at the section.
    pub fn add(&mut self, spring: f64, load: usize, force: f64) {
        self.spring[2] += spring;
        self.shear[load] -= force;
    }

    /// Adds a spring against rotation, in units of EI, at the section.
    pub fn resist_turning(&mut self, spring: f64) {
        self.spring[1] -= spring;
    }

    /// In other units of length: h where it was 1.
    fn scaled(self, h: f64) -> Self {
        let square = h * h;
        let cube = square * h;
        let [b, c, s] = self.spring;
        Self {
            spring: [b * square, c * h, s * cube],
            moment: self.moment.map(|m| m * square),
            shear: self.shear.map(|q| q * cube),
        }
    }

    /// Slope of a needle that is held here by a bearing that turns by `compliance` per m.
    pub fn slope(&self, compliance: f64) -> PerLoad {
        let rotation_compliance = compliance / (1.0 - compliance * self.spring[1]);
        self.moment.map(|m| rotation_compliance * m)
    }

    /// Deflection and slope of a needle that begins here, free to move, in a bearing that turns by `compliance` per m: `q = 0` and
    /// `u' = compliance m`. Not finite where nothing holds it.
    pub fn free(&self, compliance: f64) -> (PerLoad, PerLoad) {
        let [b, c, s] = self.spring;
        let rotation_compliance = compliance / (1.0 - compliance * c);
        let deflection: PerLoad = std::array::from_fn(|load| {
            (b * rotation_compliance * self.moment[load] - self.shear[load])
                / (s - b * b * rotation_compliance)
        });
        let slope =
            std::array::from_fn(|load| rotation_compliance * (b * deflection[load] + self.moment[load]));
        (deflection, slope)
    }
}

/// Transfer of deflection and slope over a piece; in units of its length.
#[derive(Clone, Copy, Default)]
pub(super) struct Link {
    /// Spring and load at its start.
    start: Beyond,
    /// Deflection and slope at the end by those at the start, without load.
    onward: [[f64; 2]; 2],
    /// Effect of the load at the end on deflection and slope at the start if those at the end are 0.
    loaded: [PerLoad; 2],
}

impl Link {
    /// Transfer of a piece, and the spring and load at its start, given those at its end; `None` if the equations have
    /// no unique solution.
    pub fn new(
        equation: Equation,
        fundamental: [f64; 4],
        length: f64,
        end: Beyond,
    ) -> Option<(Self, Beyond)> {
        let Equation { modulus: t, axial: a, .. } = equation;
        let [g0, g1, g2, g3] = fundamental;
        let Beyond { spring: [b, c, s], moment, shear } = end.scaled(length);
        let whole = g3 + a * g1;
        // Deflection and slope at the start, then moment and shear, by deflection and slope at the end.
        let [u_u, u_v] = [whole + g1 * b - g0 * s, g1 * c + g0 * b - g2];
        let [v_u, v_v] = [t * g0 - g2 * b + g1 * s, g3 - g2 * c - g1 * b];
        let [m_u, m_v] = [g3 * b - t * g1 - g2 * s, t * g0 + a * g2 + g3 * c + g2 * b];
        let [q_u, q_v] = [t * (g2 + a * g0) + t * g0 * b + whole * s, t * g0 * c - t * g1 - whole * b];
        let determinant = u_u * v_v - u_v * v_u;
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let inverse = 1.0 / determinant;
        let onward = [[v_v * inverse, -u_v * inverse], [-v_u * inverse, u_u * inverse]];
        let [[to_u, to_u_by_v], [to_v, to_v_by_v]] = onward;
        let start = Beyond {
            spring: [m_u * to_u + m_v * to_v, m_u * to_u_by_v + m_v * to_v_by_v, q_u * to_u + q_v * to_v],
            // Work is reciprocal: forces go back as displacements go onward.
            moment: std::array::from_fn(|i| to_v_by_v * moment[i] - to_u_by_v * shear[i]),
            shear: std::array::from_fn(|i| to_u * shear[i] - to_v * moment[i]),
        };
        let loaded = [
            std::array::from_fn(|i| g1 * moment[i] - g0 * shear[i]),
            std::array::from_fn(|i| g1 * shear[i] - g2 * moment[i]),
        ];
        Some((Self { start, onward, loaded }, start.scaled(1.0 / length)))
    }

    /// Value and three derivatives at the start by `x`, per load, and deflection and slope at the end, from those at the start.
    pub fn hand_on(&self, equation: Equation, [u, v]: [PerLoad; 2]) -> ([[f64; 4]; LOADS], [PerLoad; 2]) {
        let Self { start: Beyond { spring: [b, c, s], moment, shear }, onward, loaded } = self;
        let states = std::array::from_fn(|i| {
            let third = s * u[i] - b * v[i] + shear[i] - equation.axial * v[i];
            [u[i], v[i], b * u[i] + c * v[i] + moment[i], third]
        });
        let [[to_u, to_u_by_v], [to_v, to_v_by_v]] = onward;
        let free_u: PerLoad = std::array::from_fn(|i| u[i] - loaded[0][i]);
        let free_v: PerLoad = std::array::from_fn(|i| v[i] - loaded[1][i]);
        let end_u = std::array::from_fn(|i| to_u * free_u[i] + to_u_by_v * free_v[i]);
        let end_v = std::array::from_fn(|i| to_v * free_u[i] + to_v_by_v * free_v[i]);
        (states, [end_u, end_v])
    }
}
