//! What every `BlockSource` has to do, run over all of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use outcrop::block::{BlockData, BlockLimits, Codec, DecodeScratch};
use outcrop::cluster::{Reader, ReaderCounters, RemoteOptions, RemoteSource, RoleOptions, run_reader};
use outcrop::error::{ModelError, SourceError};
use outcrop::geom::Precision;
use outcrop::source::testing::{FaultRates, FaultySource, SlowSource, memory_model};
use outcrop::source::{DiskSource, MemorySource, MmapSource, PageCache};
use outcrop::transport::{LocalNetwork, SharedKey, TcpOptions, TcpTransport, Transport};
use outcrop::units::BlockId;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

const LIMITS: BlockLimits = BlockLimits { block_bytes_max: 4096 };

fn triangles() -> Vec<[[f64; 3]; 3]> {
    let point = |i: u32| [f64::from(i % 64), f64::from(i / 64), f64::from(i * 7919 % 101) * 0.125];
    (0..3000).map(|i| [point(i), point(i + 1), point(i + 64)]).collect()
}

fn file() -> Vec<u8> {
    memory_model(&triangles(), LIMITS, Codec::Lz4, Precision::Float32).unwrap()
}

/// The suite: `source` serves exactly the compiled file `file`.
fn conforms<S: BlockSource>(source: &S, file: &[u8]) {
    let model = Arc::clone(source.model());
    let expected = MemorySource::new(file.to_vec()).unwrap();
    assert_eq!(*model, **expected.model());
    assert!(model.blocks.len() > 8, "a test with one block shows little");

    // Blocks come in any order, byte for byte, into a buffer that is never reallocated.
    let mut bytes = Vec::with_capacity(source.buffer_bytes().as_usize());
    let (place, capacity) = (bytes.as_ptr(), bytes.capacity());
    let count = model.blocks.len() as u32;
    for block in (0..count).rev().chain(0..count).map(BlockId) {
        bytes.resize(7, 0xee);
        source.read_block(block, &mut bytes).unwrap();
        let entry = model.entry(block).unwrap();
        assert_eq!(bytes, file[entry.offset as usize..][..entry.stored_bytes as usize]);
        assert_eq!((bytes.as_ptr(), bytes.capacity()), (place, capacity));
    }

    // They decode to the triangles that went in.
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let mut data = BlockData::with_limits(model.limits);
    let mut seen = 0;
    for block in (0..count).map(BlockId) {
        source.read_block(block, &mut bytes).unwrap();
        model.decode_block(block, &bytes, &mut scratch, &mut data).unwrap();
        for (triangle, id) in data.triangles.iter().zip(&data.ids) {
            assert_eq!(triangle.map(|v| data.position(v.into())), triangles()[*id as usize]);
            seen += 1;
        }
        if block.0 == 3 {
            break;
        }
    }
    assert!(seen > 100);

    // A block that does not exist is an error with its number.
    for block in [count, u32::MAX] {
        match source.read_block(BlockId(block), &mut bytes) {
            Err(SourceError::NoSuchBlock { block: found, count: known, .. }) => {
                assert_eq!((found.0, known), (block, count));
            }
            other => panic!("{other:?}"),
        }
    }

    // Threads do not disturb each other.
    std::thread::scope(|scope| {
        for thread in 0..4u32 {
            let (source, model) = (&source, &model);
            scope.spawn(move || {
                let mut bytes = Vec::new();
                for i in 0..2 * count {
                    let block = BlockId((i * 7 + thread * 3) % count);
                    source.read_block(block, &mut bytes).unwrap();
                    let entry = model.entry(block).unwrap();
                    assert_eq!(bytes, file[entry.offset as usize..][..entry.stored_bytes as usize]);
                }
            });
        }
    });
}

fn on_disk(file: &[u8]) -> tempfile::NamedTempFile {
    let temporary = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(temporary.path(), file).unwrap();
    temporary
}

#[test]
fn memory() {
    let file = file();
    conforms(&MemorySource::new(file.clone()).unwrap(), &file);
    let shared: Arc<[u8]> = file.clone().into();
    let source = MemorySource::new(Arc::clone(&shared)).unwrap();
    assert!(Arc::ptr_eq(source.bytes(), &shared));
}

#[test]
fn disk() {
    let file = file();
    let temporary = on_disk(&file);
    conforms(&DiskSource::open(temporary.path()).unwrap(), &file);
}

#[test]
fn disk_without_page_cache() {
    let file = file();
    // Beside the build, since the folder for temporary files may be in memory, where direct reads mean nothing.
    let temporary = tempfile::NamedTempFile::new_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    std::fs::write(temporary.path(), &file).unwrap();
    conforms(&DiskSource::open_with(temporary.path(), PageCache::Bypass).unwrap(), &file);
    let temporary = on_disk(&file);
    conforms(&DiskSource::open_with(temporary.path(), PageCache::Bypass).unwrap(), &file);
}

#[test]
fn mapped() {
    let file = file();
    let temporary = on_disk(&file);
    // SAFETY: the file is this test's own, and nobody writes to it.
    conforms(&unsafe { MmapSource::open(temporary.path()) }.unwrap(), &file);
}

#[test]
fn wrappers_that_do_nothing() {
    let file = file();
    let source = || MemorySource::new(file.clone()).unwrap();
    let faulty = FaultySource::new(source(), 1, FaultRates::default());
    conforms(&faulty, &file);
    assert_eq!(faulty.fault_count(), 0);
    conforms(&SlowSource::new(source(), Duration::ZERO, None), &file);
    conforms(&SlowSource::new(faulty, Duration::from_nanos(1), Some(1 << 40)), &file);
}

/// Runs `test` beside `readers` readers of `file`, with their addresses and a transport to reach them. Gives what the readers did.
fn with_readers(
    open: &(dyn Fn(&str) -> Arc<dyn Transport> + Sync),
    file: &[u8],
    readers: usize,
    memory: Bytes,
    test: impl FnOnce(Vec<String>, Arc<dyn Transport>),
) -> Vec<ReaderCounters> {
    let stop = AtomicBool::new(false);
    let coordinator = open("coordinator");
    let address = coordinator.address().unwrap();
    std::thread::scope(|scope| {
        let (transports, threads): (Vec<_>, Vec<_>) = (0..readers)
            .map(|i| {
                let transport = open(&format!("reader {i}"));
                let budget = MemoryBudget::new(Bytes::mib(64));
                let source = Arc::new(MemorySource::new(file.to_vec()).unwrap());
                let own = transport.address().unwrap();
                let reader =
                    Reader::new(source, "reader", &own, memory, &budget, RoleOptions::default()).unwrap();
                let (address, stop) = (&address, &stop);
                let running = Arc::clone(&transport);
                let thread = scope.spawn(move || {
                    run_reader(&*running, reader, address, Duration::from_secs(60), stop, &mut |_| {})
                        .unwrap()
                });
                (transport, thread)
            })
            .unzip();
        test(transports.iter().map(|transport| transport.address().unwrap()).collect(), open("worker"));
        stop.store(true, Ordering::Relaxed);
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

#[test]
fn remote() {
    let file = file();
    let key = SharedKey::generate().unwrap();
    let tcp = |name: &str| {
        let transport = TcpTransport::open(key.clone(), TcpOptions::loopback(name)).unwrap();
        Arc::new(transport) as Arc<dyn Transport>
    };
    let network = LocalNetwork::new();
    let local = |name: &str| Arc::new(network.open(name)) as Arc<dyn Transport>;
    let blocks = MemorySource::new(file.clone()).unwrap().model().blocks.len() as u64;
    for open in [&tcp as &(dyn Fn(&str) -> Arc<dyn Transport> + Sync), &local] {
        // With memory for everything, each block leaves the file once; without, it is read again and again.
        for (readers, memory) in [(1, Bytes::mib(32)), (3, Bytes::mib(32)), (2, Bytes(0)), (1, Bytes(9000))] {
            let counters = with_readers(open, &file, readers, memory, |addresses, transport| {
                let source = RemoteSource::open(transport, addresses, RemoteOptions::default()).unwrap();
                conforms(&source, &file);
                let counters = source.counters();
                assert_eq!((counters.from_other, counters.from_fallback, counters.damaged), (0, 0, 0));
                // Asked for in advance, a few messages bring them all.
                let all: Vec<BlockId> = (0..blocks as u32).map(BlockId).collect();
                source.will_need(&all);
                let (mut bytes, requests) = (Vec::new(), source.counters().requests);
                for block in all {
                    source.read_block(block, &mut bytes).unwrap();
                    let entry = source.model().entry(block).unwrap();
                    assert_eq!(bytes, file[entry.offset as usize..][..entry.stored_bytes as usize]);
                }
                assert_eq!(source.counters().requests, requests);
                assert!(requests - counters.requests <= readers as u64 * (blocks.div_ceil(64)));
            });
            let from_disk: u64 = counters.iter().map(|reader| reader.blocks_from_disk).sum();
            if memory == Bytes::mib(32) {
                assert_eq!(from_disk, blocks);
            } else {
                assert!(from_disk > 2 * blocks);
            }
        }
    }
}

#[test]
fn a_remote_source_falls_back() {
    let file = file();
    let network = LocalNetwork::new();
    let local = |name: &str| Arc::new(network.open(name)) as Arc<dyn Transport>;
    let (retry_after, patience) = (Duration::from_secs(3600), Duration::ZERO);
    let options = RemoteOptions { retry_after, patience, ..RemoteOptions::default() };
    let own = || Arc::new(MemorySource::new(file.clone()).unwrap());
    // Nobody there at all.
    let source = RemoteSource::beside(own(), local("a"), vec!["nobody".to_owned(), String::new()], options);
    conforms(&source, &file);
    let counters = source.counters();
    assert_eq!((counters.from_owner, counters.from_other, counters.readers_lost), (0, 0, 1));
    let gone = vec!["nobody".to_owned()];
    assert!(matches!(RemoteSource::open(local("b"), gone, options), Err(SourceError::Io { .. })));
    // One of two is gone: the other gives all.
    with_readers(&local, &file, 1, Bytes::mib(1), |mut addresses, transport| {
        addresses.push("nobody".to_owned());
        let source = RemoteSource::open(transport, addresses, options).unwrap();
        conforms(&source, &file);
        let counters = source.counters();
        assert!(counters.from_owner > 0 && counters.from_other > 0 && counters.from_fallback == 0);
    });
    // The only one goes in the middle, and the node does not have the file: an error that says so.
    let mut left = None;
    with_readers(&local, &file, 1, Bytes::mib(1), |addresses, transport| {
        let source = RemoteSource::open(transport, addresses, options).unwrap();
        source.read_block(BlockId(0), &mut Vec::new()).unwrap();
        left = Some(source);
    });
    let error = left.unwrap().read_block(BlockId(1), &mut Vec::new()).unwrap_err();
    assert!(error.to_string().contains("block 1 of the cluster's readers"), "{error}");
}

#[test]
fn a_file_that_changes_while_it_is_open_gives_typed_errors() {
    let file = file();
    for page_cache in [PageCache::Use, PageCache::Bypass] {
        let temporary = on_disk(&file);
        let source = DiskSource::open_with(temporary.path(), page_cache).unwrap();
        let model = Arc::clone(source.model());
        let mut bytes = Vec::new();
        let cut = model.blocks[5].offset + 10;
        std::fs::OpenOptions::new().write(true).open(temporary.path()).unwrap().set_len(cut).unwrap();
        source.read_block(BlockId(4), &mut bytes).unwrap();
        for block in [5, 6] {
            match source.read_block(BlockId(block), &mut bytes) {
                Err(SourceError::Truncated { what, end, .. }) => {
                    assert_eq!((what, end), (format!("block {block}"), cut));
                }
                other => panic!("{other:?}"),
            }
        }
        let mut scratch = DecodeScratch::with_limits(model.limits);
        let mut data = BlockData::with_limits(model.limits);
        std::fs::write(temporary.path(), vec![0xa5; file.len()]).unwrap();
        source.read_block(BlockId(2), &mut bytes).unwrap();
        let error = model.decode_block(BlockId(2), &bytes, &mut scratch, &mut data).unwrap_err();
        assert_eq!((error.block, data), (BlockId(2), BlockData::default()));
    }
}

#[test]
fn a_file_that_is_none_is_named() {
    let missing = DiskSource::open("there is no such file").unwrap_err();
    assert!(matches!(missing, SourceError::Io { .. }) && missing.to_string().contains("no such file"));
    let text = on_disk(b"solid this is another kind of model file\n");
    match DiskSource::open(text.path()) {
        Err(SourceError::Model { error: ModelError::NotCompiled, name }) => {
            assert_eq!(name, text.path().display().to_string());
        }
        other => panic!("{other:?}"),
    }
    // SAFETY: the file is this test's own, and nobody writes to it.
    let mapped = unsafe { MmapSource::open(text.path()) };
    assert!(matches!(mapped, Err(SourceError::Model { error: ModelError::NotCompiled, .. })));
}

#[test]
fn faults_are_seeded_and_strike_as_often_as_asked() {
    let file = file();
    let rates = FaultRates { io_errors: 0.2, short_reads: 0.2, bit_flips: 0.2 };
    let run = |seed| {
        let source = FaultySource::new(MemorySource::new(file.clone()).unwrap(), seed, rates);
        let model = Arc::clone(source.model());
        let (mut bytes, mut data) = (Vec::new(), BlockData::with_limits(model.limits));
        let mut scratch = DecodeScratch::with_limits(model.limits);
        let mut outcomes = Vec::new();
        for read in 0..20 * model.blocks.len() as u32 {
            let block = BlockId(read % model.blocks.len() as u32);
            outcomes.push(match source.read_block(block, &mut bytes) {
                Err(SourceError::Io { .. }) => 0,
                Err(other) => panic!("{other}"),
                Ok(()) => match model.decode_block(block, &bytes, &mut scratch, &mut data) {
                    Err(_) => 1,
                    Ok(()) => 2,
                },
            });
        }
        (outcomes, source.fault_count())
    };
    let (outcomes, faults) = run(1);
    assert_eq!((&outcomes, faults), (&run(1).0, run(1).1));
    assert_ne!(outcomes, run(2).0);
    let share = |kind| outcomes.iter().filter(|o| **o == kind).count() as f64 / outcomes.len() as f64;
    // 0.2 fail; of the rest 0.36 are short, flipped or both.
    assert!(
        (share(0) - 0.2).abs() < 0.08 && (share(2) - 0.8 * 0.64).abs() < 0.1,
        "{}, {}",
        share(0),
        share(2)
    );
}

#[test]
fn a_slow_source_is_slow() {
    let file = file();
    let latency = Duration::from_millis(3);
    let source = SlowSource::new(MemorySource::new(file.clone()).unwrap(), latency, Some(200_000));
    let mut bytes = Vec::new();
    let (start, mut total) = (Instant::now(), 0);
    for block in 0..4 {
        source.read_block(BlockId(block), &mut bytes).unwrap();
        total += bytes.len();
    }
    // A lower bound holds on any machine; how much longer it takes is the machine's affair.
    assert!(start.elapsed() >= 4 * latency + Duration::from_secs_f64(total as f64 / 200_000.0) - latency);
}
