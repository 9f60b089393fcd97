//! Workers and readers as processes of this machine.

use std::error::Error;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use outcrop::transport::SharedKey;

use crate::options::Options;

/// Processes that end with this one.
#[derive(Default)]
pub struct Crew {
    children: Vec<Child>,
}

impl Crew {
    pub fn start(
        &mut self,
        options: &Options,
        key: &SharedKey,
        coordinator: &str,
        model: &Path,
    ) -> Result<(), Box<dyn Error>> {
        let readers = if options.peers { 0 } else { options.readers as u32 };
        for (role, count) in [("reader", readers), ("worker", options.workers)] {
            for number in 1..=count {
                let mut command = Command::new(std::env::current_exe()?);
                command.arg(model).args(["--role", role, "--connect", coordinator]);
                command.args(["--name", &format!("{role} {number}")]);
                command.args([
                    "--lanes",
                    &options.lanes.to_string(),
                    "--memory",
                    &options.memory.0.to_string(),
                ]);
                command.args(["--waiting", &options.waiting.to_string()]);
                command.args(["--loaders", &options.loaders.to_string()]);
                if options.peers {
                    command.args(["--serve", "127.0.0.1:0"]);
                }
                if options.verbose {
                    command.arg("--verbose");
                } else {
                    command.stdout(Stdio::null());
                }
                // Not on the command line, which every user of the machine can read.
                command.env(SharedKey::VARIABLE, key.to_hex()).stdin(Stdio::null());
                self.children.push(command.spawn()?);
            }
        }
        Ok(())
    }

    /// Waits until all have ended; they know that there is no more to do.
    pub fn wait(&mut self) {
        let deadline = Instant::now() + Duration::from_secs(10);
        for child in &mut self.children {
            while matches!(child.try_wait(), Ok(None)) && Instant::now() < deadline {
                thread::sleep(Duration::from_millis(20));
            }
        }
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        for child in &mut self.children {
            // One that has ended cannot be killed, and needs not be.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
