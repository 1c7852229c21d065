//! Tests `farmctl slurm submit` with a stand-in for sbatch on PATH.
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// A folder with an sbatch that keeps its input and its environment, and then runs `body`.
struct Cluster {
    dir: tempfile::TempDir,
}

/// The exit code, the output and the messages of a command.
struct Ran {
    code: Option<i32>,
    out: String,
    err: String,
}

impl Ran {
    fn of(command: &mut Command) -> Self {
        let output = command.output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
    }
}

impl Cluster {
    fn new(body: &str) -> Self {
        let cluster = Self { dir: tempfile::tempdir().unwrap() };
        let here = cluster.dir.path().display();
        let script =
            format!("#!/bin/bash\ncat > {here}/input\nenv > {here}/env\necho \"$@\" > {here}/args\n{body}\n");
        write(&cluster.path("sbatch"), &script, 0o755);
        cluster
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    fn farmctl(&self, args: &[&str]) -> Ran {
        let mut command = Command::new(env!("CARGO_BIN_EXE_farmctl"));
        command.args(["slurm", "submit"]).args(args).current_dir(self.dir.path());
        command.env_remove("FARM_SERVER").env_remove("FARM_ACCESS");
        command.env("PATH", format!("{}:/usr/bin:/bin", self.dir.path().display()));
        command.env("SBATCH_TIMELIMIT", "1").env("SBATCH_ACCOUNT", "lab");
        Ran::of(&mut command)
    }
}

fn write(path: &Path, text: &str, mode: u32) {
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
}

const FARM: [&str; 6] = ["--server", "https://farm:7700", "--workers", "4", "--time", "1-12"];

/// A dry run prints the script and submits nothing.
#[test]
fn dry_run_prints_the_script_only() {
    let cluster = Cluster::new("echo 17");
    let dry = cluster.farmctl(&[&FARM[..], &["--dry-run"]].concat());
    assert_eq!(dry.code, Some(0), "{}", dry.err);
    assert!(dry.out.starts_with("#!/bin/bash\n#SBATCH "));
    assert!(dry.out.contains("\n#SBATCH --time=1-12:00:00\n"));
    assert!(!cluster.path("input").exists());
    let real = cluster.farmctl(&FARM);
    assert_eq!(real.code, Some(0), "{}", real.err);
    assert_eq!(cluster.read("input").trim_end(), dry.out.trim_end());
}

/// The job number is printed as text, alone, or as JSON. The environment does not override the script.
#[test]
fn job_number_is_text_or_json() {
    let cluster = Cluster::new("echo '17;green'");
    let message = cluster.farmctl(&FARM).out;
    let begin = "job 17: 4 workers with 1 thread and a walltime of 1-12:00:00, which stop";
    assert!(message.starts_with(begin), "{message}");
    assert_eq!(cluster.farmctl(&[&FARM[..], &["--quiet"]].concat()).out, "17\n");
    let json = cluster.farmctl(&[&FARM[..], &["--json"]].concat());
    let answer: serde_json::Value = serde_json::from_str(&json.out).unwrap();
    assert_eq!((&answer["api"], &answer["kind"]), (&"farmctl/1".into(), &"slurm-submit".into()));
    assert_eq!((&answer["data"]["job_id"], &answer["data"]["workers"]), (&17.into(), &4.into()));
    assert_eq!(answer["data"]["script"], cluster.read("input"));
    assert_eq!(cluster.read("args"), "--parsable\n");
    let environment = cluster.read("env");
    assert!(!environment.contains("SBATCH_TIMELIMIT") && environment.contains("SBATCH_ACCOUNT=lab"));
}

/// A refusal of `sbatch`, also of one that reads no input, an answer that is no job number, and no `sbatch` at all are
/// reported.
#[test]
fn failures_of_sbatch_are_reported() {
    for (script, message) in [
        ("cat > input; echo 'invalid partition specified: x' >&2; exit 1", "invalid partition specified: x"),
        ("exec <&-\necho 'no controller' >&2\nexit 1", "no controller"),
        ("cat > input\necho submitted", "\"submitted\", which is no job number"),
    ] {
        let cluster = Cluster::new("");
        write(&cluster.path("sbatch"), &format!("#!/bin/bash\n{script}\n"), 0o755);
        let refused = cluster.farmctl(&FARM);
        assert_eq!((refused.code, refused.out.as_str()), (Some(1), ""), "{script}");
        assert!(refused.err.contains(message), "{}", refused.err);
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_farmctl"));
    let missing = Ran::of(command.args(["slurm", "submit"]).args(FARM).env("PATH", "/nowhere"));
    assert!(missing.err.contains("sbatch is not on PATH"), "{}", missing.err);
}

/// The access file of workers is looked up next to that of the client.
#[test]
fn worker_file_is_searched_beside_the_client() {
    let cluster = Cluster::new("echo 17");
    let args = ["--access", "client.toml", "--workers", "1", "--time", "60", "--dry-run"];
    let missing = cluster.farmctl(&args);
    assert!(missing.err.contains("worker.toml"), "{}", missing.err);
    write(&cluster.path("worker.toml"), "", 0o644);
    let open = cluster.farmctl(&args);
    assert!(open.err.contains("mode 0644"), "{}", open.err);
    write(&cluster.path("worker.toml"), "", 0o600);
    let found = cluster.farmctl(&args);
    let wanted = format!("--access {}", cluster.path("worker.toml").display());
    assert!(found.out.contains(&wanted), "{}", found.out);
}

/// Without a coordinator, or without time to work, nothing is submitted.
#[test]
fn submission_needs_coordinator_and_time() {
    let cluster = Cluster::new("echo 17");
    let nowhere = cluster.farmctl(&["--workers", "1", "--time", "60"]);
    assert!(nowhere.err.contains("--server URL or --worker-access FILE"));
    let short = cluster.farmctl(&["--server", "http://f", "--workers", "1", "--time", "1", "--grace", "50s"]);
    assert!(short.err.contains("leaves no time to work"), "{}", short.err);
    for wrong in [["--time", "0"], ["--time", "1h"], ["--workers", "0"], ["--grace", "10"]] {
        let refused = cluster.farmctl(&[&FARM[..2], &wrong[..]].concat());
        assert_eq!(refused.code, Some(2), "{wrong:?}");
    }
    assert!(!cluster.path("input").exists());
}
