//! Determines how much memory this process may use: the machine's, or less if it runs in a container or a job with a limit.

use std::path::{Path, PathBuf};

/// The least of the machine's memory and the limits of all control groups that this process is in, in bytes. None if
/// the system reports neither.
pub fn usable_bytes() -> Option<u64> {
    usable(|file| std::fs::read_to_string(file).ok())
}

/// The usable memory by the system's files as returned by `read`.
fn usable(read: impl Fn(&Path) -> Option<String>) -> Option<u64> {
    let machine = read(Path::new("/proc/meminfo")).and_then(|table| machine_bytes(&table));
    let groups = read(Path::new("/proc/self/cgroup")).unwrap_or_default();
    let mounts = read(Path::new("/proc/self/mountinfo")).unwrap_or_default();
    let hierarchies = mounts.lines().filter_map(|line| Hierarchy::parse(line, &groups));
    let limits = hierarchies.flat_map(|hierarchy| {
        let files = hierarchy.limit_files();
        files.into_iter().filter_map(|file| limit(&read(&file)?)).collect::<Vec<_>>()
    });
    machine.into_iter().chain(limits).min()
}

/// The machine's memory, from the system's table: `MemTotal:  24689764 kB`.
fn machine_bytes(table: &str) -> Option<u64> {
    let line = table.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

/// A limit in bytes. Version 2 has the word `max` for none.
fn limit(text: &str) -> Option<u64> {
    text.trim().parse().ok()
}

/// A hierarchy of control groups that limits this process: its group and all groups around it.
#[derive(Debug)]
struct Hierarchy {
    /// Mount point of the hierarchy.
    mount: PathBuf,
    /// The group of this process, relative to the mount point.
    group: PathBuf,
    /// The file with a group's limit.
    file: &'static str,
}

impl Hierarchy {
    /// Parses a line of `/proc/self/mountinfo`, if it is one that limits memory, with `/proc/self/cgroup`.
    fn parse(line: &str, groups: &str) -> Option<Self> {
        let (mounted, filesystem) = line.split_once(" - ")?;
        let (mut mounted, mut filesystem) = (mounted.split(' ').skip(3), filesystem.split(' '));
        let (root, mount) = (mounted.next()?, mounted.next()?);
        let (kind, options) = (filesystem.next()?, filesystem.nth(1)?);
        let (controller, file) = match kind {
            "cgroup2" => ("", "memory.max"),
            "cgroup" if options.split(',').any(|option| option == "memory") => {
                ("memory", "memory.limit_in_bytes")
            }
            _ => return None,
        };
        let own = groups.lines().find_map(|line| {
            let (_, rest) = line.split_once(':')?;
            let (controllers, path) = rest.split_once(':')?;
            controllers.split(',').any(|name| name == controller).then_some(path)
        });
        // In a container without its own namespace, the path is that of the host, and the mounted folder is the group.
        let group = own.and_then(|path| Path::new(path).strip_prefix(root).ok()).unwrap_or(Path::new(""));
        Some(Self { mount: PathBuf::from(mount.replace("\\040", " ")), group: group.to_owned(), file })
    }

    fn limit_files(&self) -> Vec<PathBuf> {
        self.group.ancestors().map(|group| self.mount.join(group).join(self.file)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;
    const MACHINE: (&str, &str) = ("/proc/meminfo", "MemTotal:       25165824 kB\nMemFree: 1 kB\n");

    fn usable_of(files: &[(&str, &str)]) -> Option<u64> {
        usable(|file| {
            files.iter().find(|(name, _)| Path::new(name) == file).map(|(_, text)| (*text).to_owned())
        })
    }

    /// The usable memory with the groups and mounts of this process, and these further files.
    fn with_groups(group: &str, mounts: &str, limits: &[(&str, &str)]) -> Option<u64> {
        let files = [MACHINE, ("/proc/self/cgroup", group), ("/proc/self/mountinfo", mounts)];
        usable_of(&[&files[..], limits].concat())
    }

    /// Without control groups, the usable memory is that of the machine.
    #[test]
    fn without_cgroups_machine_memory_counts() {
        assert_eq!(usable_of(&[MACHINE]), Some(24 * GIB));
        assert_eq!(usable_of(&[]), None);
        assert_eq!(usable_of(&[("/proc/meminfo", "nothing")]), None);
    }

    /// The limit of a control group of version 1 holds. In a container, its path on the host does not exist.
    #[test]
    fn cgroup_v1_limit_holds() {
        const UNLIMITED: &str = "9223372036854771712\n";
        let group = "9:name=systemd:/\n4:cpu,memory:/slurm/job_7\n0::/\n";
        let mounts = "32 31 0:29 / /sys/fs/cgroup/cpu rw,relatime - cgroup cgroup rw,cpu\n\
                      35 31 0:32 / /sys/fs/cgroup/memory rw,relatime - cgroup cgroup rw,cpu,memory\n\
                      41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw\n";
        for (limit, expected) in [("2147483648\n", 2 * GIB), (UNLIMITED, 24 * GIB)] {
            let limits = [
                ("/sys/fs/cgroup/memory/slurm/job_7/memory.limit_in_bytes", limit),
                ("/sys/fs/cgroup/memory/memory.limit_in_bytes", UNLIMITED),
            ];
            assert_eq!(with_groups(group, mounts, &limits), Some(expected));
        }
        let mounts = "35 31 0:32 /docker/0123abcd /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n";
        let limits = [("/sys/fs/cgroup/memory/memory.limit_in_bytes", "536870912\n")];
        for group in ["4:memory:/docker/0123abcd\n", "4:memory:/kubepods/pod1\n"] {
            assert_eq!(with_groups(group, mounts, &limits), Some(GIB / 2), "{group}");
        }
    }

    /// The smallest limit of nested control groups of version 2 holds.
    #[test]
    fn smallest_cgroup_v2_limit_holds() {
        let group = "0::/user.slice/user-7.slice/run.scope\n";
        let mounts = "26 23 0:23 / /sys/fs/cgroup rw shared:4 - cgroup2 cgroup2 rw,nsdelegate\n";
        for (inner, outer, expected) in [
            ("max\n", "3221225472\n", 3 * GIB),
            ("1073741824\n", "3221225472\n", GIB),
            ("max\n", "max\n", 24 * GIB),
        ] {
            let limits = [
                ("/sys/fs/cgroup/user.slice/user-7.slice/run.scope/memory.max", inner),
                ("/sys/fs/cgroup/user.slice/user-7.slice/memory.max", outer),
                ("/sys/fs/cgroup/user.slice/memory.max", "max\n"),
            ];
            assert_eq!(with_groups(group, mounts, &limits), Some(expected), "{inner} {outer}");
        }
    }
}
