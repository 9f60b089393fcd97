//! A bar with time left on a terminal, a line now and then elsewhere.

use std::fmt::Write;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

/// Steps of a bar; fine enough for any terminal.
const STEPS: u64 = 1000;
/// Time between lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// How far a job is, shown on standard error.
pub struct Meter {
    is_terminal: bool,
    /// That of the phase.
    bar: Option<ProgressBar>,
    phase: String,
    last_line: Instant,
}

impl Meter {
    /// Nothing is shown until the first phase.
    pub fn new() -> Meter {
        let is_terminal = std::io::stderr().is_terminal();
        Meter { is_terminal, bar: None, phase: String::new(), last_line: Instant::now() }
    }

    /// Shows that `fraction` (0 to 1) of `phase` is done.
    pub fn set(&mut self, phase: &str, fraction: f64) {
        let is_new = self.phase != phase;
        if is_new {
            self.finish();
            self.phase = phase.to_string();
            // Anew, as one that is there already would be drawn before it has the word.
            self.bar = self.is_terminal.then(|| bar(phase));
        }
        if let Some(bar) = &self.bar {
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
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        self.phase.clear();
    }
}

fn bar(phase: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:>12} [{bar:40}] {percent:>3} %{left}")
        .expect("the template is well formed")
        .with_key("left", |state: &ProgressState, text: &mut dyn Write| {
            // Nothing is known of the time before something is done.
            if state.pos() > 0 {
                // Who draws the bar takes whatever is written.
                let _ = write!(text, ", {:#} left", HumanDuration(state.eta()));
            }
        })
        .progress_chars("=> ");
    ProgressBar::new(STEPS).with_style(style).with_message(phase.to_string())
}
