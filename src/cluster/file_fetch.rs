//! Bytes of the compiled file from a reader.

use std::io;
use std::time::{Duration, Instant};

use super::message::{Message, RANGE_BYTES_MAX};
use crate::error::{BudgetError, ModelError, SourceError};
use crate::model::{Model, ModelReader};
use crate::transport::{PeerId, Transport, TransportEvent};
use crate::units::Bytes;

/// What errors call the readers.
pub(super) const NAME: &str = "the cluster's readers";

/// Reads bytes of the compiled file from a reader, one range after the other.
pub(super) struct FileFetch<'t> {
    transport: &'t dyn Transport,
    peer: PeerId,
    time_max: Duration,
    /// Length of the file.
    pub file_bytes: u64,
}

impl<'t> FileFetch<'t> {
    pub fn start(
        transport: &'t dyn Transport,
        address: &str,
        time_max: Duration,
    ) -> Result<FileFetch<'t>, SourceError> {
        let peer = transport
            .connect(address)
            .map_err(|error| failed("the header", io::ErrorKind::NotConnected, error.to_string()))?;
        let mut fetch = FileFetch { transport, peer, time_max, file_bytes: u64::MAX };
        // The answer says how long the file is.
        fetch.part("the header", 0, &mut [0; 1])?;
        Ok(fetch)
    }

    /// Header, directory and materials.
    pub fn model(
        &mut self,
        claim: &mut dyn FnMut(Bytes) -> Result<(), BudgetError>,
    ) -> Result<Model, SourceError> {
        let file_bytes = self.file_bytes;
        let claim = |bytes| claim(bytes).map_err(|error| FetchError::Source(error.into()));
        let model = ModelReader::read_if(file_bytes, claim, |what, offset, into: &mut [u8]| {
            self.range(what, offset, into).map_err(FetchError::Source)
        });
        model.map_err(|error| match error {
            FetchError::Source(error) => error,
            FetchError::Model(error) => SourceError::Model { name: NAME.to_owned(), error },
        })
    }

    /// Fills `into` with the bytes from `offset` on.
    pub fn range(&mut self, what: &str, offset: u64, into: &mut [u8]) -> Result<(), SourceError> {
        let mut at = offset;
        for piece in into.chunks_mut(RANGE_BYTES_MAX as usize) {
            self.part(what, at, piece)?;
            at += piece.len() as u64;
        }
        Ok(())
    }

    fn part(&mut self, what: &str, offset: u64, into: &mut [u8]) -> Result<(), SourceError> {
        // At most `RANGE_BYTES_MAX`.
        let frame = Message::ReadFile { offset, length: into.len() as u32 }.frame();
        let gone = |reason: String| failed(what, io::ErrorKind::NotConnected, reason);
        self.transport.send(self.peer, frame).map_err(|error| gone(error.to_string()))?;
        let deadline = Instant::now() + self.time_max;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let event = self.transport.receive(left).map_err(|error| gone(error.to_string()))?;
            match event {
                None => {
                    return Err(failed(what, io::ErrorKind::TimedOut, "a reader does not answer".to_owned()));
                }
                Some(TransportEvent::Frame { peer, bytes }) if peer == self.peer => {
                    match Message::parse(&bytes) {
                        Ok((Message::FilePart { offset: found, file_bytes }, part)) if found == offset => {
                            self.file_bytes = file_bytes;
                            if part.len() != into.len() {
                                let name = NAME.to_owned();
                                return Err(SourceError::Truncated {
                                    what: what.to_owned(),
                                    name,
                                    end: file_bytes,
                                });
                            }
                            into.copy_from_slice(part);
                            return Ok(());
                        }
                        Ok(_) => {}
                        Err(error) => {
                            return Err(failed(what, io::ErrorKind::InvalidData, error.to_string()));
                        }
                    }
                }
                Some(TransportEvent::Disconnected { peer, reason }) if peer == self.peer => {
                    return Err(gone(reason));
                }
                Some(_) => {}
            }
        }
    }
}

impl Drop for FileFetch<'_> {
    fn drop(&mut self) {
        self.transport.disconnect(self.peer);
    }
}

enum FetchError {
    Model(ModelError),
    Source(SourceError),
}

impl From<ModelError> for FetchError {
    fn from(error: ModelError) -> FetchError {
        FetchError::Model(error)
    }
}

pub(super) fn failed(what: &str, kind: io::ErrorKind, reason: String) -> SourceError {
    SourceError::Io { what: what.to_owned(), name: NAME.to_owned(), error: io::Error::new(kind, reason) }
}
