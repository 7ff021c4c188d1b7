//! Ids of what can differ from the plain model, with sizes to test.

/// Every id with weak, middle and strong values. The number of values is that of the effect's parameters.
const STRENGTHS: [(&str, [&[f64]; 3]); 29] = [
    ("tissue.layers", [&[1.5, 18.0], &[2.2, 15.0], &[3.5, 12.0]]),
    ("tissue.gradient", [&[0.01], &[0.03], &[0.06]]),
    ("tissue.stiffening", [&[0.4], &[0.7], &[1.0]]),
    ("tissue.relaxation", [&[0.1, 2.0], &[0.2, 2.0], &[0.35, 1.5]]),
    ("tissue.shear", [&[1.0], &[3.0], &[8.0]]),
    ("tissue.entry_gap", [&[2.0], &[4.0], &[7.0]]),
    ("tissue.skin", [&[0.1], &[0.25], &[0.6]]),
    ("tissue.anisotropy", [&[1.1], &[1.25], &[1.5]]),
    ("rig.clamp_compliance", [&[0.1], &[0.3], &[0.8]]),
    ("rig.frame_compliance", [&[0.02], &[0.05], &[0.12]]),
    ("rig.backlash", [&[0.03], &[0.06], &[0.12]]),
    ("rig.play", [&[0.03], &[0.06], &[0.12]]),
    ("rig.friction", [&[0.02], &[0.05], &[0.1]]),
    ("sensor.force_bias", [&[0.03, -0.02], &[0.08, -0.05], &[0.2, 0.1]]),
    ("sensor.force_gain", [&[0.03], &[0.08], &[0.2]]),
    ("sensor.force_drift", [&[0.001, -0.0005], &[0.002, 0.001], &[0.005, -0.003]]),
    ("sensor.crosstalk", [&[0.02], &[0.05], &[0.1]]),
    ("sensor.delay", [&[0.05], &[0.12], &[0.3]]),
    ("sensor.shape_offset", [&[0.02, -0.01], &[0.05, 0.03], &[0.12, -0.08]]),
    ("sensor.shape_scale", [&[0.02], &[0.05], &[0.1]]),
    ("sensor.depth_shift", [&[0.5], &[1.0], &[2.0]]),
    ("needle.stiffness", [&[0.03], &[0.08], &[0.2]]),
    ("needle.prebend", [&[0.03, 0.02], &[0.1, -0.05], &[0.25, 0.1]]),
    ("needle.axial_load", [&[0.5], &[1.5], &[4.0]]),
    ("tip.load_slope", [&[0.0005], &[0.0015], &[0.004]]),
    ("tip.load_step", [&[0.04, 40.0], &[0.1, 40.0], &[0.2, 40.0]]),
    ("tip.entry_angle", [&[0.002, 0.001], &[0.006, -0.004], &[0.02, 0.01]]),
    ("tip.bevel_roll", [&[0.05], &[0.15], &[0.4]]),
    ("tip.rate", [&[0.002], &[0.008], &[0.02]]),
];

/// The same of what only a session of images can have.
const IMAGING: [(&str, [&[f64]; 3]); 3] = [
    ("imaging.sound_speed", [&[0.03], &[0.06], &[0.12]]),
    ("imaging.lag", [&[0.05], &[0.12], &[0.3]]),
    ("imaging.echo_offset", [&[0.03], &[0.08], &[0.2]]),
];

/// Weak, middle and strong values of an effect, as a careful laboratory might overlook.
pub fn strengths(id: &str) -> Option<[Vec<f64>; 3]> {
    let (_, values) = STRENGTHS.iter().chain(&IMAGING).find(|(name, _)| *name == id)?;
    Some(values.map(<[f64]>::to_vec))
}

/// Every id that only a session of images can have ([`super::ImagePlan`]).
pub fn imaging_ids() -> impl Iterator<Item = &'static str> {
    IMAGING.iter().map(|(id, _)| *id)
}

/// Every id that any session can have.
pub fn ids() -> impl Iterator<Item = &'static str> {
    STRENGTHS.iter().map(|(id, _)| *id)
}
