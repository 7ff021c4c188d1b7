//! A contact sheet: small pictures of the frames of a sequence with what was found in them, in one picture.

use crate::overlay::Picture;

/// Most pictures of a sheet.
pub const MAX_PICTURES: usize = 60;
/// Pictures of a row.
const COLUMNS: usize = 10;
/// Most pixels of a picture in both directions.
const MOST: [usize; 2] = [120, 110];
/// Pixels between pictures, and below them where their text goes.
const GAP: usize = 6;
const TEXT: usize = 26;
/// Borders of frames that are used, and of others.
const USED: [u8; 3] = [0, 150, 40];
const REJECTED: [u8; 3] = [220, 30, 30];

/// Chooses which frames of a sequence a sheet shows: of each state as many as its share, at least one where there is room, evenly spread.
///
/// `states` has a number for the state of every frame. The result is in order.
pub fn choose(states: &[usize]) -> Vec<usize> {
    if states.len() <= MAX_PICTURES {
        return (0..states.len()).collect();
    }
    let mut kinds: Vec<usize> = states.to_vec();
    kinds.sort_unstable();
    kinds.dedup();
    let mut chosen: Vec<usize> = Vec::new();
    for kind in kinds.iter().take(MAX_PICTURES) {
        let of_kind: Vec<usize> =
            states.iter().enumerate().filter(|(_, state)| *state == kind).map(|(number, _)| number).collect();
        let spare = MAX_PICTURES - kinds.len().min(MAX_PICTURES);
        let count = (1 + spare * of_kind.len() / states.len()).min(of_kind.len());
        chosen.extend((0..count).filter_map(|i| of_kind.get((2 * i + 1) * of_kind.len() / (2 * count))));
    }
    chosen.sort_unstable();
    chosen
}

/// One frame of a sheet.
struct Entry {
    picture: Picture,
    is_used: bool,
    /// Two lines below the picture.
    lines: [String; 2],
}

/// A sheet that is being put together.
#[derive(Default)]
pub struct Sheet {
    entries: Vec<Entry>,
}

impl Sheet {
    /// Adds a frame's picture, made smaller, with two lines of text.
    pub fn add(&mut self, picture: &Picture, is_used: bool, lines: [String; 2]) {
        self.entries.push(Entry { picture: picture.reduced(MOST), is_used, lines });
    }

    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Size of a cell.
    fn cell(&self) -> [usize; 2] {
        // Room for the text below narrow pictures.
        [self.largest_size(0).max(90) + GAP, self.largest_size(1) + GAP + TEXT]
    }

    fn largest_size(&self, axis: usize) -> usize {
        let sizes = self.entries.iter().filter_map(|entry| entry.picture.size().get(axis).copied());
        sizes.max().unwrap_or(1)
    }

    fn place(&self, number: usize) -> [usize; 2] {
        let [width, height] = self.cell();
        [GAP + number % COLUMNS * width, GAP + number / COLUMNS * height]
    }

    fn size(&self) -> [usize; 2] {
        let [width, height] = self.cell();
        let (columns, rows) =
            (self.entries.len().clamp(1, COLUMNS), self.entries.len().div_ceil(COLUMNS).max(1));
        [2 * GAP + columns * width, 2 * GAP + rows * height]
    }

    /// The pictures without their text, with a green border where a frame is used and a red one where it is rejected.
    pub fn picture(&self) -> Picture {
        let [width, height] = self.size();
        let mut sheet = Picture::plain(width, height, [255; 3]);
        for (number, entry) in self.entries.iter().enumerate() {
            let cell = self.place(number);
            sheet.put(&entry.picture, cell);
            sheet.frame(cell, entry.picture.size(), if entry.is_used { USED } else { REJECTED });
        }
        sheet
    }

    /// The sheet with its text as SVG: the pictures are in it.
    ///
    /// # Errors
    /// What the encoder of PNG reports.
    pub fn svg(&self, title: &str) -> Result<String, png::EncodingError> {
        let [width, height] = self.size();
        let png = self.picture().png()?;
        let mut svg = format!(
            "<svg width=\"{width}\" height=\"{0}\" viewBox=\"0 0 {width} {0}\" xmlns=\"http://www.w3.org/2000/svg\">\n\
             <rect width=\"{width}\" height=\"{0}\" fill=\"white\"/>\n\
             <text x=\"{GAP}\" y=\"20\" font-family=\"sans-serif\" font-size=\"16\">{1}</text>\n\
             <image x=\"0\" y=\"30\" width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{2}\"/>\n",
            height + 30,
            escaped(title),
            base64(&png)
        );
        for (number, entry) in self.entries.iter().enumerate() {
            let [x, y] = self.place(number);
            let text_y = 30 + y + entry.picture.size()[1];
            let fill = if entry.is_used { "#009628" } else { "#dc1e1e" };
            for (line, dy) in entry.lines.iter().zip([12, 23]) {
                svg.push_str(&format!(
                    "<text x=\"{x}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"10\" fill=\"{fill}\">{}</text>\n",
                    text_y + dy,
                    escaped(line)
                ));
            }
        }
        svg.push_str("</svg>\n");
        Ok(svg)
    }
}

/// Text for SVG.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Bytes as a data address has them (RFC 4648).
pub fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = byte_at(0, group) << 16 | byte_at(1, group) << 8 | byte_at(2, group);
        for (place, shift) in [18, 12, 6, 0].into_iter().enumerate() {
            let letter = LETTERS.get((bits >> shift & 63) as usize).copied().unwrap_or(b'=');
            text.push(if place <= group.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

fn byte_at(i: usize, group: &[u8]) -> u32 {
    u32::from(group.get(i).copied().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;

    #[test]
    fn bytes_are_written_as_the_standard_has_them() {
        let pairs = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in pairs {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn every_state_is_on_the_sheet_however_rare_it_is() {
        let mut states = vec![0; 5000];
        states[4000] = 3;
        states[17] = 1;
        let chosen = choose(&states);
        assert!(chosen.len() <= MAX_PICTURES && chosen.len() >= MAX_PICTURES - 3, "{}", chosen.len());
        assert!(chosen.contains(&4000) && chosen.contains(&17));
        assert!(chosen.is_sorted());
        assert_eq!(choose(&[0, 0, 1]), [0, 1, 2]);
        assert_eq!(choose(&[]), Vec::<usize>::new());
    }

    #[test]
    fn a_sheet_shows_its_frames_and_their_text() {
        let frame = Frame { width: 300, height: 100, pixels: vec![90; 30_000] };
        let mut sheet = Sheet::default();
        for number in 0..12 {
            let picture = Picture::of_sweep(&frame, crate::sweep::State::NoEcho, None);
            sheet.add(&picture, number % 2 == 0, [format!("{number}"), "a < b".to_owned()]);
        }
        let svg = sheet.svg("a & b").expect("a sheet");
        assert!(svg.contains("a &amp; b") && svg.matches("a &lt; b").count() == 12);
        let [width, height] = sheet.picture().size();
        assert!(width > 900 && height > 2 * 33, "{width} x {height}");
        assert!(Sheet::default().svg("none").is_ok());
    }
}
