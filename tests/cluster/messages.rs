//! Frames that are not messages.

use outcrop::access::BlockSketch;
use outcrop::cluster::{BLOCKS_MAX, LeasedCells, Message, RANGE_BYTES_MAX, Role};

use outcrop::units::BlockId;

use super::numbers::Random;
use super::support::job;

fn messages() -> Vec<(Message, Vec<u8>)> {
    let what = LeasedCells { lease: 1 << 40, tile: 3, cells: 0xff00_0000_0000_0001 };
    let plain = [
        Message::Hello {
            version: 1,
            role: Role::Worker { lanes: 4 },
            name: "node".to_owned(),
            address: None,
            model: Some(u64::MAX),
        },
        Message::Hello {
            version: 1,
            role: Role::Reader,
            name: String::new(),
            address: Some("127.0.0.1:7000".to_owned()),
            model: Some(1),
        },
        Message::Alive,
        Message::Job(Box::new(job())),
        Message::Readers { addresses: vec!["a:1".to_owned(), String::new()] },
        Message::Request { lane: 3 },
        Message::Assign { lane: 0, what, stop_after_us: u64::MAX },
        Message::Shorten { lane: 300, what },
        Message::Failed { reason: "no disk".to_owned() },
        Message::Finished,
        Message::Read { blocks: vec![0, 1, u32::MAX] },
        Message::NoBlock { block: 7, reason: "gone".to_owned() },
        Message::Refused { reason: "the coordinator has another model".to_owned() },
        Message::ReadFile { offset: 1 << 50, length: RANGE_BYTES_MAX },
    ];
    let mut blocks = BlockSketch::default();
    (0..300).for_each(|block| blocks.add(BlockId(block * 3), 1000));
    let tail = (0..100).collect::<Vec<u8>>();
    let mut all: Vec<_> = plain.into_iter().map(|message| (message, vec![])).collect();
    all.push((Message::Result { lane: 1, what, is_last: true, micros: 5, work: 0.5, blocks }, tail.clone()));
    all.push((Message::Block { block: 9, turn: 200 }, tail.clone()));
    all.push((Message::FilePart { offset: 0, file_bytes: 10 }, tail));
    all
}

#[test]
fn messages_come_back_bit_for_bit() {
    for (message, tail) in messages() {
        let frame = message.frame_with(&tail);
        assert_eq!(Message::parse(&frame), Ok((message, &tail[..])));
    }
}

#[test]
fn damaged_frames_are_errors_or_other_messages_and_never_panics() {
    let mut refused = 0;
    for (message, tail) in messages() {
        let frame = message.frame_with(&tail);
        for length in 0..frame.len() {
            // A shorter tail is another tail; a shorter head is none.
            let parsed = Message::parse(&frame[..length]);
            assert!(parsed.is_err() || !tail.is_empty(), "{message:?} cut at {length}");
            refused += u32::from(parsed.is_err());
        }
        for bit in 0..frame.len() * 8 {
            let mut flipped = frame.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            // What parses says something that can be said.
            if let Ok((other, _)) = Message::parse(&flipped) {
                let _ = other.frame();
            } else {
                refused += 1;
            }
        }
        if tail.is_empty() {
            let longer = [&frame[..], &[0]].concat();
            assert!(Message::parse(&longer).is_err(), "{message:?}");
        }
    }
    assert!(refused > 500, "{refused}");
    let mut random = Random(1);
    for _ in 0..20_000 {
        let bytes: Vec<u8> = (0..random.below(60)).map(|_| random.bits() as u8).collect();
        let _ = Message::parse(&bytes);
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let long = "x".repeat(2000);
    for message in [
        Message::Read { blocks: vec![] },
        Message::Read { blocks: vec![0; BLOCKS_MAX + 1] },
        Message::ReadFile { offset: 0, length: 0 },
        Message::ReadFile { offset: 0, length: RANGE_BYTES_MAX + 1 },
        Message::Failed { reason: long.clone() },
        Message::Refused { reason: long.clone() },
        Message::Readers { addresses: vec![long] },
        Message::Readers { addresses: vec![String::new(); 2000] },
        Message::Result {
            lane: 0,
            what: LeasedCells { lease: 0, tile: 0, cells: 0 },
            is_last: true,
            micros: 0,
            work: f64::NAN,
            blocks: BlockSketch::default(),
        },
    ] {
        assert!(Message::parse(&message.frame()).is_err(), "{message:?}");
    }
    // A list that claims four billion entries.
    let mut frame = Message::Read { blocks: vec![1] }.frame();
    frame.truncate(frame.len() - 2);
    frame.extend([0xff, 0xff, 0xff, 0xff, 0x0f, 1]);
    assert!(Message::parse(&frame).is_err());
}
