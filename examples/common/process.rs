//! What the operating system says about this process's memory (Linux; elsewhere nothing is known).

use outcrop::units::Bytes;

/// Memory of this process at one moment.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProcessMemory {
    /// Largest resident set so far (VmHWM).
    pub resident_peak: Bytes,
    /// Resident now (VmRSS).
    pub resident: Bytes,
    /// Resident now and not backed by a file (RssAnon).
    pub anonymous: Bytes,
}

impl ProcessMemory {
    /// Reads it.
    pub fn now() -> Option<ProcessMemory> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let value = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            line.trim().strip_suffix(" kB")?.parse().ok().map(Bytes::kib)
        };
        Some(ProcessMemory {
            resident_peak: value("VmHWM:")?,
            resident: value("VmRSS:")?,
            anonymous: value("RssAnon:")?,
        })
    }
}
