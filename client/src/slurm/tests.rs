use std::process::Command;

use super::*;
use crate::testing::is_stable;

fn submission() -> Submission {
    Submission {
        workers: NonZeroU32::new(3).unwrap(),
        at_once: None,
        walltime: "2:00:00".parse().unwrap(),
        threads: 4,
        grace: Duration::from_secs(10),
        idle_exit: Duration::from_mins(5),
        job_name: "farm-worker".parse().unwrap(),
        partition: None,
        log: "farm-%A_%a.log".parse().unwrap(),
        options: Vec::new(),
        program: "farm-worker".to_owned(),
        coordinator: CoordinatorAddress { server: Some("https://farm:7700".to_owned()), access: None },
    }
}

/// The worker's arguments when bash runs the script with these variables.
fn called(script: &str, settings: &[(&str, &str)]) -> Vec<String> {
    let dir = tempfile::tempdir().unwrap();
    let program = dir.path().join("the worker's");
    write_program(&program, "printf '%s\\n' \"$@\" \"${FARM_SERVER-unset}\"");
    let script =
        script.replace("exec farm-worker", &format!("exec {}", shell_quoted(program.to_str().unwrap())));
    let mut bash = Command::new("bash");
    bash.args(["-c", &script]).env("FARM_SERVER", "http://of-the-submitter");
    bash.envs([("SLURM_ARRAY_JOB_ID", "17"), ("SLURM_ARRAY_TASK_ID", "2"), ("SLURM_CPUS_PER_TASK", "4")]);
    bash.env("SLURMD_NODENAME", "node1").env_remove("SLURM_JOB_END_TIME").envs(settings.iter().copied());
    let output = bash.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect()
}

fn write_program(path: &std::path::Path, body: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(path, format!("#!/bin/bash\n{body}\n")).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// A folder with a squeue that gives this answer, and a PATH that begins with the folder.
fn squeue(answer: &str) -> (tempfile::TempDir, String) {
    let dir = tempfile::tempdir().unwrap();
    write_program(&dir.path().join("squeue"), &format!("[[ $* == *--jobs=17_2* ]] && {answer}"));
    let path = format!("{}:/usr/bin:/bin", dir.path().display());
    (dir, path)
}

fn value<'a>(call: &'a [String], option: &str) -> Option<&'a str> {
    let at = call.iter().position(|word| word == option).unwrap();
    call.get(at + 1).map(String::as_str)
}

/// The script requests the array and the warning signal, and starts a worker with the options.
#[test]
fn script_head_requests_array_and_warning() {
    let mut submission = submission();
    submission.at_once = NonZeroU32::new(2);
    submission.partition = Some("long".parse().unwrap());
    submission.options = vec!["--account=lab".parse().unwrap()];
    is_stable("slurm/tests/script.txt", &submission.script());
}

/// The workers' options arrive unchanged, whatever characters they contain.
#[test]
fn workers_get_a_clean_environment() {
    let mut submission = submission();
    submission.coordinator.access = Some("/home/it's me/a \"b\"/$x.toml".to_owned());
    let call = called(&submission.script(), &[]);
    for (option, expected) in [
        ("--access", "/home/it's me/a \"b\"/$x.toml"),
        ("--server", "https://farm:7700"),
        ("--threads", "4"),
        ("--label", "slurm:17.2@node1"),
        ("--grace", "10s"),
        ("--idle-exit", "5m"),
    ] {
        assert_eq!(value(&call, option), Some(expected), "{option}");
    }
    assert_eq!(call.last().map(String::as_str), Some("unset"));
}

/// The time limit is the time that Slurm leaves, by its environment or by squeue; without an answer it is the requested
/// walltime.
#[test]
fn time_limit_is_the_remaining_slurm_time() {
    let script = submission().script();
    for left in ["1-23:59:59", "1:59:30", "0:30"] {
        let (_dir, path) = squeue(&format!("echo {left}"));
        assert_eq!(value(&called(&script, &[("PATH", &path)]), "--time-limit"), Some(left));
    }
    for answer in
        "exit 1|true|echo UNLIMITED|echo INVALID|echo NOT_SET|echo 0:00|printf '1:00\\n1:00\\n'".split('|')
    {
        let (_dir, path) = squeue(answer);
        let call = called(&script, &[("PATH", &path)]);
        assert_eq!(value(&call, "--time-limit"), Some("0-02:00:00"), "{answer}");
    }
    // In the year 2100, which is certainly after the current time of this machine.
    let call = called(&script, &[("SLURM_JOB_END_TIME", "4102444800")]);
    let left = value(&call, "--time-limit").and_then(|t| t.strip_suffix('s')).unwrap();
    assert!((1..4_102_444_800).contains(&left.parse::<u64>().unwrap()), "{left}");
    let late = called(&script, &[("SLURM_JOB_END_TIME", "1000")]);
    assert_eq!(value(&late, "--time-limit"), Some("1s"));
}

#[test]
fn further_options_are_checked() {
    for option in ["--account=lab", "--mem 4G", "--exclusive", "--nodelist=a", "--no-kill", "--time-min=5"] {
        assert!(option.parse::<SbatchOption>().is_ok(), "{option}");
    }
    for option in ["", "-A lab", "--", "account", "--a\n#SBATCH --b", "--a\rb", " --account=lab"] {
        assert!(option.parse::<SbatchOption>().is_err(), "{option:?}");
    }
    for option in ["--array=1-9", "--arr=1-9", "--time=5", "--time 5", "--signal=USR1", "--cpus-per-task=2"] {
        assert!(matches!(option.parse::<SbatchOption>(), Err(InvalidOption::Own { .. })), "{option}");
    }
}

#[test]
fn log_patterns_that_mix_tasks_are_refused() {
    for (patterns, is_sound) in [
        (&["farm-%A_%a.log", "a b/%j", "/dev/null"][..], true),
        (&["", "farm.log", "%A.log", "%%A_%%a", r"a\%A_%a", "%A\n%a"], false),
    ] {
        for pattern in patterns {
            assert_eq!(pattern.parse::<LogPattern>().is_ok(), is_sound, "{pattern:?}");
        }
    }
}
