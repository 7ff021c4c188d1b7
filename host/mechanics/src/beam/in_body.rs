//! The needle in an elastic body as a [`Beam`]: the solution of [`Ritz`] as power series.

use super::{Beam, BeamProblem, GUIDE2, LOADS, ModelError, Span, TIP};
use crate::body::{Load, Ritz, powers};
use crate::{Foundation, Support};

impl BeamProblem {
    /// Solves for unit forces at guide 2 and at the tip of a needle in an elastic body.
    pub(super) fn solve_in_body(&self) -> Result<Beam, ModelError> {
        self.check()?;
        let Some(ritz) = Ritz::joining_short_gap(self)? else {
            // No body holds the needle: the beam alone, with its skin where it has any.
            let bare = Self { support: Support::Springs, foundation: Foundation::none(), ..self.clone() };
            return bare.solve();
        };
        let solved = ritz.factor()?;
        let shapes = [Load::Guide2, Load::Tip].map(|load| ritz.shape(&solved, load));
        let [body_m, depth_m] = ritz.body_m();
        let pieces = ritz.pieces(&shapes[GUIDE2]);
        let mut spans: Vec<Span> = pieces
            .map(|(start_m, length_m, ..)| Span { start_m, per_m: 1.0 / length_m, ..Span::default() })
            .collect();
        spans.push(Span { start_m: body_m, per_m: 1.0 / depth_m, ..Span::default() });
        let mut stored = [0.0; LOADS];
        for (load, shape) in shapes.iter().enumerate() {
            for (span, (.., equation, start)) in spans.iter_mut().zip(ritz.pieces(shape)) {
                equation.expand(start, &mut span.series[load]);
            }
            let coefficients = ritz.coefficients(shape);
            if let Some(span) = spans.last_mut() {
                let terms = span.series[load].as_flattened_mut();
                terms.iter_mut().zip(powers(&coefficients)).for_each(|(term, power)| *term = power);
            }
            let forces = ritz.tissue_forces(&coefficients);
            stored[load] = forces.iter().zip(&coefficients).map(|(f, c)| f * c).sum();
        }
        let beam = Beam {
            bending_stiffness_n_m2: self.bending_stiffness_n_m2,
            length_m: self.entry_m + self.depth_m,
            guide2_m_per_n: ritz.work(Load::Guide2, &shapes[GUIDE2]),
            body_m_per_n: stored[GUIDE2],
            spans,
        };
        debug_assert_eq!([GUIDE2, TIP], [0, 1]);
        beam.checked()
    }
}
