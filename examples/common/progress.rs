//! A bar with time left on a terminal, a line now and then elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Steps of a bar; fine enough for any terminal.
const STEPS: u64 = 1000;
/// Time between lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// How far a job is, shown on standard error.
pub struct Meter {
    bar: Option<ProgressBar>,
    phase: String,
    last_line: Instant,
}

impl Meter {
    /// Nothing is shown until the first phase.
    pub fn new() -> Meter {
        let bar = std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{msg:>12} [{bar:40}] {percent:>3} %, {eta} left")
                .expect("the template is well formed")
                .progress_chars("=> ");
            ProgressBar::new(STEPS).with_style(style)
        });
        Meter { bar, phase: String::new(), last_line: Instant::now() }
    }

    /// Shows that `fraction` (0 to 1) of `phase` is done.
    pub fn set(&mut self, phase: &str, fraction: f64) {
        let is_new = self.phase != phase;
        if is_new {
            self.phase = phase.to_string();
        }
        if let Some(bar) = &self.bar {
            if is_new {
                bar.reset();
                bar.set_message(self.phase.clone());
            }
            bar.set_position((fraction * STEPS as f64) as u64);
        } else if !is_new && self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            eprintln!("{phase}: {:.0} %", 100.0 * fraction);
        }
    }

    /// Tells something beside the bar.
    pub fn note(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => eprintln!("{line}"),
        }
    }

    /// Takes the bar away.
    pub fn finish(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
