//! Coordinator, workers and readers as real processes over TCP, killed with `kill -9` in mid-render.
//!
//! The processes are this test program itself, told by an environment variable which role to play.
#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use outcrop::MemoryBudget;
use outcrop::cluster::{Checkpoint, Coordinator, Reader, run_coordinator, run_reader, run_worker};
use outcrop::compile::Control;
use outcrop::source::DiskSource;
use outcrop::source::testing::SlowSource;
use outcrop::transport::{SharedKey, TcpOptions, TcpTransport, Transport};
use outcrop::units::Bytes;

use super::support::{coordinator_options, job, model_bytes, quick_roles, reference, worker_options};

const PATIENCE: Duration = Duration::from_secs(60);

fn variable(name: &str) -> String {
    std::env::var(name).unwrap()
}

/// Not a test: what the processes run. Does nothing when it is run as one.
#[test]
fn node() {
    let Ok(role) = std::env::var("OUTCROP_TEST_ROLE") else { return };
    let key = SharedKey::from_environment().unwrap().unwrap();
    let (path, address) = (variable("OUTCROP_TEST_FILE"), variable("OUTCROP_TEST_ADDRESS"));
    let stop = AtomicBool::new(false);
    let mut log = |line: &str| eprintln!("{role}: {line}");
    match role.as_str() {
        "coordinator" => {
            let options = TcpOptions { listen: Some(address), ..TcpOptions::loopback("coordinator") };
            let hub = TcpTransport::open(key, options).unwrap();
            let folder = variable("OUTCROP_TEST_FOLDER");
            let checkpoint = Path::new(&folder).join("checkpoint");
            let budget = MemoryBudget::new(Bytes::mib(64));
            let probe = Coordinator::new(job(), coordinator_options(3, 2), &budget).unwrap();
            let (checkpoint, records) = Checkpoint::open(&checkpoint, probe.job_digest()).unwrap();
            drop(probe);
            println!("records {}", records.len());
            let coordinator =
                Coordinator::restore(job(), coordinator_options(3, 2), records, &budget).unwrap();
            println!("restored {}", coordinator.progress().cells_done);
            println!("address {}", hub.address().unwrap());
            let mut told = 0;
            let mut observe = |coordinator: &Coordinator, lines: &[String]| {
                lines.iter().for_each(|line| eprintln!("coordinator: {line}"));
                let done = coordinator.progress().cells_done;
                if done != told {
                    told = done;
                    println!("done {done}");
                }
                Control::Continue
            };
            let done = run_coordinator(&hub, coordinator, Some(checkpoint), PATIENCE, &mut observe).unwrap();
            done.film().write(Path::new(&folder).join("picture.pfm")).unwrap();
            println!("finished {}", done.progress().cells_done);
        }
        "worker" => {
            let control = TcpTransport::open(key.clone(), TcpOptions::connecting("worker")).unwrap();
            let data: Arc<dyn Transport> =
                Arc::new(TcpTransport::open(key, TcpOptions::connecting("data")).unwrap());
            // Slow enough that there is a middle of the render to be killed in.
            let file = SlowSource::new(DiskSource::open(&path).unwrap(), Duration::from_millis(3), None);
            let options = worker_options("worker", 1, Some(Arc::new(file)));
            run_worker(&control, &data, &address, &options, &stop, &mut log).unwrap();
        }
        _ => {
            let transport = TcpTransport::open(key, TcpOptions::loopback("reader")).unwrap();
            let own = transport.address().unwrap();
            let budget = MemoryBudget::new(Bytes::mib(16));
            let file = Arc::new(DiskSource::open(&path).unwrap());
            let reader = Reader::new(file, "reader", &own, Bytes::mib(8), &budget, quick_roles()).unwrap();
            run_reader(&transport, reader, &address, PATIENCE, &stop, &mut log).unwrap();
        }
    }
}

struct Cluster {
    folder: tempfile::TempDir,
    key: String,
    address: String,
    children: Vec<Child>,
}

/// None survives the test.
impl Drop for Cluster {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Cluster {
    fn new() -> Cluster {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("model.outcrop"), &model_bytes()[..]).unwrap();
        // A port that was free a moment ago; the coordinator must come back to the same one.
        let probe = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = probe.local_addr().unwrap().to_string();
        Cluster { folder, key: SharedKey::generate().unwrap().to_hex(), address, children: Vec::new() }
    }

    fn spawn(&mut self, role: &str, output: Stdio) -> usize {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["processes::node", "--exact", "--nocapture", "--test-threads=1"])
            .env("OUTCROP_TEST_ROLE", role)
            .env("OUTCROP_TEST_ADDRESS", &self.address)
            .env("OUTCROP_TEST_FOLDER", self.folder.path())
            .env("OUTCROP_TEST_FILE", self.folder.path().join("model.outcrop"))
            .env(SharedKey::VARIABLE, &self.key)
            .stdout(output)
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        self.children.push(child);
        self.children.len() - 1
    }

    fn coordinator(&mut self) -> (usize, Receiver<(String, u64)>) {
        let index = self.spawn("coordinator", Stdio::piped());
        let output = BufReader::new(self.children[index].stdout.take().unwrap());
        let (lines_in, lines) = mpsc::channel();
        thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                if let Some((what, number)) = line.split_once(' ')
                    && let Ok(number) = number.parse()
                    && lines_in.send((what.to_owned(), number)).is_err()
                {
                    return;
                }
            }
        });
        (index, lines)
    }

    /// `kill -9`.
    fn kill(&mut self, index: usize) {
        self.children[index].kill().unwrap();
        self.children[index].wait().unwrap();
    }
}

/// Waits for a line `what` with a number of at least `least`.
fn wait_for(lines: &Receiver<(String, u64)>, what: &str, least: u64) -> u64 {
    let deadline = Instant::now() + Duration::from_secs(240);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let (found, number) = lines.recv_timeout(left).unwrap_or_else(|_| panic!("no `{what} {least}` came"));
        if found == what && number >= least {
            return number;
        }
    }
}

fn picture(cluster: &Cluster) {
    // A PFM holds its rows from below.
    let bytes = std::fs::read(cluster.folder.path().join("picture.pfm")).unwrap();
    let data = &bytes[bytes.len() - reference().len() * 12..];
    let width = super::support::settings().width as usize;
    let mut rows: Vec<&[u8]> = data.chunks_exact(width * 12).collect();
    rows.reverse();
    let expected: Vec<u8> = reference().iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    assert!(rows.concat() == expected, "the picture is another one");
}

#[test]
fn killed_processes_do_not_show() {
    let mut cluster = Cluster::new();
    let (first, lines) = cluster.coordinator();
    let workers = [(); 3].map(|()| cluster.spawn("worker", Stdio::null()));
    let readers = [(); 2].map(|()| cluster.spawn("reader", Stdio::null()));
    wait_for(&lines, "done", 20);
    cluster.kill(workers[0]);
    wait_for(&lines, "done", 60);
    cluster.kill(readers[1]);
    let done = wait_for(&lines, "done", 120);
    // What was done more than a second ago is safe.
    thread::sleep(Duration::from_millis(1500));
    cluster.kill(first);
    let (_, lines) = cluster.coordinator();
    let restored = wait_for(&lines, "restored", 0);
    assert!(restored >= done.min(100), "{restored} of {done} cells were restored");
    // A worker joins late.
    cluster.spawn("worker", Stdio::null());
    let cells = wait_for(&lines, "finished", 1);
    assert_eq!(cells, 26 * 18);
    picture(&cluster);
}
