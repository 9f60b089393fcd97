//! Any bytes as the files that a cluster reads: a coordinator's checkpoint, a schedule's, a host file. The first byte says as which;
//! checksums are made right, or else little of them would be read.
#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use outcrop::block::checksum;
use outcrop::cluster::{Checkpoint, Hosts, Record};
use outcrop::schedule::ScheduleCheckpoint;

/// The job whose checkpoint it is.
const DIGEST: u64 = 7;

fuzz_target!(|input: &[u8]| {
    let [kind, bytes @ ..] = input else { return };
    match kind % 3 {
        0 => {
            // The input is the bodies of records: a length of one byte, then a body.
            let Ok(folder) = tempfile::tempdir() else { return };
            let path = folder.path().join("fuzz.checkpoint");
            if records(&path).is_none() {
                return;
            }
            let Ok(mut file) = fs::read(&path) else { return };
            let mut rest = bytes;
            while let [length, more @ ..] = rest {
                let (body, after) = more.split_at(usize::from(*length).min(more.len()));
                let head = (body.len() as u32).to_le_bytes();
                file.extend_from_slice(&head);
                file.extend_from_slice(&checksum(&[&head[..], body].concat()).to_le_bytes());
                file.extend_from_slice(body);
                rest = after;
            }
            if fs::write(&path, &file).is_err() {
                return;
            }
            // What was read once is there unchanged when it is opened again.
            let first = records(&path);
            assert_eq!(first, records(&path));
        }
        1 => {
            // As it is, and with a checksum that is right.
            let _ = ScheduleCheckpoint::from_bytes(bytes);
            let sealed = [bytes, &checksum(bytes).to_le_bytes()].concat();
            if let Ok(schedule) = ScheduleCheckpoint::from_bytes(&sealed) {
                assert_eq!(ScheduleCheckpoint::from_bytes(&schedule.to_bytes()).ok(), Some(schedule));
            }
        }
        _ => {
            if let Ok(text) = std::str::from_utf8(bytes)
                && let Ok(hosts) = text.parse::<Hosts>()
            {
                assert!(!hosts.coordinator().is_empty());
            }
        }
    }
});

/// What the checkpoint at `path` holds.
fn records(path: &std::path::Path) -> Option<Vec<Record>> {
    Checkpoint::open(path, DIGEST).ok().map(|(_, records)| records)
}
