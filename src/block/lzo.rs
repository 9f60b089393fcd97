//! A bounded LZO1X decoder. It writes into a slice of the exact length, never allocates and never reads or writes
//! out of bounds, whatever the input (I5); the decoder that comes with the encoder does neither.
//!
//! Format: "LZO stream format as understood by Linux's LZO decompressor" in the Linux kernel documentation
//! (`Documentation/staging/lzo.rst`), bitstream version 0.

/// Where and why the input cannot be decompressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Error {
    /// In the compressed bytes.
    pub offset: usize,
    pub reason: &'static str,
}

struct Input<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
    fn error(&self, reason: &'static str) -> Error {
        Error { offset: self.at, reason }
    }

    fn byte(&mut self) -> Result<usize, Error> {
        let byte = *self.bytes.get(self.at).ok_or(self.error("its LZO data ends too early"))?;
        self.at += 1;
        Ok(usize::from(byte))
    }

    fn u16(&mut self) -> Result<usize, Error> {
        Ok(self.byte()? | self.byte()? << 8)
    }

    /// A length whose first field was zero: 255 for every zero byte, then a byte that is not zero, plus `base`.
    fn long_length(&mut self, base: usize) -> Result<usize, Error> {
        // The length cannot overflow: it grows by 255 per byte of input, which is at most a block.
        let mut length = base;
        loop {
            match self.byte()? {
                0 => length += 255,
                last => return Ok(length + last),
            }
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], Error> {
        let taken = self.bytes[self.at..].get(..count).ok_or(self.error("its LZO data ends too early"))?;
        self.at += count;
        Ok(taken)
    }
}

struct Output<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl Output<'_> {
    fn literals(&mut self, input: &mut Input<'_>, count: usize) -> Result<(), Error> {
        let room = self.bytes[self.at..].get_mut(..count);
        let room = room.ok_or(input.error("its LZO data is longer than promised"))?;
        room.copy_from_slice(input.take(count)?);
        self.at += count;
        Ok(())
    }

    fn copy(&mut self, input: &Input<'_>, distance: usize, count: usize) -> Result<(), Error> {
        if distance > self.at {
            return Err(input.error("its LZO data refers to bytes before its start"));
        }
        if count > self.bytes.len() - self.at {
            return Err(input.error("its LZO data is longer than promised"));
        }
        let from = self.at - distance;
        if distance >= count {
            self.bytes.copy_within(from..from + count, self.at);
        } else {
            // The copy reads what it writes: a pattern of `distance` bytes repeats.
            for index in from..from + count {
                self.bytes[index + distance] = self.bytes[index];
            }
        }
        self.at += count;
        Ok(())
    }
}

/// Decompresses `stored` into `payload` and returns how many bytes it wrote.
///
/// # Errors
/// The input is damaged, goes on after its end mark, or does not fit in `payload`.
pub(super) fn decompress(stored: &[u8], payload: &mut [u8]) -> Result<usize, Error> {
    let mut input = Input { bytes: stored, at: 0 };
    let mut output = Output { bytes: payload, at: 0 };

    // How many literals the last instruction copied after its match: 0 to 3, or 4 for "a long run".
    let mut literals = 0;
    let first = usize::from(*stored.first().ok_or(input.error("its LZO data is empty"))?);
    if first > 17 {
        input.at = 1;
        output.literals(&mut input, first - 17)?;
        literals = (first - 17).min(4);
    }
    loop {
        let code = input.byte()?;
        let (distance, count, low_bits) = match code {
            0..=15 if literals == 0 => {
                let count = if code == 0 { input.long_length(15)? } else { code } + 3;
                output.literals(&mut input, count)?;
                literals = 4;
                continue;
            }
            0..=15 => {
                let (base, count) = if literals == 4 { (2049, 3) } else { (1, 2) };
                ((input.byte()? << 2) + (code >> 2) + base, count, code)
            }
            16..=31 => {
                let count = if code & 7 == 0 { input.long_length(7)? } else { code & 7 } + 2;
                let low = input.u16()?;
                let distance = 16384 + ((code & 8) << 11) + (low >> 2);
                if distance == 16384 {
                    // The end mark is always written with length 3.
                    if count != 3 {
                        return Err(input.error("its LZO data has a wrong end mark"));
                    }
                    if input.at != stored.len() {
                        return Err(input.error("bytes follow the end of its LZO data"));
                    }
                    return Ok(output.at);
                }
                (distance, count, low)
            }
            32..=63 => {
                let count = if code & 31 == 0 { input.long_length(31)? } else { code & 31 } + 2;
                let low = input.u16()?;
                ((low >> 2) + 1, count, low)
            }
            _ => {
                let count = (code >> 5) + 1;
                ((input.byte()? << 3) + ((code >> 2) & 7) + 1, count, code)
            }
        };
        output.copy(&input, distance, count)?;
        literals = low_bits & 3;
        output.literals(&mut input, literals)?;
    }
}
