//! Simulates Slurm: `sbatch`, `squeue` and `scancel` in bash, which run tasks on this machine. `deploy/slurm/check`
//! tests with a real one.

use std::ffi::OsString;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rustix::process::{Pid, Signal, kill_process};

use crate::process::{SOON, wait_for};

/// Queues the tasks of an array, one file each.
const SBATCH: &str = r#"
[[ ! -e refuses ]] || { echo "sbatch: error: QOSMaxSubmitJobPerUserLimit" >&2; exit 1; }
job=$(($(ls jobs | wc -l) + 1))
cat >jobs/$job
name=$(sed -n 's/^#SBATCH --job-name="\(.*\)"/\1/p' jobs/$job)
count=$(sed -n 's/^#SBATCH --array=1-\([0-9]*\).*/\1/p' jobs/$job)
for task in $(seq "$count"); do
  echo "PENDING $name" >"queue/$job $task"
  setsid ./bin/task "$job" "$task" </dev/null >"logs/$job-$task" 2>&1 &
done
echo "$job"
"#;

/// Waits for a node, and runs the script there unless it was cancelled meanwhile.
const TASK: &str = r#"
node=
while [[ -e "queue/$1 $2" && -z $node ]]; do
  for each in nodes/*; do
    exec 8>"$each"
    if flock --nonblock 8; then node=$each && break; fi
  done
  sleep 0.05
done
[[ -e "queue/$1 $2" ]] || exit 0
sed -i 's/^PENDING/RUNNING/' "queue/$1 $2"
export SLURM_ARRAY_JOB_ID=$1 SLURM_ARRAY_TASK_ID=$2 SLURM_CPUS_PER_TASK=1 SLURMD_NODENAME=${node#nodes/}
export SLURM_JOB_END_TIME=$(($(date +%s) + 600))
bash "jobs/$1" &
echo $! >"running/$1-$2"
wait $! || true
rm -f "queue/$1 $2" "running/$1-$2"
"#;

const SQUEUE: &str = r#"
[[ ! -e away ]] || { echo >>asked; echo "slurm_load_jobs error: Unable to contact slurm controller" >&2; exit 1; }
echo >>asked
for file in queue/*; do
  [[ -e $file ]] || continue
  task=${file#queue/}
  read -r state name <"$file"
  echo "${task% *}|${task#* }|$state|None|$name"
done
"#;

const SCANCEL: &str = r#"
[[ $1 == --state=PENDING ]]
for task in "${@:2}"; do
  file="queue/${task/_/ }"
  if [[ -e $file ]] && grep -q ^PENDING "$file"; then rm "$file"; fi
done
"#;

/// A cluster in a folder. Its tasks are killed when it is dropped.
#[derive(Debug)]
pub struct Cluster {
    folder: PathBuf,
}

impl Cluster {
    /// A cluster of this many nodes with one core each.
    ///
    /// # Panics
    /// If the folder cannot be written to.
    pub fn new(folder: PathBuf, nodes: usize) -> Self {
        for part in ["bin", "jobs", "queue", "nodes", "running", "logs"] {
            std::fs::create_dir_all(folder.join(part)).unwrap();
        }
        for (name, body) in [("sbatch", SBATCH), ("task", TASK), ("squeue", SQUEUE), ("scancel", SCANCEL)] {
            let program = folder.join("bin").join(name);
            let text = format!("#!/bin/bash\nset -euo pipefail\ncd '{}'{body}", folder.display());
            std::fs::write(&program, text).unwrap();
            std::fs::set_permissions(program, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        for node in 1..=nodes {
            std::fs::write(folder.join(format!("nodes/node{node}")), "").unwrap();
        }
        Self { folder }
    }

    /// The search path with its commands first.
    pub fn path(&self) -> OsString {
        let rest = std::env::var_os("PATH").unwrap_or_default();
        let parts = std::iter::once(self.folder.join("bin")).chain(std::env::split_paths(&rest));
        std::env::join_paths(parts).unwrap()
    }

    /// Sets or removes a fault: with `away`, squeue gets no answer; with `refuses`, sbatch accepts nothing.
    ///
    /// # Panics
    /// If the folder cannot be written to.
    pub fn set(&self, fault: &str, on: bool) {
        let file = self.folder.join(fault);
        if on { std::fs::write(file, "").unwrap() } else { std::fs::remove_file(file).unwrap() }
    }

    /// Number of tasks in a state: PENDING, RUNNING.
    pub fn tasks(&self, state: &str) -> usize {
        let text = |file: &Path| std::fs::read_to_string(file).unwrap_or_default();
        entries(&self.folder.join("queue")).iter().filter(|file| text(file).starts_with(state)).count()
    }

    /// Waits until squeue was called this many more times, with an answer or without.
    ///
    /// # Panics
    /// If it is not called.
    pub fn wait_for_checks(&self, count: usize) {
        let checks = || std::fs::read(self.folder.join("asked")).map_or(0, |calls| calls.len());
        let before = checks();
        wait_for("calls of squeue", SOON, || (checks() >= before + count).then_some(()));
    }

    /// Number of arrays that were submitted.
    pub fn arrays(&self) -> usize {
        entries(&self.folder.join("jobs")).len()
    }
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder)
        .map_or_else(|_| Vec::new(), |all| all.flatten().map(|entry| entry.path()).collect())
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for task in entries(&self.folder.join("queue")) {
            let _ = std::fs::remove_file(task);
        }
        for file in entries(&self.folder.join("running")) {
            let id = std::fs::read_to_string(file).ok().and_then(|text| text.trim().parse().ok());
            if let Some(id) = id.and_then(Pid::from_raw) {
                let _ = kill_process(id, Signal::KILL);
            }
        }
    }
}
