//! The coordinator's checkpoint: a file to which finished cells are added, each with its checksum.
//!
//! ```text
//! header   "outckpt\n" | version (u32) = 2 | digest of the job (u64) | XXH3-64 of all before (u64)
//! record   length of the body (u32) | XXH3-64 of length and body (u64) | body
//! body     0 | a scheduler's checkpoint        the coordinator started or was restarted
//!          1 | a `Result` message              cells, and their pixels
//! ```
//!
//! A record counts when it is whole and its checksum is right, so a crash in the middle of writing loses that record and no other.
//! What follows a damaged record is cut off.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::coordinator::CoordinatorError;
use crate::block::checksum;
use crate::compile::open_locked;
use crate::schedule::ScheduleCheckpoint;

/// What a coordinator writes down.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// It started; what its schedule began with.
    Start(ScheduleCheckpoint),
    /// Cells are done: the frame of a [`Message::Result`](super::Message::Result).
    Result(Vec<u8>),
}

const SIGNATURE: [u8; 8] = *b"outckpt\n";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 28;
const RECORD_HEAD_BYTES: usize = 12;
/// No record is longer: a frame, or eight bytes for each of 2^22 tiles.
const BODY_BYTES_MAX: u32 = 64 << 20;

/// An open checkpoint.
pub struct Checkpoint {
    file: File,
    path: PathBuf,
}

impl Checkpoint {
    /// Opens the checkpoint of the job with this digest, or begins one. Gives what was recorded. The file is locked as long as the
    /// checkpoint is open, where the file system has locks.
    ///
    /// # Errors
    /// [`CoordinatorError::CheckpointInUse`] if another process has it open, [`CoordinatorError::OtherPicture`] if the file is the checkpoint
    /// of another job, [`CoordinatorError::NoCheckpoint`] if it is none, or its header is damaged; nothing is changed then.
    /// [`CoordinatorError::Checkpoint`] if it cannot be read or written.
    pub fn open(path: &Path, job_digest: u64) -> Result<(Checkpoint, Vec<Record>), CoordinatorError> {
        let failed = |error| CoordinatorError::Checkpoint { path: path.to_owned(), error };
        let file = open_locked(path).map_err(failed)?;
        let mut file = file.ok_or(CoordinatorError::CheckpointInUse { path: path.to_owned() })?;
        let length = file.metadata().map_err(failed)?.len();
        let header = header(job_digest);
        let mut records = Vec::new();
        let mut end = HEADER_BYTES as u64;
        let mut found = [0; HEADER_BYTES];
        // A coordinator that died before its header was whole leaves less, and nothing after it.
        if length < HEADER_BYTES as u64 {
            let mut found = Vec::new();
            file.read_to_end(&mut found).map_err(failed)?;
            if !header.starts_with(&found) {
                return Err(foreign(path, &found));
            }
            file.seek(SeekFrom::Start(0)).and_then(|_| file.write_all(&header)).map_err(failed)?;
        } else {
            file.read_exact(&mut found).map_err(failed)?;
            if found != header {
                return Err(foreign(path, &found));
            }
            let mut reader = io::BufReader::new(&file);
            while let Some(record) = read_record(&mut reader).map_err(failed)? {
                end += record.1;
                records.push(record.0);
            }
        }
        file.set_len(end).and_then(|()| file.seek(SeekFrom::Start(end))).map_err(failed)?;
        file.sync_all().map_err(failed)?;
        Ok((Checkpoint { file, path: path.to_owned() }, records))
    }

    /// Adds records; they are on disk when this returns.
    ///
    /// # Errors
    /// [`CoordinatorError::Checkpoint`]; the checkpoint then holds what it held before.
    pub fn append(&mut self, records: &[Record]) -> Result<(), CoordinatorError> {
        if records.is_empty() {
            return Ok(());
        }
        let mut bytes = Vec::new();
        for record in records {
            put_record(record, &mut bytes);
        }
        let written = self.file.write_all(&bytes).and_then(|()| self.file.sync_data());
        written.map_err(|error| CoordinatorError::Checkpoint { path: self.path.clone(), error })
    }
}

/// Why a file that does not begin with the job's header is not its checkpoint.
fn foreign(path: &Path, found: &[u8]) -> CoordinatorError {
    let path = path.to_owned();
    let reason = if !found.starts_with(&SIGNATURE) {
        "it is something else"
    } else if found.get(8..12).is_some_and(|version| version != VERSION.to_le_bytes()) {
        "it is of another version of this library, or its header is damaged"
    } else if found.len() < HEADER_BYTES || checksum(&found[..20]).to_le_bytes() != found[20..HEADER_BYTES] {
        "its header is damaged"
    } else {
        return CoordinatorError::OtherPicture { path };
    };
    CoordinatorError::NoCheckpoint { path, reason }
}

fn header(job_digest: u64) -> [u8; HEADER_BYTES] {
    let mut header = [0; HEADER_BYTES];
    header[..8].copy_from_slice(&SIGNATURE);
    header[8..12].copy_from_slice(&VERSION.to_le_bytes());
    header[12..20].copy_from_slice(&job_digest.to_le_bytes());
    let sum = checksum(&header[..20]);
    header[20..].copy_from_slice(&sum.to_le_bytes());
    header
}

fn put_record(record: &Record, into: &mut Vec<u8>) {
    let body = match record {
        Record::Start(checkpoint) => [&[0][..], &checkpoint.to_bytes()].concat(),
        Record::Result(frame) => [&[1][..], frame].concat(),
    };
    // Below `BODY_BYTES_MAX`: see there.
    let length = (body.len() as u32).to_le_bytes();
    let sum = checksum(&[&length[..], &body].concat());
    into.extend_from_slice(&length);
    into.extend_from_slice(&sum.to_le_bytes());
    into.extend_from_slice(&body);
}

/// The next record and its length in the file; `None` at the end or where the file is damaged.
fn read_record(reader: &mut impl Read) -> io::Result<Option<(Record, u64)>> {
    let mut head = [0; RECORD_HEAD_BYTES];
    if !filled(reader, &mut head)? {
        return Ok(None);
    }
    let (length, sum) = head.split_at(4);
    let body_bytes = u32::from_le_bytes([length[0], length[1], length[2], length[3]]);
    if body_bytes > BODY_BYTES_MAX {
        return Ok(None);
    }
    // The length may be nonsense: no more is allocated than is there.
    let mut body = Vec::new();
    reader.take(u64::from(body_bytes)).read_to_end(&mut body)?;
    if body.len() != body_bytes as usize || checksum(&[length, &body].concat()).to_le_bytes() != sum {
        return Ok(None);
    }
    let record = match body.split_first() {
        Some((0, bytes)) => ScheduleCheckpoint::from_bytes(bytes).ok().map(Record::Start),
        Some((1, frame)) => Some(Record::Result(frame.to_vec())),
        _ => None,
    };
    Ok(record.map(|record| (record, RECORD_HEAD_BYTES as u64 + body.len() as u64)))
}

/// Fills `into`; false if the file ends before.
fn filled(reader: &mut impl Read, into: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(into) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

impl std::fmt::Debug for Checkpoint {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Checkpoint").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::{AdaptiveScheduler, SchedulerOptions, TileScheduler};

    fn records() -> Vec<Record> {
        let scheduler = AdaptiveScheduler::new(100, 60, SchedulerOptions::new(2)).unwrap();
        vec![
            Record::Start(scheduler.checkpoint()),
            Record::Result(vec![7; 300]),
            Record::Result(vec![]),
            Record::Result(vec![9; 5]),
        ]
    }

    #[test]
    fn records_come_back_and_other_jobs_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.checkpoint");
        let (mut checkpoint, found) = Checkpoint::open(&path, 5).unwrap();
        assert!(found.is_empty());
        checkpoint.append(&records()[..2]).unwrap();
        drop(checkpoint);
        let (mut checkpoint, found) = Checkpoint::open(&path, 5).unwrap();
        assert_eq!(found, records()[..2]);
        checkpoint.append(&records()[2..]).unwrap();
        drop(checkpoint);
        assert_eq!(Checkpoint::open(&path, 5).unwrap().1, records());
        let error = Checkpoint::open(&path, 6).map(drop).unwrap_err();
        assert!(matches!(&error, CoordinatorError::OtherPicture { path: named } if *named == path));
        assert!(error.to_string().contains("picture.checkpoint"), "{error}");
        assert_eq!(Checkpoint::open(&path, 5).unwrap().1, records());
        std::fs::write(&path, "some notes that are nobody's checkpoint").unwrap();
        let no_checkpoint = |what: &str| match Checkpoint::open(&path, 5).map(drop).unwrap_err() {
            error @ CoordinatorError::NoCheckpoint { .. } => {
                let text = error.to_string();
                assert!(text.contains("picture.checkpoint") && text.contains(what), "{text}");
            }
            other => panic!("{other}"),
        };
        no_checkpoint("something else");
        assert!(std::fs::read(&path).unwrap().starts_with(b"some notes"));
        std::fs::write(&path, "notes").unwrap();
        no_checkpoint("something else");
        for (at, what) in [(3, "something else"), (9, "version"), (15, "damaged"), (25, "damaged")] {
            let mut bytes = header(5);
            bytes[at] ^= 1;
            std::fs::write(&path, bytes).unwrap();
            no_checkpoint(what);
            assert_eq!(std::fs::read(&path).unwrap(), bytes);
        }
        std::fs::write(&path, &header(6)[..24]).unwrap();
        no_checkpoint("damaged");
    }

    #[test]
    fn two_coordinators_do_not_share_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.checkpoint");
        let (mut checkpoint, _) = Checkpoint::open(&path, 5).unwrap();
        checkpoint.append(&records()[..1]).unwrap();
        for digest in [5, 6] {
            let error = Checkpoint::open(&path, digest).map(drop).unwrap_err();
            assert!(matches!(&error, CoordinatorError::CheckpointInUse { path: named } if *named == path));
            assert!(error.to_string().contains("picture.checkpoint"), "{error}");
        }
        checkpoint.append(&records()[1..]).unwrap();
        drop(checkpoint);
        assert_eq!(Checkpoint::open(&path, 5).unwrap().1, records());
    }

    #[test]
    fn damage_costs_what_is_damaged_and_what_follows_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.checkpoint");
        Checkpoint::open(&path, 5).unwrap().0.append(&records()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let mut ends = vec![HEADER_BYTES];
        for record in records() {
            let mut bytes = Vec::new();
            put_record(&record, &mut bytes);
            ends.push(ends[ends.len() - 1] + bytes.len());
        }
        assert_eq!(ends[4], whole.len());
        let before = |at: usize| ends[1..].iter().filter(|end| **end <= at).count();
        for length in (0..whole.len()).step_by(3) {
            std::fs::write(&path, &whole[..length]).unwrap();
            let (mut checkpoint, found) = Checkpoint::open(&path, 5).unwrap();
            assert_eq!(found, records()[..before(length)], "{length}");
            // It can be written on, and is whole again.
            checkpoint.append(&records()[3..]).unwrap();
            drop(checkpoint);
            let again = Checkpoint::open(&path, 5).unwrap().1;
            assert_eq!(again.last(), records().last());
            assert_eq!(again.len(), before(length) + 1);
        }
        for at in HEADER_BYTES..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x10;
            std::fs::write(&path, &bytes).unwrap();
            assert_eq!(Checkpoint::open(&path, 5).unwrap().1, records()[..before(at)], "{at}");
        }
    }
}
