//! The key that all nodes of a cluster share.

use std::fmt;
use std::path::Path;

use crate::error::TransportError;

/// A pre-shared key of 256 bits. Whoever holds it may join the cluster, give it tiles, take its pictures and read its model.
///
/// Read from a file or the environment, never from a command line, which every user of a machine can read.
#[derive(Clone)]
pub struct SharedKey {
    bytes: [u8; 32],
}

impl SharedKey {
    /// The environment variable that [`SharedKey::from_environment`] reads.
    pub const VARIABLE: &str = "OUTCROP_KEY";

    /// A new random key.
    ///
    /// # Errors
    /// [`TransportError::Key`] if the system gives no random numbers.
    pub fn generate() -> Result<SharedKey, TransportError> {
        let pair = super::tcp::random_bytes().map_err(|reason| key_error("a new key", reason))?;
        Ok(SharedKey { bytes: pair })
    }

    /// Reads 64 hexadecimal digits (white space around them is no matter), as `openssl rand -hex 32` writes them.
    ///
    /// # Errors
    /// [`TransportError::Key`]; the text is not repeated in it.
    pub fn from_hex(text: &str) -> Result<SharedKey, TransportError> {
        let error = || key_error("the key", "it must be 64 hexadecimal digits".to_owned());
        let text = text.trim().as_bytes();
        if text.len() != 64 {
            return Err(error());
        }
        let digit = |byte: u8| char::from(byte).to_digit(16).ok_or_else(error);
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(text.chunks_exact(2)) {
            // Two digits make at most 255.
            *byte = (digit(pair[0])? * 16 + digit(pair[1])?) as u8;
        }
        Ok(SharedKey { bytes })
    }

    /// Reads a key file. On Unix the file must be closed to everybody but its owner (mode 600 or 400).
    ///
    /// # Errors
    /// [`TransportError::Key`] if it cannot be read, others may read it, or it holds no key.
    pub fn from_file(path: impl AsRef<Path>) -> Result<SharedKey, TransportError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| key_error(&name, error.to_string()))?;
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let metadata = std::fs::metadata(path).map_err(|error| key_error(&name, error.to_string()))?;
            let mode = metadata.permissions().mode();
            if mode & 0o077 != 0 {
                let reason = format!("others may read it (mode {:o}); chmod 600 it", mode & 0o777);
                return Err(key_error(&name, reason));
            }
        }
        SharedKey::from_hex(&text)
            .map_err(|_| key_error(&name, "it must hold 64 hexadecimal digits".to_owned()))
    }

    /// Reads the key from the variable [`SharedKey::VARIABLE`]; `None` if it is not set.
    ///
    /// # Errors
    /// [`TransportError::Key`] if its value is not a key.
    pub fn from_environment() -> Result<Option<SharedKey>, TransportError> {
        match std::env::var(SharedKey::VARIABLE) {
            Ok(text) => SharedKey::from_hex(&text).map(Some),
            Err(std::env::VarError::NotPresent) => Ok(None),
            Err(error) => Err(key_error(SharedKey::VARIABLE, error.to_string())),
        }
    }

    /// The key as 64 hexadecimal digits, to hand it on in a file or an environment. It is a secret.
    pub fn to_hex(&self) -> String {
        self.bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    pub(super) fn bytes(&self) -> &[u8; 32] {
        &self.bytes
    }
}

/// Does not show the key.
impl fmt::Debug for SharedKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SharedKey(..)")
    }
}

fn key_error(name: &str, reason: String) -> TransportError {
    TransportError::Key { name: name.to_owned(), reason }
}
