//! Pictures whose file states that they are to be turned before they are looked at (orientation of TIFF and EXIF).

use super::stack::{Image, Samples};

/// Tag of the orientation in a directory of TIFF, as which EXIF is kept.
const ORIENTATION: u16 = 0x0112;

impl Image {
    /// As it is looked at: 1 is as stored, 2 to 4 mirrored or upside down, 5 to 8 with rows and columns exchanged; others are as stored, as
    /// EXIF reserves them.
    pub(super) fn turned(self, orientation: u16) -> Self {
        if !(2..=8).contains(&orientation) {
            return self;
        }
        let Self { size: [width, height], channels, samples } = self;
        let is_exchanged = orientation >= 5;
        let size = if is_exchanged { [height, width] } else { [width, height] };
        // Whether the row and the column of a stored pixel count from its other end.
        let (from_bottom, from_right) =
            (matches!(orientation, 3 | 4 | 6 | 7), matches!(orientation, 2 | 3 | 7 | 8));
        let stored = |x: usize, y: usize| {
            let (column, row) = if is_exchanged { (y, x) } else { (x, y) };
            let column = if from_right { width - 1 - column } else { column };
            let row = if from_bottom { height - 1 - row } else { row };
            row * width + column
        };
        let sources: Vec<usize> =
            (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))).map(|(x, y)| stored(x, y)).collect();
        let samples = match samples {
            Samples::Eight(samples) => Samples::Eight(taken(&samples, &sources, channels)),
            Samples::Sixteen(samples) => Samples::Sixteen(taken(&samples, &sources, channels)),
        };
        Self { size, channels, samples }
    }
}

/// The pixels at these places.
fn taken<T: Copy>(samples: &[T], places: &[usize], channels: usize) -> Vec<T> {
    let pixels = places.iter().filter_map(|place| samples.get(place * channels..(place + 1) * channels));
    pixels.flatten().copied().collect()
}

/// The orientation that EXIF data state; 1 where they state none.
pub(super) fn orientation(exif: &[u8]) -> u16 {
    stated(exif).unwrap_or(1)
}

fn stated(exif: &[u8]) -> Option<u16> {
    let is_big = match exif.get(..4)? {
        b"II*\0" => false,
        b"MM\0*" => true,
        _ => return None,
    };
    let offset: [u8; 4] = exif.get(4..8)?.try_into().ok()?;
    let offset = if is_big { u32::from_be_bytes(offset) } else { u32::from_le_bytes(offset) } as usize;
    let count = usize::from(u16_at(offset, is_big, exif)?);
    (0..count)
        .map(|entry| offset.saturating_add(2 + 12 * entry))
        .find(|at| u16_at(*at, is_big, exif) == Some(ORIENTATION))
        .and_then(|at| u16_at(at + 8, is_big, exif))
}

fn u16_at(at: usize, is_big: bool, exif: &[u8]) -> Option<u16> {
    let bytes: [u8; 2] = exif.get(at..at.checked_add(2)?)?.try_into().ok()?;
    Some(if is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(size: [usize; 2], samples: &[u8]) -> Image {
        Image { size, channels: 1, samples: Samples::Eight(samples.to_vec()) }
    }

    #[test]
    fn an_f_is_upright_from_every_orientation() {
        // The letter F, 3 wide and 4 high, and how it is stored for each orientation.
        let upright = [1, 1, 1, 1, 0, 0, 1, 1, 0, 1, 0, 0];
        for (orientation, size, stored) in [
            (1, [3, 4], [1, 1, 1, 1, 0, 0, 1, 1, 0, 1, 0, 0]),
            (2, [3, 4], [1, 1, 1, 0, 0, 1, 0, 1, 1, 0, 0, 1]),
            (3, [3, 4], [0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 1, 1]),
            (4, [3, 4], [1, 0, 0, 1, 1, 0, 1, 0, 0, 1, 1, 1]),
            (5, [4, 3], [1, 1, 1, 1, 1, 0, 1, 0, 1, 0, 0, 0]),
            (6, [4, 3], [1, 0, 0, 0, 1, 0, 1, 0, 1, 1, 1, 1]),
            (7, [4, 3], [0, 0, 0, 1, 0, 1, 0, 1, 1, 1, 1, 1]),
            (8, [4, 3], [1, 1, 1, 1, 0, 1, 0, 1, 0, 0, 0, 1]),
        ] {
            let Image { size, samples, .. } = image(size, &stored).turned(orientation);
            assert_eq!(size, [3, 4], "{orientation}");
            assert!(matches!(samples, Samples::Eight(pixels) if pixels == upright), "{orientation}");
        }
        // The channels of a pixel stay together.
        let colours = Image { size: [2, 1], channels: 3, samples: Samples::Sixteen(vec![1, 2, 3, 4, 5, 6]) };
        assert!(
            matches!(colours.turned(3).samples, Samples::Sixteen(pixels) if pixels == [4, 5, 6, 1, 2, 3])
        );
    }

    #[test]
    fn the_orientation_is_read_in_either_order_of_bytes() {
        let little = [&b"II*\0\x08\0\0\0\x01\0"[..], b"\x12\x01\x03\0\x01\0\0\0\x06\0\0\0"].concat();
        let big = [&b"MM\0*\0\0\0\x08\0\x01"[..], b"\x01\x12\0\x03\0\0\0\x01\0\x08\0\0"].concat();
        assert_eq!([&little, &big].map(|exif| orientation(exif)), [6, 8]);
        for exif in [&b""[..], b"II*\0\xff\xff\xff\xff", &little[..12], b"text that is none"] {
            assert_eq!(orientation(exif), 1);
        }
    }
}
