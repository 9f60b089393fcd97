//! Environment images from Radiance files (`.hdr`). The file is untrusted (I5): its header is bounded, and its size is checked and
//! reserved before anything is decoded.
//!
//! G. Ward, "Real Pixels", Graphics Gems II, 1991; the header as in Radiance's `man picture`. The format is so small that it is decoded
//! here: the decoders of `image` 0.25.10 and `zune-hdr` 0.5.2 overflow on series of empty runs, and read header lines of any length.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::EnvironmentImage;
use crate::budget::MemoryBudget;
use crate::error::RenderError;
use crate::units::Bytes;

/// Longest header, 64 KiB.
const HEADER_BYTES_MAX: u64 = 64 << 10;

/// Narrower and wider pictures have no runs by channel.
const WIDTHS_BY_CHANNEL: std::ops::Range<u32> = 8..0x8000;

pub(super) fn read(path: &Path, budget: &MemoryBudget) -> Result<EnvironmentImage, RenderError> {
    let failed = |reason: String| RenderError::Read { path: path.to_path_buf(), reason };
    let file = File::open(path).map_err(|error| failed(error.to_string()))?;
    let mut file = BufReader::new(file);
    let header = Header::read(&mut file).map_err(failed)?;
    let [width, height] = header.size;
    let reservation =
        budget.reserve(EnvironmentImage::bytes_needed(width, height)?, "the environment image")?;
    let _line = budget.reserve(Bytes(4 * u64::from(width)), "a row of the environment image")?;
    let mut line = vec![[0; 4]; width as usize];
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    for row in 0..height {
        read_line(&mut file, &mut line).map_err(|reason| failed(format!("row {row}: {reason}")))?;
        pixels.extend(line.iter().map(|pixel| header.radiance(*pixel)));
    }
    EnvironmentImage::with_reservation(width, height, pixels, reservation)
}

/// What stands before the pixels.
#[derive(Debug)]
struct Header {
    /// Width and height.
    size: [u32; 2],
    /// What each channel was multiplied by when the picture was written.
    scale: [f64; 3],
}

impl Header {
    fn read(file: &mut impl BufRead) -> Result<Header, String> {
        let mut file = file.take(HEADER_BYTES_MAX);
        let mut line = Vec::new();
        let mut next = |line: &mut Vec<u8>| {
            line.clear();
            file.read_until(b'\n', line).map_err(|error| error.to_string())?;
            match line.pop() {
                Some(b'\n') => Ok(String::from_utf8_lossy(line).into_owned()),
                _ => Err("the header does not end; the file is damaged or no Radiance picture".to_string()),
            }
        };
        if !next(&mut line)?.starts_with("#?") {
            return Err("it does not begin with `#?` as Radiance pictures do".to_string());
        }
        let mut scale = [1.0f64; 3];
        loop {
            let text = next(&mut line)?;
            let text = text.trim();
            if text.is_empty() {
                break;
            }
            if let Some(format) = text.strip_prefix("FORMAT=")
                && format.trim() != "32-bit_rle_rgbe"
            {
                return Err(format!("its format is {format:?}; only 32-bit_rle_rgbe is read"));
            }
            for (key, count) in [("EXPOSURE=", 1), ("COLORCORR=", 3)] {
                let Some(numbers) = text.strip_prefix(key) else { continue };
                let factors: Vec<f64> =
                    numbers.split_whitespace().filter_map(|part| part.parse().ok()).collect();
                let are_sensible = factors.iter().all(|factor| *factor > 0.0 && factor.is_finite());
                if factors.len() != count || !are_sensible {
                    return Err(format!("`{text}` is not {count} positive numbers"));
                }
                for (channel, scale) in scale.iter_mut().enumerate() {
                    *scale *= factors[channel % count];
                }
            }
        }
        let text = next(&mut line)?;
        let words: Vec<&str> = text.split_whitespace().collect();
        let size = match words[..] {
            ["-Y", height, "+X", width] => width.parse().ok().zip(height.parse().ok()),
            _ => {
                return Err(format!(
                    "`{text}`: only pictures that run right and down (-Y .. +X ..) are read"
                ));
            }
        };
        let (width, height) = size.ok_or_else(|| format!("`{text}` is not a size"))?;
        Ok(Header { size: [width, height], scale })
    }

    /// Mantissas of 8 bits with one exponent; as most readers have it, without half a step, so that 0 is black.
    fn radiance(&self, [red, green, blue, exponent]: [u8; 4]) -> [f32; 3] {
        // 2^(exponent - 128 - 8), a normal number of f64.
        let unit = f64::from_bits((1023 - 136 + u64::from(exponent)) << 52);
        let mut channels = [0.0; 3];
        for (channel, mantissa) in [red, green, blue].into_iter().enumerate() {
            if exponent > 0 {
                channels[channel] = (f64::from(mantissa) * unit / self.scale[channel]) as f32;
            }
        }
        channels
    }
}

/// Reads one row of pixels in any of the three ways in which rows are stored.
fn read_line(file: &mut impl Read, line: &mut [[u8; 4]]) -> Result<(), String> {
    let mut first = [0; 4];
    take(file, &mut first)?;
    let is_by_channel = WIDTHS_BY_CHANNEL.contains(&(line.len() as u32));
    if is_by_channel && first[0] == 2 && first[1] == 2 && first[2] < 128 {
        if usize::from(first[2]) << 8 | usize::from(first[3]) != line.len() {
            return Err("its length is not the picture's width".to_string());
        }
        return (0..4).try_for_each(|channel| read_channel(file, line, channel));
    }
    // Pixel by pixel; (1, 1, 1, n) repeats the last one n times, and several in a row are digits of one number.
    let (mut at, mut shift, mut pixel) = (0, 0, first);
    loop {
        if pixel[..3] == [1, 1, 1] && at > 0 {
            let count = usize::from(pixel[3]).checked_shl(shift).unwrap_or(usize::MAX);
            // A digit beyond the width of any picture is one too many, zero or not.
            if count > line.len() - at || shift > 24 {
                return Err("a run goes beyond its end".to_string());
            }
            let last = line[at - 1];
            line[at..at + count].fill(last);
            (at, shift) = (at + count, shift + 8);
        } else {
            line[at] = pixel;
            (at, shift) = (at + 1, 0);
        }
        if at == line.len() {
            return Ok(());
        }
        take(file, &mut pixel)?;
    }
}

/// Reads one channel of a row: runs of one value, and of different ones.
fn read_channel(file: &mut impl Read, line: &mut [[u8; 4]], channel: usize) -> Result<(), String> {
    let mut values = [0; 128];
    let mut at = 0;
    while at < line.len() {
        let mut length = [0];
        take(file, &mut length)?;
        let count = usize::from(if length[0] > 128 { length[0] & 127 } else { length[0] });
        if count == 0 || count > line.len() - at {
            return Err("a run is empty or goes beyond its end".to_string());
        }
        if length[0] > 128 {
            take(file, &mut values[..1])?;
            let value = values[0];
            values[..count].fill(value);
        } else {
            take(file, &mut values[..count])?;
        }
        for (pixel, value) in line[at..at + count].iter_mut().zip(values) {
            pixel[channel] = value;
        }
        at += count;
    }
    Ok(())
}

fn take(file: &mut impl Read, into: &mut [u8]) -> Result<(), String> {
    file.read_exact(into).map_err(|error| format!("{error}; the file is damaged or cut off"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_bytes(bytes: &[u8]) -> Result<EnvironmentImage, RenderError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.hdr");
        std::fs::write(&path, bytes).unwrap();
        EnvironmentImage::read(&path, &MemoryBudget::new(Bytes::mib(1)))
    }

    /// A header and rows of eight pixels.
    fn file(header: &str, height: usize, rows: &[&[u8]]) -> Vec<u8> {
        let mut bytes = format!("#?RADIANCE\n# made by hand\n{header}\n-Y {height} +X 8\n").into_bytes();
        bytes.extend(rows.concat());
        bytes
    }

    /// Three rows, one in each way: plain pixels, pixels with runs, channels with runs.
    fn three_ways() -> Vec<u8> {
        let plain: Vec<u8> = (0..8u8).flat_map(|x| [10 * x, 128, 0, 129]).collect();
        let runs = [64, 128, 192, 128, 1, 1, 1, 5, 0, 0, 0, 0, 200, 100, 50, 137];
        let channels = [
            2, 2, 0, 8, // By channel, eight pixels.
            0x88, 128, // Eight times 128.
            8, 0, 1, 2, 3, 4, 5, 6, 7, // Eight values.
            0x83, 7, 5, 1, 2, 3, 4, 5, // Three times 7, and five values.
            0x84, 129, 0x84, 130,
        ];
        file(
            "FORMAT=32-bit_rle_rgbe\nEXPOSURE=0.5\nEXPOSURE= 4\nCOLORCORR=1 2 1\n",
            3,
            &[&plain, &runs, &channels],
        )
    }

    #[test]
    fn all_three_ways_are_read() {
        let image = read_bytes(&three_ways()).unwrap();
        assert_eq!(image.size(), [8, 3]);
        let pixel = |x: usize, y: usize| image.pixel(x, y);
        // Exposures multiply: 2, and 4 for green. 129 is a factor of 2 / 256.
        assert_eq!(pixel(7, 0), [70.0 / 128.0 / 2.0, 1.0 / 4.0, 0.0]);
        assert_eq!(pixel(0, 1), [0.125, 0.125, 0.375]);
        assert_eq!((pixel(5, 1), pixel(6, 1)), (pixel(0, 1), [0.0; 3]));
        assert_eq!(pixel(7, 1)[0], 200.0);
        assert_eq!(pixel(2, 2), [0.5, 2.0 / 128.0 / 4.0, 7.0 / 128.0 / 2.0]);
        assert_eq!(pixel(7, 2), [1.0, 7.0 / 64.0 / 4.0, 5.0 / 64.0 / 2.0]);
    }

    #[test]
    fn a_row_is_reserved_while_it_is_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wide.hdr");
        // One pixel, and 39,999 like it.
        let pixels = [9, 9, 9, 129, 1, 1, 1, 0x3f, 1, 1, 1, 0x9c];
        std::fs::write(&path, [&b"#?RADIANCE\n\n-Y 1 +X 40000\n"[..], &pixels].concat()).unwrap();
        let needed = EnvironmentImage::bytes_needed(40_000, 1).unwrap().0;
        let read = |bytes| EnvironmentImage::read(&path, &MemoryBudget::new(Bytes(bytes)));
        assert!(matches!(read(needed + 4 * 40_000 - 1), Err(RenderError::Budget(_))));
        assert_eq!(read(needed + 4 * 40_000).unwrap().size(), [40_000, 1]);
    }

    #[test]
    fn damaged_files_are_errors() {
        let whole = three_ways();
        let mut refused = 0;
        for at in 0..whole.len() {
            assert!(read_bytes(&whole[..at]).is_err(), "cut at {at}");
            for bit in 0..8 {
                let mut flipped = whole.clone();
                flipped[at] ^= 1 << bit;
                // Some flips are other colours; none may be worse than that.
                refused += u32::from(read_bytes(&flipped).is_err());
            }
        }
        assert!(refused > 100, "{refused}");
        // Runs without end, empty runs without end, a size beyond all memory, a line without end, other kinds.
        let row = |tail: &[u8]| file("", 1, &[&[9, 9, 9, 9], tail]);
        assert!(read_bytes(&row(&[1, 1, 1, 8])).is_err());
        assert!(read_bytes(&row(&[1, 1, 1, 0].repeat(1000))).is_err());
        assert!(read_bytes(&row(&[1, 1, 1, 1].repeat(7))).is_err());
        let too_large = read_bytes(b"#?RADIANCE\n\n-Y 4000000000 +X 4000000000\n").unwrap_err().to_string();
        assert!(too_large.contains("sky.hdr") && too_large.contains("4000000000 x"), "{too_large}");
        assert!(read_bytes(b"#?RADIANCE\n\n-Y 4000 +X 4000\n").is_err(), "beyond the budget");
        assert!(read_bytes(&[b"#?RADIANCE\n".to_vec(), vec![b'x'; 100_000]].concat()).is_err());
        assert!(read_bytes(b"#?RADIANCE\n\n+Y 1 +X 1\n\x01\x01\x01\x81").is_err());
        assert!(read_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n\x01\x01\x01\x81").is_err());
        assert!(read_bytes(b"#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n\x01\x01\x01\x81").is_err());
        assert!(read_bytes(b"BM").is_err());
        // A first pixel that looks like a run is one.
        assert!(read_bytes(b"#?RGBE\n\n-Y 1 +X 1\n\x01\x01\x01\x81").is_ok());
    }
}
