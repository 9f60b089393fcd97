//! Latency and bandwidth of each transport by message size, beside the disk's.
//!
//! One node asks, as a worker asks a reader for a block, and the other answers with so many bytes. *Latency* is the median time
//! from the question to the whole answer, one at a time; *bandwidth* is that of answers with eight questions on their way (two for
//! a megabyte). Every answer is compared with what it has to be.

use std::error::Error;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::procedural::Gears;
use outcrop::source::{DiskSource, PageCache};
use outcrop::transport::{
    LocalNetwork, PeerId, SharedKey, TcpOptions, TcpTransport, Transport, TransportEvent,
};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use crate::Options;

const SIZES: [usize; 7] = [64, 1 << 10, 4 << 10, 16 << 10, 64 << 10, 256 << 10, 1 << 20];
/// Questions on their way at one time, when bandwidth is measured: as many as there is certainly room for the answers, at most eight.
const DEPTH: usize = 8;
fn depth(size: usize) -> usize {
    ((2 << 20) / size).clamp(1, DEPTH)
}
const PATIENCE: Duration = Duration::from_secs(30);

/// One row of the table: seconds and bytes per second by size; `None` where there is no such size.
struct Row {
    name: String,
    cells: Vec<Option<(f64, f64)>>,
}

pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let seconds = if options.is_quick { 0.02 } else { 0.5 };
    #[cfg(feature = "mpi")]
    if options.part.as_deref() == Some("rank") {
        return mpi::rank(seconds);
    }
    let mut rows = Vec::new();
    {
        let network = LocalNetwork::new();
        let (asker, server) = (network.open("asker"), network.open("server"));
        rows.push(measure("channels (one process)", asker, server, seconds)?);
    }
    {
        let key = SharedKey::generate()?;
        let asker = TcpTransport::open(key.clone(), TcpOptions::connecting("asker"))?;
        let server = TcpTransport::open(key, TcpOptions::loopback("server"))?;
        rows.push(measure("TCP, encrypted (loopback)", asker, server, seconds)?);
    }
    #[cfg(feature = "mpi")]
    rows.push(mpi::row(options)?);
    let (row, stored) = disk(seconds)?;
    rows.push(row);

    let head: Vec<String> = SIZES.iter().map(|size| Bytes(*size as u64).to_string()).collect();
    println!("| | {} |", head.join(" | "));
    println!("|---|{}", "---|".repeat(SIZES.len()));
    for row in &rows {
        let cells = |text: &dyn Fn((f64, f64)) -> String| {
            let cells: Vec<String> = row.cells.iter().map(|cell| cell.map_or(String::new(), text)).collect();
            cells.join(" | ")
        };
        println!("| {}: us | {} |", row.name, cells(&|(latency, _)| format!("{:.1}", latency * 1e6)));
        println!("| MB/s | {} |", cells(&|(_, rate)| format!("{:.0}", rate * 1e-6)));
    }
    let stored: Vec<String> =
        stored.iter().map(|bytes| bytes.map_or(String::new(), |bytes| format!("{bytes:.0}"))).collect();
    println!("| stored bytes of such a block, mean | {} |", stored.join(" | "));
    if !cfg!(feature = "mpi") {
        println!("(built without --features mpi)");
    }
    println!("every answer was compared with what it had to be");
    Ok(())
}

/// Where answers are cut from; each question says from which place.
fn pattern() -> Vec<u8> {
    (0..SIZES[SIZES.len() - 1] + 256).map(|i| (i * 31 + i / 251) as u8).collect()
}

/// Answers questions until the asker is gone.
fn serve(transport: &dyn Transport) -> Result<(), String> {
    let pattern = pattern();
    loop {
        match transport.receive(PATIENCE) {
            Ok(Some(TransportEvent::Frame { peer, bytes })) => {
                let question = <[u8; 5]>::try_from(bytes.as_slice()).map_err(|_| "not a question")?;
                let [a, b, c, d, start] = question;
                let length = u32::from_le_bytes([a, b, c, d]) as usize;
                let start = usize::from(start);
                let answer = pattern.get(start..start + length).ok_or("too much is asked for")?.to_vec();
                transport.send(peer, answer).map_err(|error| error.to_string())?;
            }
            Ok(Some(TransportEvent::Disconnected { .. })) => return Ok(()),
            Ok(Some(_)) => {}
            Ok(None) => return Err("nobody asks".to_owned()),
            Err(error) => return Err(error.to_string()),
        }
    }
}

fn measure(
    name: &str,
    asker: impl Transport + 'static,
    server: impl Transport + 'static,
    seconds: f64,
) -> Result<Row, Box<dyn Error>> {
    let address = server.address().ok_or("the server has no address")?;
    thread::scope(|scope| {
        let serving = scope.spawn(|| serve(&server));
        let peer = asker.connect(&address)?;
        let row = ask_all(name, &asker, peer, seconds);
        asker.disconnect(peer);
        serving.join().map_err(|_| "the server panicked")??;
        row
    })
}

fn ask_all(name: &str, asker: &dyn Transport, peer: PeerId, seconds: f64) -> Result<Row, Box<dyn Error>> {
    let mut asker = Asker { transport: asker, peer, pattern: pattern(), asked: 0, answered: 0 };
    let mut cells = Vec::new();
    for size in SIZES {
        // Caches, and the network's own state.
        for _ in 0..20 {
            asker.ask(size)?;
            asker.take(size)?;
        }
        let (mut times, start) = (Vec::new(), Instant::now());
        while start.elapsed().as_secs_f64() < seconds || times.len() < 5 {
            let start = Instant::now();
            asker.ask(size)?;
            asker.take(size)?;
            times.push(start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let latency = times[times.len() / 2];
        let (mut count, start) = (0, Instant::now());
        for _ in 0..depth(size) {
            asker.ask(size)?;
        }
        while start.elapsed().as_secs_f64() < seconds || count < 5 {
            asker.take(size)?;
            asker.ask(size)?;
            count += 1;
        }
        let rate = (count * size) as f64 / start.elapsed().as_secs_f64();
        for _ in 0..depth(size) {
            asker.take(size)?;
        }
        cells.push(Some((latency, rate)));
    }
    Ok(Row { name: name.to_owned(), cells })
}

struct Asker<'a> {
    transport: &'a dyn Transport,
    peer: PeerId,
    pattern: Vec<u8>,
    asked: u64,
    answered: u64,
}

impl Asker<'_> {
    fn ask(&mut self, size: usize) -> Result<(), Box<dyn Error>> {
        let mut question = (size as u32).to_le_bytes().to_vec();
        question.push(self.asked as u8);
        self.asked += 1;
        Ok(self.transport.send(self.peer, question)?)
    }

    fn take(&mut self, size: usize) -> Result<(), Box<dyn Error>> {
        match self.transport.receive(PATIENCE)? {
            Some(TransportEvent::Frame { bytes, .. }) => {
                let start = usize::from(self.answered as u8);
                self.answered += 1;
                if bytes != self.pattern[start..start + size] {
                    return Err(format!("answer {} is wrong", self.answered).into());
                }
                Ok(())
            }
            other => Err(format!("instead of an answer came {other:?}").into()),
        }
    }
}

/// Stored bytes of a block on average, by size.
type Means = Vec<Option<f64>>;

/// Blocks of the sizes that blocks can have, raw, from a file of this folder past the page cache.
/// Also gives the mean of their stored bytes: the size is that of a block when it is decoded.
fn disk(seconds: f64) -> Result<(Row, Means), Box<dyn Error>> {
    let folder = tempfile::tempdir_in(".")?;
    let budget = MemoryBudget::new(Bytes::mib(512));
    let gears = Gears::new(3)?;
    let (mut cells, mut means) = (Vec::new(), Vec::new());
    for size in SIZES {
        let block_bytes = size as u32;
        if !(4 << 10..=256 << 10).contains(&block_bytes) {
            cells.push(None);
            means.push(None);
            continue;
        }
        let path = folder.path().join(format!("{size}.outcrop"));
        let options = CompileOptions { block_bytes, codec: Codec::Raw, ..CompileOptions::default() };
        compile_shape(&gears, &path, &options, &budget, &mut |_| Control::Continue)?;
        std::fs::File::open(&path)?.sync_all()?;
        let source = Arc::new(DiskSource::open_with(&path, PageCache::Bypass)?);
        // Not in the order of the file.
        let count = source.model().blocks.len();
        let order: Vec<u32> = (0..count).map(|i| (i * 7919 % count) as u32).collect();
        let stored = source.model().blocks.iter().map(|entry| f64::from(entry.stored_bytes)).sum::<f64>();
        let mut times = Vec::new();
        let start = Instant::now();
        let mut bytes = Vec::new();
        for block in order.iter().cycle() {
            if start.elapsed().as_secs_f64() >= seconds && times.len() >= 5 {
                break;
            }
            let start = Instant::now();
            read(&source, *block, &mut bytes)?;
            times.push(start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        // Eight threads keep as many reads on their way.
        let start = Instant::now();
        let read_bytes = thread::scope(|scope| {
            let threads: Vec<_> = (0..DEPTH)
                .map(|first| {
                    let (source, order) = (&source, &order);
                    scope.spawn(move || {
                        let (mut bytes, mut sum) = (Vec::new(), 0usize);
                        for block in order.iter().cycle().skip(first * count / DEPTH) {
                            if start.elapsed().as_secs_f64() >= seconds && sum > 0 {
                                break;
                            }
                            read(source, *block, &mut bytes).map_err(|error| error.to_string())?;
                            sum += bytes.len();
                        }
                        Ok::<usize, String>(sum)
                    })
                })
                .collect();
            let sums =
                threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Err("a panic".to_owned())));
            sums.sum::<Result<usize, String>>()
        })?;
        let rate = read_bytes as f64 / start.elapsed().as_secs_f64();
        means.push(Some(stored / count as f64));
        cells.push(Some((times[times.len() / 2], rate)));
    }
    Ok((Row { name: "disk, past the page cache (blocks that decode to that size)".to_owned(), cells }, means))
}

fn read(source: &DiskSource, block: u32, bytes: &mut Vec<u8>) -> Result<(), Box<dyn Error>> {
    source.read_block(BlockId(block), bytes)?;
    let expected = source.model().entry(BlockId(block)).map(|entry| entry.checksum);
    if expected != Some(outcrop::block::checksum(bytes)) {
        return Err(format!("block {block} is wrong").into());
    }
    Ok(())
}

#[cfg(feature = "mpi")]
mod mpi {
    use std::process::Command;

    use outcrop::transport::MpiJob;

    use super::{Error, Options, Row, SIZES, Transport, ask_all, serve};

    /// Starts this program as two ranks and takes what rank 0 measured.
    pub fn row(options: &Options) -> Result<Row, Box<dyn Error>> {
        let mut command =
            Command::new(std::env::var("OUTCROP_MPIRUN").unwrap_or_else(|_| "mpirun".to_owned()));
        command.args(["-n", "2"]).arg(std::env::current_exe()?).args(["transports", "--part", "rank"]);
        if options.is_quick {
            command.arg("--quick");
        }
        // Open MPI: also for the superuser of a container, and with other work on the machine.
        for variable in
            ["OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe"]
        {
            command.env(variable, "1");
        }
        let output = command.output()?;
        if !output.status.success() {
            return Err(format!("mpirun: {}", String::from_utf8_lossy(&output.stderr)).into());
        }
        let text = String::from_utf8(output.stdout)?;
        let mut cells = Vec::new();
        for line in text.lines() {
            let Some((latency, rate)) = line.strip_prefix("cell ").and_then(|cell| cell.split_once(' '))
            else {
                continue;
            };
            cells.push(Some((latency.parse()?, rate.parse()?)));
        }
        if cells.len() != SIZES.len() {
            return Err(format!("not all sizes were measured: {text}").into());
        }
        Ok(Row { name: "MPI (two processes)".to_owned(), cells })
    }

    pub fn rank(seconds: f64) -> Result<(), Box<dyn Error>> {
        let job = MpiJob::start()?;
        let result = part(&job, seconds);
        if let Err(error) = &result {
            eprintln!("rank {}: {error}", job.rank());
            job.abort(1);
        }
        result
    }

    fn part(job: &MpiJob, seconds: f64) -> Result<(), Box<dyn Error>> {
        let node = job.open("node");
        job.barrier();
        if job.rank() > 0 {
            return Ok(serve(&node)?);
        }
        let peer = node.connect(&MpiJob::address_of(1, "node"))?;
        let row = ask_all("", &node, peer, seconds)?;
        for (latency, rate) in row.cells.into_iter().flatten() {
            println!("cell {latency} {rate}");
        }
        Ok(())
    }
}
