//! Damaged bytes give typed errors: never a panic, never wrong geometry that was not asked for (I5).

#[path = "support/numbers.rs"]
mod numbers;

use numbers::Random;
use outcrop::BlockSource;
use outcrop::block::{BlockCheck, BlockData, BlockLimits, Codec, DecodeScratch, checksum, decode};
use outcrop::error::{BlockError, ModelError, SourceError};
use outcrop::geom::{Lattice, Precision};
use outcrop::model::{HEADER_BYTES, Model};
use outcrop::source::MemorySource;
use outcrop::source::testing::memory_model;
use outcrop::units::BlockId;

const LIMITS: BlockLimits = BlockLimits { block_bytes_max: 4096 };

const PRECISIONS: [Precision; 3] = [
    Precision::Float32,
    Precision::Lattice(Lattice { exponent: -10 }),
    // So fine that every block is wide.
    Precision::Lattice(Lattice { exponent: -40 }),
];

fn triangles(count: u32) -> Vec<[[f64; 3]; 3]> {
    let point = |i: u32| [f64::from(i % 16), f64::from(i / 16), f64::from(i * 7919 % 101) * 0.125];
    (0..count).map(|i| [point(i), point(i + 1), point(i + 16)]).collect()
}

fn file(count: u32, codec: Codec, precision: Precision) -> Vec<u8> {
    memory_model(&triangles(count), LIMITS, codec, precision).unwrap()
}

fn codecs() -> impl Iterator<Item = Codec> {
    Codec::ALL.into_iter().filter(|codec| codec.is_available())
}

struct Decoder {
    precision: Precision,
    scratch: DecodeScratch,
    data: BlockData,
}

impl Decoder {
    fn new(precision: Precision) -> Decoder {
        let (scratch, data) = (DecodeScratch::with_limits(LIMITS), BlockData::with_limits(LIMITS));
        Decoder { precision, scratch, data }
    }

    fn decode(&mut self, bytes: &[u8], check: &BlockCheck) -> Result<&BlockData, BlockError> {
        let result = decode(bytes, check, self.precision, LIMITS, &mut self.scratch, &mut self.data);
        match result {
            Ok(()) => Ok(&self.data),
            Err(error) => {
                assert_eq!((error.block, error.offset <= bytes.len() as u64), (check.block, true));
                assert_eq!(self.data, BlockData::default());
                Err(error)
            }
        }
    }
}

/// What a decoded block guarantees, whatever its bytes were.
fn is_sound(data: &BlockData, check: &BlockCheck) {
    let (triangles, vertices) = (check.triangle_count as usize, check.vertex_count as usize);
    assert_eq!(
        (data.triangles.len(), data.ids.len(), data.materials.len()),
        (triangles, triangles, triangles)
    );
    assert_eq!(data.vertices.len(), vertices);
    assert!(data.triangles.as_flattened().iter().all(|index| usize::from(*index) < vertices));
    assert!(data.ids.windows(2).all(|pair| pair[0] < pair[1]));
    assert!(data.materials.iter().all(|m| (check.material_range[0]..=check.material_range[1]).contains(m)));
    assert!(data.vertices.as_flattened().iter().all(|x| x.is_finite()));
    assert!((0..vertices).all(|vertex| data.position(vertex).iter().all(|x| x.is_finite())));
}

/// The first block of a file with its promise.
fn first_block(file: &[u8]) -> (Vec<u8>, BlockCheck) {
    let source = MemorySource::new(file.to_vec()).unwrap();
    let mut bytes = Vec::new();
    source.read_block(BlockId(0), &mut bytes).unwrap();
    (bytes, source.model().check(BlockId(0)).unwrap())
}

#[test]
fn every_prefix_and_every_longer_block_is_refused() {
    for precision in PRECISIONS {
        let mut decoder = Decoder::new(precision);
        for codec in codecs() {
            let (bytes, check) = first_block(&file(60, codec, precision));
            decoder.decode(&bytes, &check).unwrap();
            for length in 0..bytes.len() {
                let prefix = &bytes[..length];
                assert_eq!(decoder.decode(prefix, &check).unwrap_err().reason, "its checksum is wrong");
                // With the right checksum, so that the decoder itself has to notice.
                let check = BlockCheck { checksum: checksum(prefix), ..check };
                decoder.decode(prefix, &check).unwrap_err();
            }
            for extra in [1, 2, 8, 100] {
                let longer = [&bytes[..], &vec![0; extra]].concat();
                let check = BlockCheck { checksum: checksum(&longer), ..check };
                decoder.decode(&longer, &check).unwrap_err();
            }
        }
    }
}

#[test]
fn a_block_that_is_not_the_promised_one_is_refused() {
    let (bytes, check) = first_block(&file(60, Codec::Lz4, Precision::Float32));
    let mut decoder = Decoder::new(Precision::Float32);
    for change in [
        |check: &mut BlockCheck| check.triangle_count += 1,
        |check: &mut BlockCheck| check.vertex_count -= 1,
        |check: &mut BlockCheck| check.material_range = [1, 2],
        |check: &mut BlockCheck| check.checksum ^= 1,
    ] {
        let mut other = check;
        change(&mut other);
        decoder.decode(&bytes, &other).unwrap_err();
    }
    Decoder::new(PRECISIONS[1]).decode(&bytes, &check).unwrap_err();
    // Scratch for smaller blocks than the file has.
    let (bytes, check) = first_block(&file(240, Codec::Lz4, Precision::Float32));
    let mut small = DecodeScratch::with_limits(BlockLimits { block_bytes_max: 1000 });
    let error = decode(&bytes, &check, Precision::Float32, LIMITS, &mut small, &mut decoder.data);
    assert!(error.unwrap_err().reason.contains("set aside"));
}

#[test]
fn flipped_bits_in_blocks_are_errors_or_sound_blocks() {
    let mut random = Random(1);
    let (mut refused, mut decoded) = (0, 0);
    for precision in PRECISIONS {
        let mut decoder = Decoder::new(precision);
        for codec in codecs() {
            let (bytes, check) = first_block(&file(60, codec, precision));
            let original = decoder.decode(&bytes, &check).unwrap().clone();
            let mut damaged = bytes.clone();
            for round in 0..12_000 {
                damaged.copy_from_slice(&bytes);
                for _ in 0..1 + round % 3 {
                    random.flip(&mut damaged);
                }
                match decoder.decode(&damaged, &check) {
                    Ok(data) => assert!(damaged == bytes && *data == original),
                    Err(error) => assert_eq!(error.reason, "its checksum is wrong"),
                }
                let check = BlockCheck { checksum: checksum(&damaged), ..check };
                match decoder.decode(&damaged, &check) {
                    Ok(data) => {
                        is_sound(data, &check);
                        decoded += 1;
                    }
                    Err(_) => refused += 1,
                }
            }
        }
    }
    // Both ways must have been taken for the test to mean anything.
    assert!(refused > 10_000 && decoded > 1_000, "{refused} refused, {decoded} decoded");
}

#[test]
fn random_bytes_behind_a_good_header_are_no_reason_to_panic() {
    let mut random = Random(2);
    for precision in PRECISIONS {
        let mut decoder = Decoder::new(precision);
        for codec in codecs() {
            let (mut bytes, check) = first_block(&file(60, codec, precision));
            for _ in 0..3_000 {
                let from = 64 + random.index(bytes.len() - 64);
                bytes[from..].iter_mut().for_each(|byte| *byte = random.index(256) as u8);
                let check = BlockCheck { checksum: checksum(&bytes), ..check };
                if let Ok(data) = decoder.decode(&bytes, &check) {
                    is_sound(data, &check);
                }
            }
        }
    }
}

/// Opens a file and decodes all its blocks.
fn read_all(file: &[u8]) -> Result<(Model, Vec<Result<BlockData, BlockError>>), SourceError> {
    let source = MemorySource::new(file.to_vec())?;
    let model = Model::clone(source.model());
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let (mut bytes, mut data) = (Vec::new(), BlockData::with_limits(model.limits));
    let mut blocks = Vec::new();
    for block in (0..model.blocks.len() as u32).map(BlockId) {
        source.read_block(block, &mut bytes)?;
        let result = model.decode_block(block, &bytes, &mut scratch, &mut data);
        blocks.push(result.map(|()| data.clone()));
    }
    Ok((model, blocks))
}

#[test]
fn every_truncation_of_a_file_is_refused() {
    let file = file(600, Codec::Lz4, Precision::Float32);
    read_all(&file).unwrap();
    for length in 0..file.len() {
        let Err(SourceError::Model { error, .. }) = MemorySource::new(file[..length].to_vec()) else {
            panic!("a file of {length} of {} bytes opens", file.len());
        };
        match length {
            0 => assert_eq!(error, ModelError::NotCompiled),
            _ => assert!(matches!(error, ModelError::Damaged { part: "header", .. }), "{error}"),
        }
    }
    let longer = [&file[..], &[0]].concat();
    assert!(MemorySource::new(longer).is_err());
}

#[test]
fn flipped_bits_in_a_file_are_noticed() {
    let file = file(600, Codec::Lz4, Precision::Float32);
    let (model, blocks) = read_all(&file).unwrap();
    let mut random = Random(3);
    let blocks_end =
        model.blocks.last().map(|entry| entry.offset + u64::from(entry.stored_bytes)).unwrap() as usize;
    let mut damaged = file.clone();
    for round in 0..10_000 {
        damaged.copy_from_slice(&file);
        // Most of the file is blocks; header, directory and materials get as many flips.
        let part = match round % 3 {
            0 => &mut damaged[..HEADER_BYTES],
            1 => &mut damaged[HEADER_BYTES..blocks_end],
            _ => &mut damaged[blocks_end..],
        };
        random.flip(part);
        match read_all(&damaged) {
            Err(_) => assert_ne!(round % 3, 1),
            Ok((found, found_blocks)) => {
                assert_eq!((round % 3, &found), (1, &model));
                let wrong = found_blocks.iter().zip(&blocks).filter(|(found, block)| found != block).count();
                assert_eq!((wrong, found_blocks.iter().filter(|block| block.is_err()).count()), (1, 1));
            }
        }
    }
}

/// Makes the checksums of header, directory and materials right again where that can be done.
fn seal(file: &mut [u8]) {
    let u64_at = |file: &[u8], at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap());
    for section in [104, 128] {
        let (offset, bytes) = (u64_at(file, section) as usize, u64_at(file, section + 8) as usize);
        if let Some(part) = file.get(offset..).and_then(|rest| rest.get(..bytes)) {
            let sum = checksum(part);
            file[section + 16..section + 24].copy_from_slice(&sum.to_le_bytes());
        }
    }
    let sum = checksum(&file[..HEADER_BYTES - 8]);
    file[HEADER_BYTES - 8..HEADER_BYTES].copy_from_slice(&sum.to_le_bytes());
}

#[test]
fn flipped_bits_under_good_checksums_are_errors_or_sound_models() {
    let mut random = Random(4);
    let (mut refused, mut opened) = (0, 0);
    for precision in PRECISIONS {
        let file = file(300, Codec::Lz4, precision);
        let (model, _) = read_all(&file).unwrap();
        let blocks_end =
            model.blocks.last().map(|entry| entry.offset + u64::from(entry.stored_bytes)).unwrap() as usize;
        let mut damaged = file.clone();
        for round in 0..10_000 {
            damaged.copy_from_slice(&file);
            for _ in 0..1 + round % 2 {
                match random.index(2) {
                    0 => random.flip(&mut damaged[..HEADER_BYTES]),
                    _ => random.flip(&mut damaged[blocks_end..]),
                }
            }
            seal(&mut damaged);
            match read_all(&damaged) {
                Err(_) => refused += 1,
                Ok((model, blocks)) => {
                    opened += 1;
                    let end = model.blocks.last().map(|entry| entry.offset + u64::from(entry.stored_bytes));
                    assert!(end.unwrap() <= damaged.len() as u64);
                    for (block, data) in blocks.iter().enumerate() {
                        if let Ok(data) = data {
                            is_sound(data, &model.check(BlockId(block as u32)).unwrap());
                            assert!(data.materials.iter().all(|m| usize::from(*m) < model.materials.len()));
                        }
                    }
                }
            }
        }
    }
    assert!(refused > 5_000 && opened > 1_000, "{refused} refused, {opened} opened");
}

#[test]
fn lying_counts_are_refuted_before_anything_is_allocated() {
    let file = file(300, Codec::Lz4, Precision::Float32);
    let open = |at: usize, bytes: &[u8]| {
        let mut damaged = file.clone();
        damaged[at..at + bytes.len()].copy_from_slice(bytes);
        seal(&mut damaged);
        MemorySource::new(damaged).unwrap_err().to_string()
    };
    // Block count, directory length, material count and length, directory and material offsets.
    for (at, width) in [(96, 4), (112, 8), (100, 4), (136, 8), (104, 8), (128, 8)] {
        for value in [u64::MAX, u64::MAX / 128, 1 << 31, 0] {
            let message = open(at, &value.to_le_bytes()[..width]);
            assert!(message.contains("is damaged"), "{at}: {message}");
        }
    }
    // Before and after the version that this library writes.
    for version in [2u32, 4] {
        assert!(open(12, &version.to_le_bytes()).contains(&format!("version {version}")));
    }
    assert!(open(16, &(1u64 << 63).to_le_bytes()).contains("a later version"));
    if !Codec::Zstd.is_available() {
        assert!(open(16, &1u64.to_le_bytes()).contains("zstd"));
    }
}
