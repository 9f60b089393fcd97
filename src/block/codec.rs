//! Byte compressors behind one id. Each compresses a whole payload at once, without a dictionary.

use super::Fault;
use super::lzo;
use super::zstd_codec::{ZstdDecoder, ZstdEncoder};
use crate::error::EncodeError;

/// How a block's payload is compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Codec {
    /// Not at all.
    Raw,
    /// LZO1X, as in the 2004 paper. Smallest without C code, but slow to encode.
    Lzo,
    /// LZ4 block format: the fastest whole job.
    #[default]
    Lz4,
    /// Zstandard level 1. Needs the feature `zstd`.
    Zstd,
}

impl Codec {
    /// Every codec of the format, whether or not this build has it.
    pub const ALL: [Codec; 4] = [Codec::Raw, Codec::Lzo, Codec::Lz4, Codec::Zstd];

    /// The byte that names the codec in a block.
    pub const fn id(self) -> u8 {
        match self {
            Codec::Raw => 0,
            Codec::Lzo => 1,
            Codec::Lz4 => 2,
            Codec::Zstd => 3,
        }
    }

    /// The codec named by `id`.
    pub const fn from_id(id: u8) -> Option<Codec> {
        match id {
            0 => Some(Codec::Raw),
            1 => Some(Codec::Lzo),
            2 => Some(Codec::Lz4),
            3 => Some(Codec::Zstd),
            _ => None,
        }
    }

    /// Its name, in lower case.
    pub const fn name(self) -> &'static str {
        match self {
            Codec::Raw => "raw",
            Codec::Lzo => "lzo",
            Codec::Lz4 => "lz4",
            Codec::Zstd => "zstd",
        }
    }

    /// Whether this build can use it: all but `Zstd` always, `Zstd` with the feature `zstd`.
    pub const fn is_available(self) -> bool {
        !matches!(self, Codec::Zstd) || cfg!(feature = "zstd")
    }
}

/// State of the compressors, kept from block to block so that they do not allocate it again.
pub(super) struct CodecScratch {
    // The 32-bit table takes every payload; choosing by length would make the bytes of a block depend on the
    // blocks before it, since a table once grown does not shrink.
    lz4: lz4_flex::block::CompressTable,
    lzo: Option<Box<lzokay_native::Dict>>,
    zstd: ZstdEncoder,
}

impl CodecScratch {
    pub fn new() -> CodecScratch {
        CodecScratch { lz4: lz4_flex::block::CompressTable::large(), lzo: None, zstd: ZstdEncoder::default() }
    }
}

/// Appends the compressed payload to `out`, or returns false and leaves `out` as it was if that would not be
/// shorter than the payload (always so for `Raw`).
pub(super) fn compress(
    codec: Codec,
    payload: &[u8],
    scratch: &mut CodecScratch,
    out: &mut Vec<u8>,
) -> Result<bool, EncodeError> {
    let start = out.len();
    match codec {
        Codec::Raw => return Ok(false),
        Codec::Lz4 => {
            out.resize(start + lz4_flex::block::get_maximum_output_size(payload.len()), 0);
            let written =
                lz4_flex::block::compress_into_with_table(payload, &mut out[start..], &mut scratch.lz4);
            // The output has the size that the compressor asks for, so this does not fail.
            out.truncate(start + written.map_err(|_| EncodeError::Invalid("LZ4 could not compress it"))?);
        }
        Codec::Lzo => {
            let dict = scratch.lzo.get_or_insert_with(|| Box::new(lzokay_native::Dict::new()));
            let compressed = lzokay_native::compress_with_dict(payload, dict)
                .map_err(|_| EncodeError::Invalid("LZO could not compress it"))?;
            out.extend_from_slice(&compressed);
        }
        Codec::Zstd => scratch.zstd.compress(payload, out)?,
    }
    let shorter = out.len() - start < payload.len();
    if !shorter {
        out.truncate(start);
    }
    Ok(shorter)
}

/// Fills `payload` exactly from `stored`, or says why it cannot. `at` is where `stored` starts in the block.
pub(super) fn decompress(
    codec: Codec,
    stored: &[u8],
    payload: &mut [u8],
    zstd: &mut ZstdDecoder,
    at: usize,
) -> Result<(), Fault> {
    let written = match codec {
        Codec::Raw => {
            if stored.len() == payload.len() {
                payload.copy_from_slice(stored);
            }
            stored.len()
        }
        Codec::Lz4 => lz4_flex::block::decompress_into(stored, payload)
            .map_err(|_| Fault(at, "its LZ4 data cannot be decompressed"))?,
        Codec::Lzo => lzo::decompress(stored, payload)
            .map_err(|lzo::Error { offset, reason }| Fault(at + offset, reason))?,
        Codec::Zstd => zstd.decompress(stored, payload, at)?,
    };
    if written == payload.len() { Ok(()) } else { Err(Fault(at, "its payload has not the promised length")) }
}
