//! Figure 4: memory while rendering, over time.

use std::error::Error;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use plot::{Line, plot_svg};

#[path = "../../examples/common/plot.rs"]
mod plot;
#[path = "../../examples/common/svg.rs"]
pub mod svg;

/// Anonymous and resident memory of this process in MiB, where the system tells.
pub fn now() -> Option<[f64; 2]> {
    Some([value("RssAnon:")?, value("VmRSS:")?])
}

/// Largest resident set in MiB since [`forget_peak`].
pub fn peak() -> Option<f64> {
    value("VmHWM:")
}

/// From here on the peak counts anew, where the system lets it.
pub fn forget_peak() {
    // Elsewhere the peak is that of the whole run.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

fn value(key: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    let kib: f64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Samples in the background until it is finished.
pub struct MemoryLog {
    path: PathBuf,
    stop: mpsc::Sender<()>,
    thread: JoinHandle<Vec<[f64; 3]>>,
}

impl MemoryLog {
    pub fn start(path: PathBuf) -> MemoryLog {
        let (stop, stopped) = mpsc::channel();
        let thread = thread::spawn(move || {
            let start = Instant::now();
            let mut samples = Vec::new();
            loop {
                if let Some([anonymous, resident]) = now() {
                    samples.push([start.elapsed().as_secs_f64(), anonymous, resident]);
                }
                if stopped.recv_timeout(Duration::from_millis(50)) != Err(RecvTimeoutError::Timeout) {
                    return samples;
                }
            }
        });
        MemoryLog { path, stop, thread }
    }

    /// Stops, and writes the samples as CSV and as a plot beside it with the extension `svg`.
    pub fn finish(self) -> Result<(), Box<dyn Error>> {
        // Fails only if the thread has ended, and then there is nothing to stop.
        let _ = self.stop.send(());
        let samples = self.thread.join().map_err(|_| "the memory log's thread panicked")?;
        let mut csv = "seconds,anonymous_mib,resident_mib\n".to_string();
        for [seconds, anonymous, resident] in &samples {
            writeln!(csv, "{seconds:.3},{anonymous:.1},{resident:.1}")?;
        }
        std::fs::write(&self.path, csv)?;
        let line = |name: &str, column: usize| Line {
            name: name.to_string(),
            points: samples.iter().map(|sample| [sample[0], sample[column]]).collect(),
        };
        let lines = [line("anonymous memory", 1), line("resident set", 2)];
        std::fs::write(
            self.path.with_extension("svg"),
            plot_svg("Memory while rendering", "seconds", "MiB", &lines),
        )?;
        Ok(())
    }
}
