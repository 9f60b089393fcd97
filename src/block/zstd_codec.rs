//! Zstandard behind its feature: contexts of the C library, made at the first block that needs them and kept.

use super::Fault;
use crate::error::EncodeError;

#[cfg(feature = "zstd")]
mod with_library {
    use zstd::bulk::{Compressor, Decompressor};

    use super::{EncodeError, Fault};

    /// Level 1: higher ones cost more time than the smaller file saves.
    const LEVEL: i32 = 1;

    #[derive(Default)]
    pub struct ZstdEncoder(Option<Compressor<'static>>);

    impl ZstdEncoder {
        pub fn compress(&mut self, payload: &[u8], out: &mut Vec<u8>) -> Result<(), EncodeError> {
            const FAILED: EncodeError = EncodeError::Invalid("zstd could not compress it");
            if self.0.is_none() {
                self.0 = Some(Compressor::new(LEVEL).map_err(|_| FAILED)?);
            }
            let Some(compressor) = &mut self.0 else { return Err(FAILED) };
            let start = out.len();
            out.resize(start + zstd::zstd_safe::compress_bound(payload.len()), 0);
            let written = compressor.compress_to_buffer(payload, &mut out[start..]).map_err(|_| FAILED)?;
            out.truncate(start + written);
            Ok(())
        }
    }

    #[derive(Default)]
    pub struct ZstdDecoder(Option<Decompressor<'static>>);

    impl ZstdDecoder {
        /// Memory of the C library's decoder, rounded up (`ZSTD_estimateDCtxSize` gives 96 KiB).
        pub const BYTES: usize = 128 << 10;

        pub fn decompress(&mut self, stored: &[u8], payload: &mut [u8], at: usize) -> Result<usize, Fault> {
            if self.0.is_none() {
                self.0 =
                    Some(Decompressor::new().map_err(|_| Fault(at, "zstd has no memory to decompress it"))?);
            }
            let decompressor = self.0.as_mut().ok_or(Fault(at, "zstd has no memory to decompress it"))?;
            decompressor
                .decompress_to_buffer(stored, payload)
                .map_err(|_| Fault(at, "its zstd data cannot be decompressed"))
        }
    }
}

#[cfg(not(feature = "zstd"))]
mod without_library {
    use super::{EncodeError, Fault};

    #[derive(Default)]
    pub struct ZstdEncoder(());

    impl ZstdEncoder {
        pub fn compress(&mut self, _payload: &[u8], _out: &mut Vec<u8>) -> Result<(), EncodeError> {
            Err(EncodeError::CodecMissing { codec: "zstd" })
        }
    }

    #[derive(Default)]
    pub struct ZstdDecoder(());

    impl ZstdDecoder {
        pub const BYTES: usize = 0;

        pub fn decompress(
            &mut self,
            _stored: &[u8],
            _payload: &mut [u8],
            _at: usize,
        ) -> Result<usize, Fault> {
            Err(Fault(1, "it is compressed with zstd, and this build of outcrop lacks the feature `zstd`"))
        }
    }
}

#[cfg(feature = "zstd")]
pub(super) use with_library::{ZstdDecoder, ZstdEncoder};
#[cfg(not(feature = "zstd"))]
pub(super) use without_library::{ZstdDecoder, ZstdEncoder};
