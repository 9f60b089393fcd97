//! Workers that make themselves a copy of the compiled file while they render.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use outcrop::cluster::{
    Coordinator, CopyCounters, CopyError, CopyOptions, FileCopy, ModelFile, Reader, WorkerReport,
    run_coordinator, run_reader, run_worker,
};
use outcrop::compile::Control;
use outcrop::error::SourceError;
use outcrop::model::Model;
use outcrop::source::{DiskSource, MemorySource};
use outcrop::transport::{LocalNetwork, SharedKey, Transport};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use super::support::{coordinator_options, job, model, model_bytes, quick_roles, reference, worker_options};
use super::threads::{Network, Tcp};

const PATIENCE: Duration = Duration::from_secs(120);

/// A file that gives only so many blocks before there is a complete copy, and does something to what it gives of the file.
struct Tampered<R> {
    whole: MemorySource,
    blocks_left: AtomicU64,
    /// Blocks are given again when this is there, and nothing of them as parts of the file before the first block was given.
    until: Option<PathBuf>,
    blocks_given: AtomicU64,
    /// Number of the request, the bytes.
    ranges: AtomicU64,
    range: R,
}

impl<R: Fn(u64, &mut [u8]) -> io::Result<()> + Send + Sync> Tampered<R> {
    fn new(range: R) -> Tampered<R> {
        let (blocks_left, blocks_given, ranges) =
            (AtomicU64::new(u64::MAX), AtomicU64::new(0), AtomicU64::new(0));
        Tampered { whole: model(), blocks_left, until: None, blocks_given, ranges, range }
    }
}

impl<R: Fn(u64, &mut [u8]) -> io::Result<()> + Send + Sync> BlockSource for Tampered<R> {
    fn model(&self) -> &Arc<Model> {
        self.whole.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        let left = self.blocks_left.load(Ordering::Relaxed);
        if left == 0 && !self.until.as_ref().is_some_and(|path| path.exists()) {
            let error = io::Error::other("not before there is a copy");
            return Err(SourceError::Io { what: "a block".to_owned(), name: "test".to_owned(), error });
        }
        self.blocks_left.store(left.saturating_sub(1), Ordering::Relaxed);
        self.blocks_given.fetch_add(1, Ordering::Relaxed);
        self.whole.read_block(block, into)
    }
}

impl<R: Fn(u64, &mut [u8]) -> io::Result<()> + Send + Sync> ModelFile for Tampered<R> {
    fn file_bytes(&self) -> io::Result<u64> {
        self.whole.file_bytes()
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        let blocks = &self.model().blocks;
        let is_of_blocks = (blocks[0].offset..=blocks[blocks.len() - 1].offset).contains(&offset);
        if self.until.is_some() && is_of_blocks && self.blocks_given.load(Ordering::Relaxed) == 0 {
            return Err(io::Error::other("not before a block was needed"));
        }
        self.whole.read_range(offset, into)?;
        (self.range)(self.ranges.fetch_add(1, Ordering::Relaxed), into)
    }
}

fn honest() -> Tampered<impl Fn(u64, &mut [u8]) -> io::Result<()> + Send + Sync> {
    Tampered::new(|_, _: &mut [u8]| Ok(()))
}

fn reader(file: Arc<dyn ModelFile>, transport: &dyn Transport) -> Reader {
    let budget = MemoryBudget::new(Bytes::mib(16));
    let address = transport.address().unwrap();
    // It keeps nothing, so that the file decides what it gives.
    Reader::new(file, "reader", &address, Bytes(0), &budget, quick_roles()).unwrap()
}

/// Renders with one reader of `file` and one worker that has nothing but `copy`.
fn render(network: &dyn Network, file: Arc<dyn ModelFile>, copy: &Path) -> (WorkerReport, Vec<String>) {
    let hub = network.open("coordinator");
    let address = hub.address().unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    let coordinator = Coordinator::new(job(), coordinator_options(1, 1), &budget).unwrap();
    let never = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let transport = network.open("reader");
            let reader = reader(file, &*transport);
            run_reader(&*transport, reader, &address, PATIENCE, &never, &mut |_| {}).unwrap()
        });
        let worker = scope.spawn(|| {
            let (control, data) = (network.open("worker"), network.open("data"));
            let copy = CopyOptions::new(copy, network.open("copy"));
            let mut options = worker_options("worker", 2, None);
            options.copy = Some(CopyOptions { retry_after: Duration::from_millis(10), ..copy });
            let mut lines = Vec::new();
            let mut log = |line: &str| lines.push(line.to_owned());
            let report = run_worker(&*control, &data, &address, &options, &never, &mut log).unwrap();
            (report, lines)
        });
        let mut observe = |_: &Coordinator, _: &[String]| Control::Continue;
        let done = run_coordinator(&*hub, coordinator, None, PATIENCE, &mut observe).unwrap();
        assert!(done.film().pixels() == &reference()[..], "the picture is another one");
        hub.close();
        worker.join().unwrap()
    })
}

/// The picture cannot be finished without the copy, so it is made while the worker renders, and then used.
fn renders_on_from_its_copy(network: &dyn Network) {
    let folder = tempfile::tempdir().unwrap();
    // The folder is made, too.
    let path = folder.path().join("deep/model.outcrop");
    let mut file = honest();
    (file.blocks_left, file.until) = (AtomicU64::new(5), Some(path.clone()));
    let (report, lines) = render(network, Arc::new(file), &path);
    let copy = report.copy.unwrap();
    let blocks = model().model().blocks.len() as u64;
    assert_eq!((copy.blocks_kept, copy.blocks_fetched, copy.damaged), (0, blocks, 0));
    assert!(copy.is_complete);
    let remote = report.remote.unwrap();
    assert!(remote.from_owner >= 1 && remote.from_copy > 0, "{remote:?}");
    assert!(lines.iter().any(|line| line.contains("is complete")), "{lines:?}");
    assert_eq!(fs::read(&path).unwrap(), &model_bytes()[..]);
    assert!(!folder.path().join("deep/model.outcrop.part").exists());
    // The next time it is there from the beginning.
    let (report, _) = render(&LocalNetwork::new(), Arc::new(honest()), &path);
    let remote = report.remote.unwrap();
    assert_eq!((report.copy, remote.from_owner, remote.from_other), (None, 0, 0));
    assert!(remote.from_copy > 0);
    // And if it is damaged, readers help.
    let mut bytes = model_bytes().to_vec();
    model().model().blocks.iter().for_each(|entry| bytes[entry.offset as usize + 70] ^= 1);
    fs::write(&path, bytes).unwrap();
    let (report, _) = render(&LocalNetwork::new(), Arc::new(honest()), &path);
    let remote = report.remote.unwrap();
    assert!(remote.from_copy == 0 && remote.damaged > 0 && remote.from_owner > 0, "{remote:?}");
}

#[test]
fn a_worker_renders_on_from_its_copy_in_one_process() {
    renders_on_from_its_copy(&LocalNetwork::new());
}

#[test]
fn a_worker_renders_on_from_its_copy_over_tcp() {
    renders_on_from_its_copy(&Tcp(SharedKey::generate().unwrap()));
}

/// Makes a copy from a reader of `file`. `cut` ends it from within.
fn copy(
    file: Arc<dyn ModelFile>,
    path: &Path,
    cut: &AtomicBool,
) -> (Result<Option<DiskSource>, CopyError>, CopyCounters) {
    let network = LocalNetwork::new();
    // A coordinator that only listens.
    let hub = network.open("coordinator");
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        let node = network.open("reader");
        let reader = reader(file, &node);
        let over = &over;
        scope.spawn(move || run_reader(&node, reader, "coordinator", PATIENCE, over, &mut |_| {}).unwrap());
        let options = CopyOptions::new(path, Arc::new(network.open("copy")));
        // Small pieces, so that there is a middle.
        let options = CopyOptions { retry_after: Duration::from_millis(5), piece_bytes: 2 << 10, ..options };
        let copy = FileCopy::new(Arc::clone(model().model()), options);
        // A node that is not there is passed over.
        let nodes = || vec![String::new(), "nobody".to_owned(), "reader".to_owned()];
        let result = copy.run(&nodes, cut);
        over.store(true, Ordering::Relaxed);
        hub.close();
        (result, copy.counters())
    })
}

#[test]
fn a_copy_that_was_cut_goes_on_from_what_is_sound() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("model"), folder.path().join("model.part"));
    let blocks = model().model().blocks.len() as u64;
    let never = AtomicBool::new(false);
    let mut kept_before = 0;
    // The node dies after one more piece each time; the first request only asks for the length.
    for pieces in [2, 4] {
        let cut = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&cut);
        let file = Tampered::new(move |request, _: &mut [u8]| {
            if request > pieces {
                flag.store(true, Ordering::Relaxed);
                return Err(io::Error::other("dead"));
            }
            Ok(())
        });
        let (result, counters) = copy(Arc::new(file), &path, &cut);
        assert!(matches!(result, Ok(None)), "{result:?}");
        assert_eq!(counters.blocks_kept, kept_before);
        assert!(counters.blocks_fetched > 0 && !counters.is_complete && !path.exists(), "{counters:?}");
        // Something happens to the last block before the next attempt.
        let sound = counters.blocks_kept + counters.blocks_fetched;
        assert!(sound < blocks, "the model is too small to be cut: {blocks} blocks, {counters:?}");
        let last = model().model().blocks[sound as usize - 1].offset;
        let mut bytes = fs::read(&part).unwrap();
        bytes[last as usize + 3] ^= 16;
        fs::write(&part, bytes).unwrap();
        kept_before = sound - 1;
    }
    // Flipped bytes on the way, in blocks, directory and header.
    let file = Tampered::new(|request, bytes: &mut [u8]| {
        // Not for ever, whatever the length of an attempt.
        if request % 7 == 2 && request < 200 {
            let middle = bytes.len() / 2;
            bytes[middle] ^= 4;
        }
        Ok(())
    });
    let (result, counters) = copy(Arc::new(file), &path, &never);
    assert!(matches!(result, Ok(Some(_))), "{result:?}");
    assert_eq!((counters.blocks_kept, counters.is_complete), (kept_before, true));
    assert!(counters.damaged > 0 && counters.nodes_lost > 0, "{counters:?}");
    assert_eq!(fs::read(&path).unwrap(), &model_bytes()[..]);
    assert!(!part.exists());
    // Once more there is nothing to do.
    let (result, counters) = copy(Arc::new(honest()), &path, &never);
    assert!(matches!(result, Ok(Some(_))));
    assert_eq!(counters, CopyCounters { is_complete: true, ..CopyCounters::default() });
}

#[test]
fn a_longer_leftover_of_another_model_does_not_stay() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    fs::write(folder.path().join("model.part"), vec![7; model_bytes().len() + 100_000]).unwrap();
    let (result, counters) = copy(Arc::new(honest()), &path, &AtomicBool::new(false));
    assert!(matches!(result, Ok(Some(_))), "{result:?}");
    assert_eq!(counters.blocks_kept, 0);
    assert_eq!(fs::read(&path).unwrap(), &model_bytes()[..]);
}

#[test]
fn another_file_of_that_name_and_another_process_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    fs::write(&path, "somebody's notes").unwrap();
    let never = AtomicBool::new(false);
    let (result, _) = copy(Arc::new(honest()), &path, &never);
    assert!(matches!(result, Err(CopyError::OtherFile { .. })), "{result:?}");
    assert_eq!(fs::read(&path).unwrap(), b"somebody's notes");
    // A render goes on without the copy.
    let (report, lines) = render(&LocalNetwork::new(), Arc::new(honest()), &path);
    assert!(!report.copy.unwrap().is_complete);
    assert!(lines.iter().any(|line| line.contains("going on without a copy")), "{lines:?}");
    assert_eq!(fs::read(&path).unwrap(), b"somebody's notes");

    let path = folder.path().join("busy");
    let part = fs::File::create(folder.path().join("busy.part")).unwrap();
    part.lock().unwrap();
    let (result, _) = copy(Arc::new(honest()), &path, &never);
    assert!(matches!(result, Err(CopyError::Busy { .. })), "{result:?}");
    part.unlock().unwrap();
    let (result, _) = copy(Arc::new(honest()), &path, &never);
    assert!(matches!(result, Ok(Some(_))), "{result:?}");
}

/// A device that is always full stands for the disk.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_nothing_and_the_render_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (folder.path().join("model"), folder.path().join("model.part"));
    let full = || std::os::unix::fs::symlink("/dev/full", &part).unwrap();
    full();
    let (result, _) = copy(Arc::new(honest()), &path, &AtomicBool::new(false));
    let is_full = |error: &io::Error| error.kind() == io::ErrorKind::StorageFull;
    assert!(matches!(&result, Err(CopyError::Disk { error, .. }) if is_full(error)), "{result:?}");
    assert!(fs::symlink_metadata(&part).is_err() && !path.exists());
    full();
    let (report, lines) = render(&LocalNetwork::new(), Arc::new(honest()), &path);
    assert!(!report.copy.unwrap().is_complete);
    assert!(report.remote.unwrap().from_owner > 0);
    assert!(lines.iter().any(|line| line.contains("going on without a copy")), "{lines:?}");
}
