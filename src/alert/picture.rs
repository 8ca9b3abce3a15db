//! A small curve of an alarm as PNG, which every mail program shows. It has no letters: the text next to it names
//! values.

use std::io::Write;

use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};
use jiff::Timestamp;

const WIDTH: usize = 480;
const HEIGHT: usize = 160;
/// Space for lines and points at the edges, in pixels.
const MARGIN: f64 = 8.0;
const CURVE: [u8; 3] = [0x00, 0x5a, 0x9e];
const LIMIT: [u8; 3] = [0xc0, 0x3a, 0x00];
const EXPECTED: [u8; 3] = [0x8a, 0x93, 0x9c];

/// Values over time, with a line at the expected value and at each limit, as a PNG file. `None` without two values.
pub(super) fn curve(series: &[(Timestamp, f64)], expected: Option<f64>, limits: &[f64]) -> Option<Vec<u8>> {
    let known: Vec<(f64, f64)> = series
        .iter()
        .filter(|(_, value)| value.is_finite())
        .map(|(at, value)| (at.as_second() as f64, *value))
        .collect();
    let [(first, _), .., (last, _)] = known[..] else { return None };
    let levels = || limits.iter().copied().chain(expected).filter(|level| level.is_finite());
    let values = || known.iter().map(|(_, value)| *value).chain(levels());
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let scaled = |share: f64, length: usize| MARGIN + share * (length as f64 - 2.0 * MARGIN);
    let share = |value: f64, from: f64, to: f64| if to > from { (value - from) / (to - from) } else { 0.5 };
    let x = |at: f64| scaled(share(at, first, last), WIDTH);
    let y = |value: f64| scaled(1.0 - share(value, low, high), HEIGHT);

    let mut canvas = Canvas { pixels: vec![[255; 3]; WIDTH * HEIGHT] };
    let across = |level: f64| [(0.0, y(level)), (WIDTH as f64, y(level))];
    expected.into_iter().for_each(|level| canvas.line(across(level), 0.5, EXPECTED));
    limits.iter().for_each(|level| canvas.line(across(*level), 1.0, LIMIT));
    let points: Vec<(f64, f64)> = known.iter().map(|(at, value)| (x(*at), y(*value))).collect();
    for pair in points.windows(2) {
        canvas.line([pair[0], pair[1]], 1.0, CURVE);
    }
    points.iter().for_each(|point| canvas.line([*point, *point], 3.0, CURVE));
    canvas.png().ok()
}

struct Canvas {
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// A line with round ends and soft edges, `radius` pixels to each side; with both ends alike, a dot.
    fn line(&mut self, [from, to]: [(f64, f64); 2], radius: f64, colour: [u8; 3]) {
        let reach = radius + 1.0;
        let range = |a: f64, b: f64, length: usize| {
            let (low, high) = (a.min(b) - reach, a.max(b) + reach);
            low.max(0.0) as usize..(high.max(0.0) as usize + 1).min(length)
        };
        let (along_x, along_y) = (to.0 - from.0, to.1 - from.1);
        let squared = along_x * along_x + along_y * along_y;
        for row in range(from.1, to.1, HEIGHT) {
            for column in range(from.0, to.0, WIDTH) {
                let (dx, dy) = (column as f64 + 0.5 - from.0, row as f64 + 0.5 - from.1);
                let share = match squared > 0.0 {
                    true => ((dx * along_x + dy * along_y) / squared).clamp(0.0, 1.0),
                    false => 0.0,
                };
                let distance = (dx - share * along_x).hypot(dy - share * along_y);
                let cover = (radius + 0.5 - distance).clamp(0.0, 1.0);
                let Some(pixel) = self.pixels.get_mut(row * WIDTH + column) else { continue };
                for (old, new) in pixel.iter_mut().zip(colour) {
                    *old = (f64::from(*old) + cover * (f64::from(new) - f64::from(*old))).round() as u8;
                }
            }
        }
    }

    /// The file: signature, header, compressed rows, end (PNG specification, third edition, sections 5 and 11).
    fn png(&self) -> std::io::Result<Vec<u8>> {
        let mut header = Vec::new();
        header.extend((WIDTH as u32).to_be_bytes());
        header.extend((HEIGHT as u32).to_be_bytes());
        // 8 bits, RGB, deflate, filters by row, not interlaced
        header.extend([8, 2, 0, 0, 0]);
        let mut rows = ZlibEncoder::new(Vec::new(), Compression::best());
        for row in self.pixels.chunks(WIDTH) {
            // no filter
            rows.write_all(&[0])?;
            rows.write_all(row.as_flattened())?;
        }
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        for (name, content) in [(b"IHDR", header), (b"IDAT", rows.finish()?), (b"IEND", Vec::new())] {
            let mut sum = Crc::new();
            sum.update(name);
            sum.update(&content);
            file.extend((content.len() as u32).to_be_bytes());
            file.extend(name);
            file.extend(content);
            file.extend(sum.sum().to_be_bytes());
        }
        Ok(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn day(number: i64) -> Timestamp {
        Timestamp::from_second(86_400 * number).unwrap()
    }

    #[test]
    fn a_curve_is_a_png_and_one_value_is_none() {
        let png = curve(&[(day(0), 1.0), (day(1), f64::NAN), (day(2), 1.2)], Some(1.0), &[1.05]).unwrap();
        assert!(png.starts_with(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x01\xe0\0\0\0\xa0"));
        assert!(png.len() < 20_000, "{} bytes", png.len());
        assert_eq!(curve(&[(day(0), 1.0)], None, &[]), None);
        // all values alike: a line in the middle
        assert!(curve(&[(day(0), 1.0), (day(0), 1.0)], None, &[]).is_some());
    }

    #[test]
    fn a_line_covers_its_pixels_only() {
        let mut canvas = Canvas { pixels: vec![[255; 3]; WIDTH * HEIGHT] };
        canvas.line([(10.0, 80.5), (20.0, 80.5)], 0.5, [0; 3]);
        assert_eq!(canvas.pixels[80 * WIDTH + 15], [0; 3]);
        assert_eq!(canvas.pixels[83 * WIDTH + 15], [255; 3]);
        // beyond the edge nothing is drawn and nothing fails
        canvas.line([(-50.0, -50.0), (WIDTH as f64 + 50.0, HEIGHT as f64 + 50.0)], 1.0, [0; 3]);
    }
}
