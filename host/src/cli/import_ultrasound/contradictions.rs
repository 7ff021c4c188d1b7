//! Statements of a file that options of the user contradict: the options count, and both are said.

use imaging::frame::{Header, Orientation};
use imaging::places::Disagreement;
use imaging::pose::Place;
use imaging::sweep::{FrameResult, Geometry, Settings, State};
use std::path::Path;

/// Remarks on a sequence whose file states something else than the options.
pub fn notes(
    path: &Path,
    header: &Header,
    settings: &Settings,
    frames: &[FrameResult],
    geometry: &Geometry,
) -> Vec<String> {
    let file = path.display();
    let mut notes = Vec::new();
    if let Some((option_value, stated)) = settings.spacing_mm.zip(header.spacing_mm)
        && differ(option_value, stated, [header.width, header.height])
    {
        notes.push(format!(
            "{file}: the file states pixels of {} x {} mm, and {} x {} mm of the options are taken",
            stated[0], stated[1], option_value[0], option_value[1]
        ));
    }
    if let Some((option_value, stated)) =
        settings.orientation.zip(header.orientation).filter(|(option_value, stated)| option_value != stated)
    {
        notes.push(format!(
            "{file}: the file states axes {}, and {} of --orientation are taken",
            letters(stated),
            letters(option_value)
        ));
    }
    let used_frames: Vec<(usize, f64)> = frames
        .iter()
        .enumerate()
        .filter(|(_, frame)| frame.state == State::Used)
        .filter_map(|(at, frame)| Some((at, frame.place_mm?[2])))
        .collect();
    let [x_mm, y_mm] = geometry.spacing_mm;
    let disagreement = header
        .places
        .as_ref()
        .and_then(|places| Some((places, places.disagreement(&used_frames, x_mm.max(y_mm))?)));
    if let Some((of_file, Disagreement { stated_mm, used_mm, largest_mm })) = disagreement {
        notes.push(format!(
            "{file}: {} states positions of the frames that are {:.2} mm from the first to the last used one, and {} puts them {:.2} mm \
             apart, up to {largest_mm:.2} mm elsewhere: the option is taken",
            of_file.field,
            stated_mm.abs(),
            option(&settings.place),
            used_mm.abs()
        ));
    }
    notes
}

/// The option that gives the places.
fn option(place: &Place) -> &'static str {
    match place {
        Place::Step { .. } => "--step-mm",
        Place::Speed { .. } => "--speed-mm-per-s",
        Place::Field { .. } => "--z-field",
        Place::Transform { .. } => "--transform",
    }
}

/// Whether two sizes of a pixel put the last pixel at places that are more than one apart.
fn differ(a: [f64; 2], b: [f64; 2], size_px: [usize; 2]) -> bool {
    a.iter().zip(b).zip(size_px).any(|((a, b), count)| (a - b).abs() * count as f64 > a.min(b))
}

fn letters(orientation: Orientation) -> String {
    let Orientation { flip_x, flip_y } = orientation;
    format!("{}{}", if flip_x { 'U' } else { 'M' }, if flip_y { 'N' } else { 'F' })
}
