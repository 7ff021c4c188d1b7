//! K/E over the size of a block of tissue, for a needle at a depth.

use crate::answer::AnswerError;
use crate::drawing::Figure;
use crate::results::json;
use formats::session::{Setup, template};
use inference::walls::Cubes;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Depths that can be chosen: some cube has room for each.
const DEPTHS_MM: [f64; 2] = [10.0, 150.0];

/// Needle, depth and block.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlocksRequest {
    /// Folder of the session whose needle is used; an 18 gauge needle without one.
    #[serde(default)]
    pub dir: Option<PathBuf>,
    /// Insertion depth.
    pub depth_mm: f64,
    /// Poisson's ratio of the tissue.
    pub poisson: f64,
}

/// K/E in cubes with held and with free sides.
pub fn blocks(request: &BlocksRequest) -> Result<String, AnswerError> {
    let [least_mm, most_mm] = DEPTHS_MM;
    if !(least_mm..=most_mm).contains(&request.depth_mm) {
        let (value, expected) = (request.depth_mm.to_string(), format!("{least_mm} to {most_mm}"));
        return Err(AnswerError::Value { name: "depth_mm", value, expected });
    }
    let setup = match &request.dir {
        Some(dir) => Setup::read(&dir.join("session.toml"))?,
        None => Setup::parse(Path::new("standard rig"), template::SESSION)?,
    };
    let cubes = Cubes::new(&setup.rig.needle, 1e-3 * request.depth_mm, request.poisson)?;
    let title = "K/E over the size of a cube of tissue, with held and with free sides".to_owned();
    let drawn = vec![Figure::new("blocks".to_owned(), title, figures::cubes(&cubes)?)];
    json(cubes, drawn)
}
