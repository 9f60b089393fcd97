//! Memory limits of Linux control groups, version 1 and 2.

use std::fs;
use std::path::{Path, PathBuf};

use crate::units::Bytes;

/// Names of one version's files.
struct Names {
    limits: &'static [&'static str],
    usage: &'static str,
    /// Lines of `memory.stat` that count page cache, which the kernel takes back before it refuses memory.
    reclaimable: [&'static str; 2],
}

const VERSION_1: Names = Names {
    limits: &["memory.limit_in_bytes"],
    usage: "memory.usage_in_bytes",
    reclaimable: ["total_inactive_file", "total_active_file"],
};

const VERSION_2: Names = Names {
    // Beyond `high` the kernel slows a process down until it has taken memory back: as bad as a limit for a cache.
    limits: &["memory.max", "memory.high"],
    usage: "memory.current",
    reclaimable: ["inactive_file", "active_file"],
};

/// The groups that hold this process.
pub(super) struct ControlGroups {
    names: Names,
    /// The innermost group's folder; the limits of all folders above it hold too.
    innermost: PathBuf,
    root: PathBuf,
}

impl ControlGroups {
    /// `membership` is the text of `/proc/self/cgroup`, `mount` is `/sys/fs/cgroup`. `None` without a memory controller.
    pub fn find(membership: &str, mount: &Path) -> Option<ControlGroups> {
        let mut version_2 = None;
        for line in membership.lines() {
            let mut fields = line.splitn(3, ':');
            let (Some(id), Some(controllers), Some(path)) = (fields.next(), fields.next(), fields.next())
            else {
                continue;
            };
            if controllers.split(',').any(|controller| controller == "memory") {
                return Some(ControlGroups::at(VERSION_1, mount.join("memory"), path));
            }
            if id == "0" && controllers.is_empty() {
                version_2 = Some(ControlGroups::at(VERSION_2, mount.to_path_buf(), path));
            }
        }
        version_2
    }

    fn at(names: Names, root: PathBuf, path: &str) -> ControlGroups {
        // In a container the path is often as the host sees it and not there: then only the root counts.
        let innermost = root.join(path.trim_start_matches('/'));
        let innermost = if innermost.is_dir() { innermost } else { root.clone() };
        ControlGroups { names, innermost, root }
    }

    fn folders(&self) -> impl Iterator<Item = &Path> {
        self.innermost.ancestors().take_while(|folder| folder.starts_with(&self.root))
    }

    /// The least that any of the groups still allows; `None` if none has a limit.
    pub fn available(&self) -> Option<Bytes> {
        self.folders().filter_map(|folder| self.available_in(folder)).min()
    }

    fn available_in(&self, folder: &Path) -> Option<Bytes> {
        // `max` is not a number: no limit. Version 1 says a number beyond all memory instead, which does no harm.
        let limit = self.names.limits.iter().filter_map(|name| number_in(&folder.join(name))).min()?;
        let usage = number_in(&folder.join(self.names.usage))?;
        let stat = fs::read_to_string(folder.join("memory.stat")).unwrap_or_default();
        let reclaimable: u64 =
            self.names.reclaimable.iter().filter_map(|name| super::system::field(&stat, name)).sum();
        Some(Bytes(limit.saturating_sub(usage.saturating_sub(reclaimable))))
    }

    /// The innermost group's pressure file, which only version 2 has.
    pub fn pressure_file(&self) -> PathBuf {
        self.innermost.join("memory.pressure")
    }
}

fn number_in(path: &Path) -> Option<u64> {
    fs::read_to_string(path).ok()?.trim().parse().ok()
}
