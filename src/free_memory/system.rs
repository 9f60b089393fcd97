//! The memory of this machine, or of the container that this process is in.

use std::fs;
use std::path::PathBuf;

use super::control_group::ControlGroups;
use super::{FreeMemory, FreeMemoryReading};
use crate::units::Bytes;

/// Linux: the least of `MemAvailable` and what the control groups (version 1 or 2) allow, and the pressure (PSI) of the group
/// or the machine. Elsewhere nothing is known. Reading opens a few small files, some tens of microseconds.
#[derive(Clone, Debug)]
pub struct SystemMemory {
    proc: PathBuf,
    control_groups: PathBuf,
}

impl Default for SystemMemory {
    fn default() -> SystemMemory {
        SystemMemory::new()
    }
}

impl SystemMemory {
    /// Reads from `/proc` and `/sys/fs/cgroup`.
    pub fn new() -> SystemMemory {
        SystemMemory::with_roots("/proc".into(), "/sys/fs/cgroup".into())
    }

    /// Reads from folders that stand for these two, where they are mounted elsewhere.
    pub fn with_roots(proc: PathBuf, control_groups: PathBuf) -> SystemMemory {
        SystemMemory { proc, control_groups }
    }
}

impl FreeMemory for SystemMemory {
    fn read(&self) -> Option<FreeMemoryReading> {
        let machine = fs::read_to_string(self.proc.join("meminfo")).ok()?;
        let machine = Bytes(field(&machine, "MemAvailable:")?.saturating_mul(1024));
        let membership = fs::read_to_string(self.proc.join("self/cgroup")).unwrap_or_default();
        let groups = ControlGroups::find(&membership, &self.control_groups);
        let allowed = groups.as_ref().and_then(ControlGroups::available);
        let pressure = groups
            .and_then(|groups| pressure(&fs::read_to_string(groups.pressure_file()).ok()?))
            .or_else(|| pressure(&fs::read_to_string(self.proc.join("pressure/memory")).ok()?));
        Some(FreeMemoryReading {
            available: allowed.map_or(machine, |allowed| allowed.min(machine)),
            pressure_percent: pressure.unwrap_or(0.0),
        })
    }
}

/// The number after `name`, which begins a line.
pub(super) fn field(text: &str, name: &str) -> Option<u64> {
    let mut words =
        text.lines().map(str::split_whitespace).find(|words| words.clone().next() == Some(name))?;
    words.nth(1)?.parse().ok()
}

/// From a line as `some avg10=1.53 avg60=0.40 avg300=0.09 total=123`.
fn pressure(text: &str) -> Option<f32> {
    let line = text.lines().find(|line| line.starts_with("some "))?;
    let value = line.split_whitespace().find_map(|word| word.strip_prefix("avg10="))?;
    value.parse().ok().filter(|percent: &f32| percent.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const MIB: u64 = 1 << 20;

    fn write(folder: &Path, files: &[(&str, &str)]) {
        for (name, text) in files {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
    }

    fn read(folder: &Path) -> Option<FreeMemoryReading> {
        SystemMemory::with_roots(folder.join("proc"), folder.join("cgroup")).read()
    }

    fn available(folder: &Path) -> u64 {
        read(folder).unwrap().available.0 / MIB
    }

    const MEMINFO: (&str, &str) =
        ("proc/meminfo", "MemTotal: 9000000 kB\nMemAvailable:  1024000 kB\nX: 1 kB\n");

    #[test]
    fn without_control_groups_the_machine_counts() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        assert_eq!(read(folder), None);
        write(folder, &[("proc/meminfo", "MemTotal: 5 kB\n")]);
        assert_eq!(read(folder), None);
        write(folder, &[MEMINFO]);
        assert_eq!(
            read(folder),
            Some(FreeMemoryReading { available: Bytes(1000 * MIB), pressure_percent: 0.0 })
        );
        write(
            folder,
            &[("proc/pressure/memory", "some avg10=12.50 avg60=1 avg300=0 total=5\nfull avg10=3\n")],
        );
        assert_eq!(read(folder).unwrap().pressure_percent, 12.5);
        for nonsense in ["", "some\n", "some avg10=NaN\n", "some avg10=x\n"] {
            write(folder, &[("proc/pressure/memory", nonsense)]);
            assert_eq!(read(folder).unwrap().pressure_percent, 0.0);
        }
    }

    #[test]
    fn the_narrowest_group_of_version_2_counts_and_its_page_cache_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write(
            folder,
            &[
                MEMINFO,
                ("proc/self/cgroup", "0::/a/b\n"),
                ("cgroup/memory.stat", "anon 5\n"),
                ("cgroup/a/memory.max", "536870912\n"),
                ("cgroup/a/memory.current", "419430400\n"),
                ("cgroup/a/memory.stat", "anon 1\ninactive_file 104857600\nactive_file 52428800\n"),
                ("cgroup/a/b/memory.max", "max\n"),
                ("cgroup/a/b/memory.current", "1\n"),
                ("cgroup/a/b/memory.pressure", "some avg10=7.00 avg60=0 avg300=0 total=0\n"),
            ],
        );
        // 512 - (400 - 150)
        assert_eq!(available(folder), 262);
        assert_eq!(read(folder).unwrap().pressure_percent, 7.0);
        write(folder, &[("cgroup/a/b/memory.high", "10485761\n")]);
        assert_eq!(available(folder), 10);
        // More in use than allowed, as after the limit was lowered.
        write(folder, &[("cgroup/a/b/memory.current", "99999999\n")]);
        assert_eq!(available(folder), 0);
        // As the host names the group; here only the root is to be seen.
        write(folder, &[("proc/self/cgroup", "0::/not/here\n")]);
        assert_eq!(available(folder), 1000);
    }

    #[test]
    fn a_group_of_version_1_counts() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        write(
            folder,
            &[
                MEMINFO,
                ("proc/self/cgroup", "12:cpu,cpuacct:/\n5:memory:/job\n0::/\n"),
                ("cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"),
                ("cgroup/memory/memory.usage_in_bytes", "5\n"),
                ("cgroup/memory/job/memory.limit_in_bytes", "104857600\n"),
                ("cgroup/memory/job/memory.usage_in_bytes", "94371840\n"),
                ("cgroup/memory/job/memory.stat", "inactive_file 1\ntotal_inactive_file 41943040\n"),
            ],
        );
        assert_eq!(available(folder), 50);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_has_memory() {
        let reading = SystemMemory::new().read().unwrap();
        assert!(reading.available > Bytes(0) && reading.pressure_percent >= 0.0);
    }
}
