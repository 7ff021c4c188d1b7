//! Effects of the imaging of the shape (theory, eq. 82): they act along the beam, or along the way of the probe.

use super::{Effect, EffectInfo, MM, ObservationContext, ParameterInfo, RunKinds, first};
use crate::terms::Conditions;
use crate::{Channels, ShapeImage, ShapePoint};

/// Changes the deflection of every point whose image is known, vertical and horizontal.
fn each(
    context: &ObservationContext<'_>,
    channels: &mut Channels,
    change: impl Fn(&ShapeImage, [f64; 2]) -> [f64; 2],
) {
    let shape_m = &mut channels.shape_m;
    for (i, image) in context.images.iter().enumerate() {
        let (Some(image), Some(y_m)) = (image, shape_m.y.get_mut(i)) else { continue };
        let mut x_m = shape_m.x.as_mut().and_then(|x_m| x_m.get_mut(i));
        let [new_y_m, new_x_m] = change(image, [*y_m, x_m.as_deref().copied().unwrap_or_default()]);
        *y_m = new_y_m;
        if let Some(x_m) = &mut x_m {
            **x_m = new_x_m;
        }
    }
}

/// `imaging.sound_speed`.
#[derive(Debug)]
pub(super) struct SoundSpeed;

impl Effect for SoundSpeed {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "imaging.sound_speed",
                physics: "sound is slower in the tissue than the scanner assumes: distances along the beam are too large, by (1 + scale)",
                signature: "deflection along the beam against the displacement of guide 2; across the beam nothing",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("scale", 0.0, [-0.5, 2.0], [-0.2, 0.2], 0.05)],
            }
        }
    }

    fn needs_images(&self) -> bool {
        true
    }

    /// Deflections are from a straight needle that the same scanner sees, so that its distance from the probe has no part in them.
    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let scale = first(values);
        each(context, channels, |image, [y_m, x_m]| {
            let [along_y, along_x] = image.along();
            let more_m = scale * (along_y * y_m + along_x * x_m);
            [y_m + more_m * along_y, x_m + more_m * along_x]
        });
    }
}

/// `imaging.lag`.
#[derive(Debug)]
pub(super) struct Lag;

impl Effect for Lag {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "imaging.lag",
                physics: "frames are later than their time stamps: the shape is measured further along the needle, by lag times speed of the probe",
                signature: "the slope of the shape times the speed of the probe, against its direction",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("lag_s", 0.0, [-5.0, 5.0], [-0.5, 0.5], 0.05)],
            }
        }
    }

    fn needs_images(&self) -> bool {
        true
    }

    fn map_position(&self, values: &[f64], _entry_m: f64, _conditions: &Conditions, point: &mut ShapePoint) {
        let speed_m_per_s = point.image.map_or(0.0, |image| image.probe_m_per_s);
        point.z_m += first(values) * speed_m_per_s;
    }
}

/// `imaging.echo_offset`.
#[derive(Debug)]
pub(super) struct EchoOffset;

impl Effect for EchoOffset {
    fn info(&self) -> &'static EffectInfo {
        const {
            &EffectInfo {
                id: "imaging.echo_offset",
                physics: "the echo has a constant offset from the needle's axis along the beam: it comes from the near wall, or the gain was changed after the sweep of the straight needle",
                signature: "shape along the beam, at zero displacement too",
                observable_in: RunKinds::LATERAL,
                is_costly: false,
                parameters: &[ParameterInfo::amplitude("offset_mm", 0.0, [-20.0, 20.0], [-1.0, 1.0], 0.2)],
            }
        }
    }

    fn needs_images(&self) -> bool {
        true
    }

    fn observe(&self, values: &[f64], context: &ObservationContext<'_>, channels: &mut Channels) {
        let offset_m = first(values) * MM;
        each(context, channels, |image, [y_m, x_m]| {
            let [along_y, along_x] = image.along();
            [y_m + offset_m * along_y, x_m + offset_m * along_x]
        });
    }
}
