//! Normals of models at workers that have no more than a copy of the file.

use std::fmt::Write;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::Duration;

use outcrop::cluster::{CopyOptions, FileCopy, ModelFile, Reader, RemoteOptions, RemoteSource, run_reader};
use outcrop::compile::{CompileOptions, Control, compile_file};
use outcrop::error::SourceError;
use outcrop::model::Model;
use outcrop::source::MemorySource;
use outcrop::transport::{LocalNetwork, Transport};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use super::support::quick_roles;

/// A compiled file with normals in several pages.
fn file() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let (input, output) = (folder.path().join("a.obj"), folder.path().join("a.outcrop"));
    let mut text = String::new();
    for i in 0..5000 {
        let normal = f64::from(i * 7919 % 10_007) / 10_007.0;
        writeln!(text, "v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nvn {normal} 1 1").unwrap();
        writeln!(text, "f {}//{n} {}//{n} {}//{n}", 3 * i + 1, 3 * i + 2, 3 * i + 3, n = i + 1).unwrap();
    }
    std::fs::write(&input, text).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_file(&input, &output, &CompileOptions::default(), &budget, &mut |_| Control::Continue).unwrap();
    std::fs::read(output).unwrap()
}

/// A file that gives the first page damaged, the first time.
struct Shaky {
    whole: MemorySource,
    damaged: AtomicU32,
}

impl BlockSource for Shaky {
    fn model(&self) -> &Arc<Model> {
        self.whole.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.whole.read_block(block, into)
    }
}

impl ModelFile for Shaky {
    fn file_bytes(&self) -> io::Result<u64> {
        self.whole.file_bytes()
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        self.whole.read_range(offset, into)?;
        let page = self.model().attributes.entries()[0].offset;
        if (offset..offset + into.len() as u64).contains(&page)
            && self.damaged.fetch_add(1, Ordering::Relaxed) == 0
        {
            into[(page - offset) as usize] ^= 8;
        }
        Ok(())
    }
}

#[test]
fn a_copy_has_sound_pages_and_gives_them() {
    let network = LocalNetwork::new();
    let bytes = file();
    let whole = MemorySource::new(bytes.clone()).unwrap();
    let pages = whole.model().attributes.entries().len() as u32;
    assert!(pages > 1);
    let shaky =
        Arc::new(Shaky { whole: MemorySource::new(bytes.clone()).unwrap(), damaged: AtomicU32::new(0) });
    let (over, never) = (AtomicBool::new(false), AtomicBool::new(false));
    let hub = network.open("coordinator");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("copy");
    let copy = thread::scope(|scope| {
        let (node, budget) = (network.open("reader"), MemoryBudget::new(Bytes::mib(16)));
        let address = node.address().unwrap();
        let reader =
            Reader::new(shaky.clone(), "reader", &address, Bytes(0), &budget, quick_roles()).unwrap();
        let over = &over;
        let patience = Duration::from_secs(120);
        scope.spawn(move || run_reader(&node, reader, "coordinator", patience, over, &mut |_| {}).unwrap());
        let options = CopyOptions::new(&path, Arc::new(network.open("copy")));
        let options = CopyOptions { retry_after: Duration::from_millis(5), ..options };
        let copy = FileCopy::new(Arc::clone(whole.model()), options);
        let result = copy.run(&|| vec!["reader".to_owned()], &never).unwrap().unwrap();
        assert_eq!(copy.counters().damaged, 1);
        over.store(true, Ordering::Relaxed);
        result
    });
    hub.close();
    assert!(std::fs::read(&path).unwrap() == bytes);

    let copy: Arc<dyn BlockSource> = Arc::new(copy);
    let (readers, options) = (vec!["nobody".to_owned()], RemoteOptions::default());
    let data = |name| Arc::new(network.open(name)) as Arc<dyn Transport>;
    let with_copy = RemoteSource::with_copy(Arc::clone(&copy), data("a"), readers.clone(), options);
    let beside = RemoteSource::beside(Arc::clone(&copy), data("b"), readers, options);
    for source in [with_copy, beside] {
        assert!(source.gives_attributes());
        for page in 0..pages {
            let (mut read, mut expected) = (Vec::new(), Vec::new());
            source.read_attributes(page, &mut read).unwrap();
            whole.read_attributes(page, &mut expected).unwrap();
            assert_eq!(read, expected);
        }
    }
}
