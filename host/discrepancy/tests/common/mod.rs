//! Tools of several tests: the folder with measurements of others, a reader of their files, and parts of simulated worlds.
#![allow(dead_code, reason = "each test uses a part")]

use discrepancy::{Channel, Column, ForwardModel, FunctionModel, Parameter, Regressor, Run, Site, Terms};
use flate2::read::ZlibDecoder;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::PathBuf;

/// Environment variable with the folder of measurements of others. These are not part of the project: their terms differ.
pub const FOLDER: &str = "NEEDLE_GUIDE_MEASURED";

/// A file of that folder; nothing, with a printed line, where the folder is not stated or has no such file.
pub fn measured(file: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os(FOLDER) else {
        println!("skipped: {FOLDER} states no folder of measurements");
        return None;
    };
    let path = PathBuf::from(folder).join(file);
    if path.is_file() {
        return Some(path);
    }
    println!("skipped: {} does not exist", path.display());
    None
}

fn word(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("four bytes"))
}

/// Elements of a MAT-file of level 5: type and content, one after the other.
fn elements(mut bytes: &[u8]) -> Vec<(u32, &[u8])> {
    let mut elements = Vec::new();
    while bytes.len() >= 8 {
        let kind = word(bytes, 0);
        if kind >> 16 != 0 {
            let length = (kind >> 16) as usize;
            elements.push((kind & 0xffff, &bytes[4..4 + length]));
            bytes = &bytes[8..];
            continue;
        }
        let length = word(bytes, 4) as usize;
        elements.push((kind, &bytes[8..8 + length]));
        // Compressed elements are not padded.
        let padded = if kind == 15 { length } else { length.div_ceil(8) * 8 };
        bytes = bytes.get(8 + padded..).unwrap_or(&[]);
    }
    elements
}

/// Arrays of doubles and bytes of a compressed MAT-file of level 5, little-endian.
pub fn arrays(path: &PathBuf) -> BTreeMap<String, Vec<f64>> {
    let bytes = std::fs::read(path).expect("a readable file");
    let mut arrays = BTreeMap::new();
    for (kind, content) in elements(&bytes[128..]) {
        assert_eq!(kind, 15, "an array that is not compressed");
        let mut matrix = Vec::new();
        ZlibDecoder::new(content).read_to_end(&mut matrix).expect("compressed content");
        let fields = elements(&matrix[8..]);
        let name = String::from_utf8(fields[2].1.to_vec()).expect("a name");
        let values = match fields[3] {
            (9, bytes) => {
                bytes.chunks(8).map(|b| f64::from_le_bytes(b.try_into().expect("eight bytes"))).collect()
            }
            (2, bytes) => bytes.iter().map(|byte| f64::from(*byte)).collect(),
            (kind, _) => panic!("{name} has values of type {kind}"),
        };
        arrays.insert(name, values);
    }
    arrays
}

/// Central differences, at every sample with two neighbours.
pub fn derivative(values: &[f64], step_s: f64) -> Vec<f64> {
    values.windows(3).map(|part| (part[2] - part[0]) / (2.0 * step_s)).collect()
}

/// A site whose laws are added to a channel, or which the model evaluates where there is none.
pub fn site(name: &str, unit: &str, adds_to: Option<&str>, regressors: Vec<Regressor>) -> Site {
    Site {
        name: name.to_owned(),
        unit: unit.to_owned(),
        adds_to: adds_to.map(str::to_owned),
        regressors,
        forms: Vec::new(),
    }
}

/// Force of a mass on a rail by its acceleration and speed: mass and viscous friction, with a site for other friction.
pub fn mass_and_viscous_friction(mass: Parameter, viscous: Parameter) -> impl ForwardModel {
    let regressors = vec![regressor("speed", "m/s"), regressor("position", "m")];
    let friction = site("friction", "N", Some("force"), regressors);
    FunctionModel::new(vec![mass, viscous], vec![friction], |run: &Run, parameters: &[f64], _: &Terms<'_>| {
        let pairs = run.needed("acceleration")?.iter().zip(run.needed("speed")?);
        Ok(vec![pairs.map(|(a, v)| parameters[0] * a + parameters[1] * v).collect()])
    })
}

/// States at every instant, each by the midpoint method from the one before: so many steps of this length for every input. No quantity falls below the least.
pub fn integrated<const N: usize>(
    inputs: &[f64],
    start: [f64; N],
    (steps, step, least): (usize, f64, f64),
    rates: impl Fn([f64; N], f64) -> [f64; N],
) -> Vec<[f64; N]> {
    let mut state = start;
    let mut states = Vec::with_capacity(inputs.len());
    for input in inputs {
        states.push(state);
        for _ in 0..steps {
            let first = rates(state, *input);
            let middle = rates(std::array::from_fn(|i| state[i] + 0.5 * step * first[i]), *input);
            state = std::array::from_fn(|i| (state[i] + step * middle[i]).max(least));
        }
    }
    states
}

/// A channel without standard deviations.
pub fn channel(name: &str, unit: &str, values: Vec<f64>) -> Channel {
    Channel { name: name.to_owned(), unit: unit.to_owned(), values, sds: None }
}

/// Name of a run that is fitted or judges.
pub fn name_of(judges: bool) -> String {
    if judges { "judge".to_owned() } else { "train".to_owned() }
}

/// A known column.
pub fn column(name: &str, unit: &str, values: Vec<f64>) -> Column {
    Column { name: name.to_owned(), unit: unit.to_owned(), values }
}

/// A regressor; a position is one that is followed.
pub fn regressor(name: &str, unit: &str) -> Regressor {
    Regressor {
        name: name.to_owned(),
        unit: unit.to_owned(),
        range: None,
        resolution: 0.0,
        history: name == "position",
    }
}

/// A parameter above zero.
pub fn parameter(name: &str, unit: &str, mean: f64, sd: f64) -> Parameter {
    let range = Some([0.0, mean + 50.0 * sd]);
    Parameter { name: name.to_owned(), unit: unit.to_owned(), mean, sd, range }
}

/// Noise with a memory: white, and a random process whose neighbours have a correlation.
pub fn coloured(rng: &mut ChaCha8Rng, count: usize, white: f64, slow: f64, correlation: f64) -> Vec<f64> {
    let mut process = slow * normal(rng);
    (0..count)
        .map(|_| {
            process = correlation * process + slow * (1.0 - correlation * correlation).sqrt() * normal(rng);
            process + white * normal(rng)
        })
        .collect()
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
