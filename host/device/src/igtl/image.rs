//! IMAGE messages: a frame of a scanner with the size of its pixels and its place.

/// Bytes before the pixels.
const HEADER_BYTES: usize = 72;
/// Most bytes of the pixels of a frame: 2048 x 2048 of 16 bit, or as many in colour.
pub const MAX_PIXEL_BYTES: usize = 1 << 24;
/// Largest body that is kept where images are received.
pub(super) const MAX_BODY_BYTES: usize = HEADER_BYTES + MAX_PIXEL_BYTES + 4_096;

/// Kind of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sample {
    /// 8 bit.
    Byte,
    /// 16 bit without sign.
    Unsigned,
    /// 16 bit with a sign.
    Signed,
}

impl Sample {
    fn bytes(self) -> usize {
        if self == Self::Byte { 1 } else { 2 }
    }
}

/// Format of the pixels of a frame: the same in all frames of a sequence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Pixels of a row, and rows.
    pub size_px: [usize; 2],
    /// Samples of a pixel: 1, or 3 for colour.
    pub channels: usize,
    /// Type of each sample.
    pub sample: Sample,
    /// Whether the first byte of a sample of 16 bit is the more significant one.
    pub is_big_endian: bool,
}

/// A frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// Format of the pixels.
    pub layout: Layout,
    /// Size of a pixel along rows and columns, millimetres.
    pub spacing_mm: [f64; 2],
    /// From the image in millimetres, from its first pixel, to the sender's coordinates: the upper three rows, row by row.
    pub pose: [f64; 12],
    /// The pixels as they were sent.
    pub pixels: Vec<u8>,
}

/// Fields of a body, one after the other.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, tail) = self.0.split_first_chunk::<N>()?;
        self.0 = tail;
        Some(*field)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn sizes(&mut self) -> Option<[usize; 3]> {
        let mut size = || self.take().map(|bytes| usize::from(u16::from_be_bytes(bytes)));
        Some([size()?, size()?, size()?])
    }

    fn vector(&mut self) -> Option<[f64; 3]> {
        let mut number = || self.take().map(|bytes| f64::from(f32::from_be_bytes(bytes)));
        Some([number()?, number()?, number()?])
    }
}

/// Vector product.
fn across(x: [f64; 3], y: [f64; 3]) -> [f64; 3] {
    [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]
}

impl Image {
    /// Reads a body.
    ///
    /// # Errors
    /// What is wrong with it, and what is expected.
    pub(super) fn read(body: &[u8]) -> Result<Self, &'static str> {
        const SHORT: &str = "a body shorter than its header of 72 bytes";
        let mut fields = Fields(body);
        let _version = fields.take::<2>().ok_or(SHORT)?;
        let mut byte = || fields.byte().ok_or(SHORT);
        let (channels, sample, endian, coordinates) = (byte()?, byte()?, byte()?, byte()?);
        let size = fields.sizes().ok_or(SHORT)?;
        let mut vector = || fields.vector().ok_or(SHORT);
        let (along_row, along_column, _normal, middle) = (vector()?, vector()?, vector()?, vector()?);
        let (first_sizes, part_sizes) = (fields.sizes().ok_or(SHORT)?, fields.sizes().ok_or(SHORT)?);
        let sample = match sample {
            2 | 3 => Sample::Byte,
            4 => Sample::Signed,
            5 => Sample::Unsigned,
            _ => return Err("samples that are not of 8 or 16 bit, expected those"),
        };
        if !matches!(channels, 1 | 3) {
            return Err("neither 1 nor 3 samples for each pixel, expected grey or colour");
        }
        let [columns, rows, planes] = size;
        if planes != 1 || part_sizes != size || first_sizes != [0; 3] {
            return Err("a volume or a part of an image, expected whole images of one plane");
        }
        let layout = Layout {
            size_px: [columns, rows],
            channels: usize::from(channels),
            sample,
            is_big_endian: endian == 1,
        };
        let bytes = columns * rows * layout.channels * sample.bytes();
        if bytes == 0 || bytes > MAX_PIXEL_BYTES {
            return Err("an image without pixels or of more than 16 million bytes");
        }
        if fields.0.len() != bytes {
            return Err("another number of bytes than its size needs");
        }
        fn length(vector: [f64; 3]) -> f64 {
            vector.iter().map(|part_sizes| part_sizes * part_sizes).sum::<f64>().sqrt()
        }
        let spacing_mm = [length(along_row), length(along_column)];
        let is_finite =
            spacing_mm.iter().all(|mm| mm.is_finite() && *mm > 0.0) && middle.iter().all(|mm| mm.is_finite());
        if !is_finite {
            return Err("axes without a length or a place that is no number, expected millimetres");
        }
        // Coordinates to the left and to posterior, where they are not to the right and to anterior.
        let signs = if coordinates == 2 { [-1.0, -1.0, 1.0] } else { [1.0; 3] };
        let (x, y) = (
            along_row.map(|part_sizes| part_sizes / spacing_mm[0]),
            along_column.map(|part_sizes| part_sizes / spacing_mm[1]),
        );
        let normal = across(x, y);
        let mut pose = [0.0; 12];
        for (row, sign) in signs.into_iter().enumerate() {
            // The message has the position of the middle.
            let half_mm = [columns, rows].map(|pixels| 0.5 * (pixels as f64 - 1.0));
            let first_mm = middle[row] - along_row[row] * half_mm[0] - along_column[row] * half_mm[1];
            pose[4 * row..4 * row + 4].copy_from_slice(
                &[x[row], y[row], normal[row], first_mm].map(|part_sizes| sign * part_sizes),
            );
        }
        Ok(Self { layout, spacing_mm, pose, pixels: fields.0.to_vec() })
    }

    /// The body's bytes; in coordinates to the right, anterior and superior.
    pub(super) fn write(&self) -> Vec<u8> {
        let Layout { size_px: [columns, rows], channels, sample, is_big_endian } = self.layout;
        let sample = match sample {
            Sample::Byte => 3,
            Sample::Signed => 4,
            Sample::Unsigned => 5,
        };
        let mut body = vec![0, 1, channels as u8, sample, if is_big_endian { 1 } else { 2 }, 1];
        let size: Vec<u8> =
            [columns, rows, 1].iter().flat_map(|pixels| (*pixels as u16).to_be_bytes()).collect();
        body.extend(&size);
        let column = |number: usize| [0, 4, 8].map(|row: usize| self.pose[row + number]);
        let (x, y, first_mm) = (column(0), column(1), column(3));
        let half_mm =
            [0, 1].map(|axis: usize| 0.5 * ([columns, rows][axis] as f64 - 1.0) * self.spacing_mm[axis]);
        let normal = across(x, y);
        let middle = [0, 1, 2].map(|row: usize| first_mm[row] + x[row] * half_mm[0] + y[row] * half_mm[1]);
        let vectors = [
            x.map(|part| part * self.spacing_mm[0]),
            y.map(|part| part * self.spacing_mm[1]),
            normal,
            middle,
        ];
        body.extend(vectors.into_iter().flatten().flat_map(|part| (part as f32).to_be_bytes()));
        body.extend([0; 6]);
        body.extend(&size);
        body.extend(&self.pixels);
        body
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> Image {
        let layout = Layout { size_px: [4, 3], channels: 1, sample: Sample::Byte, is_big_endian: false };
        let pose = [1.0, 0.0, 0.0, -2.0, 0.0, -1.0, 0.0, 5.0, 0.0, 0.0, -1.0, 70.0];
        Image { layout, spacing_mm: [0.5, 0.25], pose, pixels: (0..12).collect() }
    }

    #[test]
    fn an_image_is_read_as_it_was_written() {
        let read = Image::read(&image().write()).expect("reads");
        assert_eq!((read.layout, &read.pixels), (image().layout, &image().pixels));
        for (read, written) in
            read.pose.iter().chain(&read.spacing_mm).zip(image().pose.iter().chain(&[0.5, 0.25]))
        {
            assert!((read - written).abs() < 1e-5, "{read} {written}");
        }
    }

    #[test]
    fn impossible_images_are_refused_with_what_is_expected() {
        let whole = image().write();
        fn with(at: usize, byte: u8, whole: &[u8]) -> &'static str {
            let mut body = whole.to_vec();
            body[at] = byte;
            Image::read(&body).expect_err("refused")
        }
        assert!(with(2, 2, &whole).contains("neither 1 nor 3"));
        assert!(with(3, 10, &whole).contains("8 or 16 bit"));
        assert!(with(7, 9, &whole).contains("part of an image"));
        assert!(with(11, 2, &whole).contains("one plane"));
        assert!(Image::read(&whole[..60]).expect_err("refused").contains("shorter"));
        assert!(Image::read(&whole[..80]).expect_err("refused").contains("bytes than its size"));
        let mut flat = whole.clone();
        flat[12..24].fill(0);
        assert!(Image::read(&flat).expect_err("refused").contains("without a length"));
    }
}
