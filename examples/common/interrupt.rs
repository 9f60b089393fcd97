//! ^C asks a long job to stop; a second one ends the process.

use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the user asked to stop.
#[derive(Clone)]
pub struct Interrupt {
    requested: Arc<AtomicBool>,
}

impl Interrupt {
    /// Exit code of a process that was interrupted, by the shell's convention.
    pub const EXIT_CODE: u8 = 130;

    /// Takes over ^C (and the signal to terminate).
    pub fn install() -> Result<Interrupt, ctrlc::Error> {
        let requested = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&requested);
        ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                process::exit(Interrupt::EXIT_CODE.into());
            }
        })?;
        Ok(Interrupt { requested })
    }

    /// Whether it was pressed.
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }
}
