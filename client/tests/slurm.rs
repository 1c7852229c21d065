//! Tests `farmctl slurm submit` with a stand-in for sbatch on PATH.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

type Result<T = ()> = std::result::Result<T, Box<dyn std::error::Error>>;

/// A folder with an sbatch that keeps its input and its environment, and then runs `body`.
struct Cluster {
    dir: tempfile::TempDir,
}

impl Cluster {
    fn new(body: &str) -> Result<Self> {
        let cluster = Self { dir: tempfile::tempdir()? };
        let here = cluster.dir.path().display();
        let script =
            format!("#!/bin/bash\ncat > {here}/input\nenv > {here}/env\necho \"$@\" > {here}/args\n{body}\n");
        write(&cluster.path("sbatch"), &script, 0o755)?;
        Ok(cluster)
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    fn read(&self, name: &str) -> Result<String> {
        Ok(std::fs::read_to_string(self.path(name))?)
    }

    fn farmctl(&self, args: &[&str]) -> Result<Output> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_farmctl"));
        command.args(["slurm", "submit"]).args(args).current_dir(self.dir.path());
        command.env_remove("FARM_SERVER").env_remove("FARM_ACCESS");
        command.env("PATH", format!("{}:/usr/bin:/bin", self.dir.path().display()));
        command.env("SBATCH_TIMELIMIT", "1").env("SBATCH_ACCOUNT", "lab");
        Ok(command.output()?)
    }
}

fn write(path: &Path, text: &str, mode: u32) -> std::io::Result<()> {
    std::fs::write(path, text)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

const FARM: [&str; 6] = ["--server", "https://farm:7700", "--workers", "4", "--time", "1-12"];

/// A dry run prints the script and submits nothing.
#[test]
fn dry_run_prints_the_script_only() -> Result {
    let cluster = Cluster::new("echo 17")?;
    let dry = cluster.farmctl(&[&FARM[..], &["--dry-run"]].concat())?;
    assert!(dry.status.success(), "{}", text(&dry.stderr));
    assert!(text(&dry.stdout).starts_with("#!/bin/bash\n#SBATCH "));
    assert!(text(&dry.stdout).contains("\n#SBATCH --time=1-12:00:00\n"));
    assert!(!cluster.path("input").exists());
    let real = cluster.farmctl(&FARM)?;
    assert!(real.status.success(), "{}", text(&real.stderr));
    assert_eq!(cluster.read("input")?.trim_end(), text(&dry.stdout).trim_end());
    Ok(())
}

/// The job number is printed as text, alone, or as JSON. The environment does not override the script.
#[test]
fn job_number_is_text_or_json() -> Result {
    let cluster = Cluster::new("echo '17;green'")?;
    let message = text(&cluster.farmctl(&FARM)?.stdout);
    let begin = "job 17: 4 workers with 1 thread and a walltime of 1-12:00:00, which stop";
    assert!(message.starts_with(begin), "{message}");
    assert_eq!(text(&cluster.farmctl(&[&FARM[..], &["--quiet"]].concat())?.stdout), "17\n");
    let json = cluster.farmctl(&[&FARM[..], &["--json"]].concat())?;
    let answer: serde_json::Value = serde_json::from_slice(&json.stdout)?;
    assert_eq!((&answer["api"], &answer["kind"]), (&"farmctl/1".into(), &"slurm-submit".into()));
    assert_eq!((&answer["data"]["job_id"], &answer["data"]["workers"]), (&17.into(), &4.into()));
    assert_eq!(answer["data"]["script"], cluster.read("input")?);
    assert_eq!(cluster.read("args")?, "--parsable\n");
    let environment = cluster.read("env")?;
    assert!(!environment.contains("SBATCH_TIMELIMIT") && environment.contains("SBATCH_ACCOUNT=lab"));
    Ok(())
}

/// A refusal of `sbatch`, also of one that reads no input, an answer that is no job number, and no `sbatch` at all are
/// reported.
#[test]
fn failures_of_sbatch_are_reported() -> Result {
    for (script, message) in [
        ("cat > input; echo 'invalid partition specified: x' >&2; exit 1", "invalid partition specified: x"),
        ("exec <&-\necho 'no controller' >&2\nexit 1", "no controller"),
        ("cat > input\necho submitted", "\"submitted\", which is no job number"),
    ] {
        let cluster = Cluster::new("")?;
        write(&cluster.path("sbatch"), &format!("#!/bin/bash\n{script}\n"), 0o755)?;
        let refused = cluster.farmctl(&FARM)?;
        assert_eq!((refused.status.code(), text(&refused.stdout)), (Some(1), String::new()), "{script}");
        assert!(text(&refused.stderr).contains(message), "{}", text(&refused.stderr));
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_farmctl"));
    let missing = command.args(["slurm", "submit"]).args(FARM).env("PATH", "/nowhere").output()?;
    assert!(text(&missing.stderr).contains("sbatch is not on PATH"), "{}", text(&missing.stderr));
    Ok(())
}

/// The access file of workers is looked up next to that of the client.
#[test]
fn worker_file_is_searched_beside_the_client() -> Result {
    let cluster = Cluster::new("echo 17")?;
    let args = ["--access", "client.toml", "--workers", "1", "--time", "60", "--dry-run"];
    let missing = cluster.farmctl(&args)?;
    assert!(text(&missing.stderr).contains("worker.toml"), "{}", text(&missing.stderr));
    write(&cluster.path("worker.toml"), "", 0o644)?;
    let open = cluster.farmctl(&args)?;
    assert!(text(&open.stderr).contains("mode 0644"), "{}", text(&open.stderr));
    write(&cluster.path("worker.toml"), "", 0o600)?;
    let found = cluster.farmctl(&args)?;
    let wanted = format!("--access {}", cluster.path("worker.toml").display());
    assert!(text(&found.stdout).contains(&wanted), "{}", text(&found.stdout));
    Ok(())
}

/// Without a coordinator, or without time to work, nothing is submitted.
#[test]
fn submission_needs_coordinator_and_time() -> Result {
    let cluster = Cluster::new("echo 17")?;
    let nowhere = cluster.farmctl(&["--workers", "1", "--time", "60"])?;
    assert!(text(&nowhere.stderr).contains("--server URL or --worker-access FILE"));
    let short =
        cluster.farmctl(&["--server", "http://f", "--workers", "1", "--time", "1", "--grace", "50s"])?;
    assert!(text(&short.stderr).contains("leaves no time to work"), "{}", text(&short.stderr));
    for wrong in [["--time", "0"], ["--time", "1h"], ["--workers", "0"], ["--grace", "10"]] {
        let refused = cluster.farmctl(&[&FARM[..2], &wrong[..]].concat())?;
        assert_eq!(refused.status.code(), Some(2), "{wrong:?}");
    }
    assert!(!cluster.path("input").exists());
    Ok(())
}
