//! Effects of the sensors.

use super::{Effect, EffectInfo, MM, ObservationContext, ParameterInfo, RunKinds, first, series_at};
use crate::terms::Conditions;
use crate::{Channels, Series, ShapePoint};

/// Changes every value of a series by its plane (0: vertical) and index.
fn each(series: &mut Series, change: impl Fn(usize, usize, &mut f64)) {
    series.y.iter_mut().enumerate().for_each(|(i, value)| change(0, i, value));
    series.x.iter_mut().flatten().enumerate().for_each(|(i, value)| change(1, i, value));
}

/// Value of a plane.
fn of_plane(values: &[f64], plane: usize) -> f64 {
    values.get(plane).copied().unwrap_or_default()
}

/// `sensor.force_bias`.
#[derive(Debug)]
pub(super) struct ForceBias;

impl Effect for ForceBias {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.force_bias",
                physics: "the force sensor has a constant offset in each plane",
                signature: "force at zero displacement",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("bias_n", 0.0, [-50.0, 50.0], [-0.5, 0.5], 0.05),
                    ParameterInfo::amplitude("bias_x_n", 0.0, [-50.0, 50.0], [-0.5, 0.5], 0.05),
                ],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        each(&mut channels.force_n, |plane, _, force_n| *force_n += of_plane(values, plane));
    }
}

/// `sensor.force_gain`.
#[derive(Debug)]
pub(super) struct ForceGain;

impl Effect for ForceGain {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.force_gain",
                physics: "the force sensor reads too much by a constant factor: (1 + gain) F",
                signature: "scale of the force; the shape is unaffected",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("gain", 0.0, [-0.95, 20.0], [-0.5, 0.5], 0.05)],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        let factor = 1.0 + first(values);
        each(&mut channels.force_n, |_, _, force_n| *force_n *= factor);
    }
}

/// `sensor.force_drift`.
#[derive(Debug)]
pub(super) struct ForceDrift;

impl Effect for ForceDrift {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.force_drift",
                physics: "the force reading drifts with time, in each plane",
                signature: "force against time, in holds too",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("rate_n_per_s", 0.0, [-10.0, 10.0], [-0.02, 0.02], 0.001),
                    ParameterInfo::amplitude("rate_x_n_per_s", 0.0, [-10.0, 10.0], [-0.02, 0.02], 0.001),
                ],
            }
        }
    }

    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let start_s = first(context.time_s);
        let elapsed_s = |i: usize| context.time_s.get(i).map_or(0.0, |time_s| time_s - start_s);
        each(&mut channels.force_n, |plane, i, force_n| *force_n += of_plane(values, plane) * elapsed_s(i));
    }
}

/// `sensor.crosstalk`.
#[derive(Debug)]
pub(super) struct Crosstalk;

impl Effect for Crosstalk {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.crosstalk",
                physics: "each axis of the force sensor reads a fraction of the other",
                signature: "the idle axis while the other moves",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("ratio", 0.0, [-0.95, 0.95], [-0.3, 0.3], 0.03)],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        let ratio = first(values);
        let Series { y, x: Some(x) } = &mut channels.force_n else { return };
        for (y, x) in y.iter_mut().zip(x) {
            (*y, *x) = (*y + ratio * *x, *x + ratio * *y);
        }
    }
}

/// `sensor.delay`.
#[derive(Debug)]
pub(super) struct Delay;

impl Effect for Delay {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.delay",
                physics: "the force reading lags behind the displacement",
                signature: "ramps, with their sign; holds are unaffected",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("delay_s", 0.0, [0.0, 10.0], [0.0, 1.0], 0.05)],
            }
        }
    }

    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let delay_s = first(values);
        if delay_s <= 0.0 {
            return;
        }
        let planes = [Some(&mut channels.force_n.y), channels.force_n.x.as_mut()];
        for force_n in planes.into_iter().flatten() {
            let read_n =
                context.time_s.iter().map(|time_s| series_at(context.time_s, force_n, time_s - delay_s));
            *force_n = read_n.collect();
        }
    }
}

/// `sensor.shape_offset`.
#[derive(Debug)]
pub(super) struct ShapeOffset;

impl Effect for ShapeOffset {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.shape_offset",
                physics: "the measured shape is displaced by a constant, in each plane",
                signature: "shape, at zero displacement too",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[
                    ParameterInfo::amplitude("offset_mm", 0.0, [-20.0, 20.0], [-0.5, 0.5], 0.5),
                    ParameterInfo::amplitude("offset_x_mm", 0.0, [-20.0, 20.0], [-0.5, 0.5], 0.5),
                ],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        each(&mut channels.shape_m, |plane, _, u_m| *u_m += of_plane(values, plane) * MM);
    }
}

/// `sensor.shape_scale`.
#[derive(Debug)]
pub(super) struct ShapeScale;

impl Effect for ShapeScale {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.shape_scale",
                physics: "measured deflections are too large by a constant factor, (1 + scale) u: pixel size, speed of sound",
                signature: "shape against the displacement of guide 2",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("scale", 0.0, [-0.95, 20.0], [-0.3, 0.3], 0.05)],
            }
        }
    }

    fn observe(&self, values: &[f64], _context: &ObservationContext<'_>, channels: &mut Channels) {
        let factor = 1.0 + first(values);
        each(&mut channels.shape_m, |_, _, u_m| *u_m *= factor);
    }
}

/// `sensor.depth_shift`.
#[derive(Debug)]
pub(super) struct DepthShift;

impl Effect for DepthShift {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "sensor.depth_shift",
                physics: "the shape is measured further along the needle than stated, by a constant",
                signature: "the slope of the shape times the shift",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("shift_mm", 0.0, [-20.0, 20.0], [-5.0, 5.0], 0.5)],
            }
        }
    }

    fn map_position(&self, values: &[f64], _entry_m: f64, _conditions: &Conditions, point: &mut ShapePoint) {
        point.z_m += first(values) * MM;
    }
}
