//! Memory over time: a thread that samples, a table and a plot.

use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use outcrop::MemoryBudget;
use outcrop::units::Bytes;

use super::plot::{Line, plot_svg};
use super::process::ProcessMemory;

const INTERVAL: Duration = Duration::from_millis(20);

/// One look at the process.
#[derive(Clone, Copy)]
struct Sample {
    seconds: f64,
    memory: ProcessMemory,
    reserved: Bytes,
}

/// Samples in the background until it is finished.
pub struct MemoryLog {
    path: PathBuf,
    limit: Bytes,
    stop: mpsc::Sender<()>,
    thread: JoinHandle<Vec<Sample>>,
}

impl MemoryLog {
    /// Starts to sample this process and the reservations in `budget`.
    pub fn start(path: PathBuf, budget: &MemoryBudget) -> MemoryLog {
        let (stop, stopped) = mpsc::channel();
        let (limit, budget) = (budget.limit(), budget.clone());
        let thread = thread::spawn(move || {
            let start = Instant::now();
            let mut samples = Vec::new();
            loop {
                if let Some(memory) = ProcessMemory::now() {
                    samples.push(Sample {
                        seconds: start.elapsed().as_secs_f64(),
                        memory,
                        reserved: budget.used(),
                    });
                }
                if stopped.recv_timeout(INTERVAL) != Err(RecvTimeoutError::Timeout) {
                    return samples;
                }
            }
        });
        MemoryLog { path, limit, stop, thread }
    }

    /// Stops, and writes the samples as CSV and as a plot beside it with the extension `svg`.
    pub fn finish(self) -> Result<(), Box<dyn Error>> {
        // Fails only if the thread has ended, and then there is nothing to stop.
        let _ = self.stop.send(());
        let samples = self.thread.join().map_err(|_| "the memory log's thread panicked")?;
        write(&self.path, &csv(&samples))?;
        write(&self.path.with_extension("svg"), &plot(&samples, self.limit))
    }
}

fn write(path: &Path, text: &str) -> Result<(), Box<dyn Error>> {
    std::fs::write(path, text).map_err(|error| format!("cannot write {}: {error}", path.display()).into())
}

fn csv(samples: &[Sample]) -> String {
    let mut text = "seconds,resident_bytes,anonymous_bytes,reserved_bytes\n".to_string();
    for Sample { seconds, memory, reserved } in samples {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{seconds:.3},{},{},{}", memory.resident.0, memory.anonymous.0, reserved.0);
    }
    text
}

fn plot(samples: &[Sample], limit: Bytes) -> String {
    let mib = |bytes: Bytes| bytes.0 as f64 / f64::from(1 << 20);
    let line = |name: &str, value: &dyn Fn(&Sample) -> Bytes| Line {
        name: name.to_string(),
        points: samples.iter().map(|sample| [sample.seconds, mib(value(sample))]).collect(),
    };
    let end = samples.last().map_or(1.0, |sample| sample.seconds);
    let lines = [
        Line { name: "budget".to_string(), points: vec![[0.0, mib(limit)], [end, mib(limit)]] },
        line("reserved", &|sample| sample.reserved),
        line("anonymous memory", &|sample| sample.memory.anonymous),
        line("resident set", &|sample| sample.memory.resident),
    ];
    plot_svg("Memory over time", "seconds", "MiB", &lines)
}
