//! Shape of the needle: modes on a grid of tissue cells.

use nalgebra::RealField;

/// A mode of the needle: `phi(x) = A cos l x + B sin l x + R e^(l (x - L)) + D e^(-l x)`, scaled to unit modal mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode<T> {
    /// Wave number `l`, 1/m.
    pub wave_number_per_m: T,
    /// Natural frequency, rad/s: its square is the mode's stiffness.
    pub frequency_rad_s: T,
    /// `A`, `B`, `R` and `D`.
    pub factors: [T; 4],
}

impl<T: RealField + Copy> Mode<T> {
    /// The four functions at `x`.
    fn functions(&self, x_m: T, length_m: T) -> [T; 4] {
        let l = self.wave_number_per_m;
        let (sin, cos) = (l * x_m).sin_cos();
        [cos, sin, (l * (x_m - length_m)).exp(), (-l * x_m).exp()]
    }

    fn sum(&self, functions: &[T; 4]) -> T {
        let [a, b, r, d] = self.factors;
        a * functions[0] + b * functions[1] + r * functions[2] + d * functions[3]
    }
}

/// The modes as deflections from the base: `psi_i(x) = phi_i(x) - phi_i(0)`.
#[derive(Debug, Clone, Copy)]
pub struct Shape<T, const M: usize> {
    modes: [Mode<T>; M],
    length_m: T,
    at_base: [T; M],
    /// `psi` at the tip.
    pub tip: [T; M],
    /// Stiffness of each mode.
    pub stiffness: [T; M],
    /// Effect of one cell towards the tip on the four functions of each mode.
    turns: [[T; 4]; M],
}

impl<T: RealField + Copy, const M: usize> Shape<T, M> {
    /// For cells of this length.
    pub fn new(modes: [Mode<T>; M], length_m: T, cell_m: T) -> Self {
        let at_base = modes.map(|mode| mode.sum(&mode.functions(T::zero(), length_m)));
        let mut tip = modes.map(|mode| mode.sum(&mode.functions(length_m, length_m)));
        tip.iter_mut().zip(at_base).for_each(|(tip, base)| *tip -= base);
        let turns = modes.map(|mode| {
            let l = mode.wave_number_per_m;
            let (sin, cos) = (l * cell_m).sin_cos();
            [cos, sin, (l * cell_m).exp(), (-l * cell_m).exp()]
        });
        let stiffness = modes.map(|mode| mode.frequency_rad_s * mode.frequency_rad_s);
        Self { modes, length_m, at_base, tip, stiffness, turns }
    }

    /// `psi` at one point of the needle.
    pub fn at(&self, x_m: T) -> [T; M] {
        let mut values = self.at_base;
        for (value, mode) in values.iter_mut().zip(&self.modes) {
            *value = mode.sum(&mode.functions(x_m, self.length_m)) - *value;
        }
        values
    }

    /// `psi` at points one cell apart, from `x` towards the tip: sines and exponentials once, then multiplications only.
    pub fn mode_values(&self, x_m: T) -> ModeValues<'_, T, M> {
        ModeValues { shape: self, functions: self.modes.map(|mode| mode.functions(x_m, self.length_m)) }
    }
}

/// See [`Shape::mode_values`].
#[derive(Debug)]
pub struct ModeValues<'s, T, const M: usize> {
    shape: &'s Shape<T, M>,
    functions: [[T; 4]; M],
}

impl<T: RealField + Copy, const M: usize> Iterator for ModeValues<'_, T, M> {
    type Item = [T; M];

    fn next(&mut self) -> Option<[T; M]> {
        let mut values = self.shape.at_base;
        for (i, value) in values.iter_mut().enumerate() {
            let functions = &mut self.functions[i];
            *value = self.shape.modes[i].sum(functions) - *value;
            let [cos, sin, rise, fall] = self.shape.turns[i];
            let (c, s) = (functions[0], functions[1]);
            *functions = [cos * c - sin * s, cos * s + sin * c, rise * functions[2], fall * functions[3]];
        }
        Some(values)
    }
}
