//! The needle's rotation in guide 1 as a spring between a rigid clamp and a hinge: what is uncertain by it is bounded.

/// Share `x/(1 + x)` of the rotation at guide 1 that its clamp yields, for a clamp of `x` times the compliance of the needle there. A spring in a linear
/// structure takes part in everything by this share, between none (rigid) and all (a hinge): a logarithm of its compliance that is known to a factor of
/// ten changes a moment by no more than these two do, while its slope at the likeliest value, carried on, would.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ClampShare(f64);

impl ClampShare {
    /// By the moment at guide 1, which is `1 - x/(1 + x)` of that of a rigid clamp, and its growth per unknown of the clamp, of which one is so
    /// much of the compliance's logarithm; nothing where the moment does not fall with it.
    pub fn new(moment: [f64; 2], per_unknown: [f64; 2], sd_ln: f64) -> Option<Self> {
        let square = moment[0] * moment[0] + moment[1] * moment[1];
        let share = -(moment[0] * per_unknown[0] + moment[1] * per_unknown[1]) / (square * sd_ln);
        (share > 0.0 && share < 1.0).then_some(Self(share))
    }

    /// Change of what this share changes, over that by its slope, where the logarithm of the compliance is greater (or less) by so much.
    pub fn saturation(self, greater: bool, by_ln: f64) -> f64 {
        let (ratio, slope) = (self.0 / (1.0 - self.0), self.0 * (1.0 - self.0) * by_ln);
        let changed = ratio * if greater { by_ln.exp() } else { (-by_ln).exp() };
        let change = (changed / (1.0 + changed) - self.0).abs();
        if slope > 0.0 { change / slope } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(x: f64) -> f64 {
        2.0 / (1.0 + x)
    }

    #[test]
    fn a_clamp_between_rigid_and_hinge_takes_part_by_its_share() {
        // A moment 2/(1 + x) with x = 0.25, by a spring whose logarithm has a prior of standard deviation 2.
        let (x, sd_ln, step) = (0.25_f64, 2.0, 1e-6);
        let per_unknown = (moment(x * f64::exp(sd_ln * step)) - moment(x)) / step;
        let clamp = ClampShare::new(
            [0.6 * moment(x), 0.8 * moment(x)],
            [0.6 * per_unknown, 0.8 * per_unknown],
            sd_ln,
        );
        let Some(clamp) = clamp else { panic!("the moment falls with the compliance") };
        assert!((clamp.0 - 0.2).abs() < 1e-5, "{clamp:?}");
        for (by_ln, greater, end) in
            [(3.4, false, (-3.4_f64).exp()), (3.4, true, 3.4_f64.exp()), (1e-4, true, 1e-4_f64.exp())]
        {
            let change = (moment(x * end) - moment(x)).abs();
            let by_slope = (per_unknown / sd_ln * by_ln).abs();
            assert!((clamp.saturation(greater, by_ln) - change / by_slope).abs() < 1e-4, "{by_ln} {greater}");
        }
        // A moment that grows with the compliance is no such spring's.
        assert_eq!(ClampShare::new([1.0, 0.0], [0.1, 0.0], sd_ln), None);
    }
}
