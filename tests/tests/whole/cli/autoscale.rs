//! `farmctl slurm autoscale` with real workers, on a simulated Slurm.

use std::process::Command;

use farm_tests::cluster::Cluster;
use farm_tests::farm::Farm;
use farm_tests::grids::undisturbed;
use farm_tests::process::{LONG, Process, Ran, SOON, Signal, program, wait_for};
use serde_json::Value;

/// 24 jobs, for workers that take some tenths of a second each.
const GRID: &str = "\
sigma_t_per_mm = [6, 7, 8, 9]
albedo = [0.5, 0.99]
g = [0.0, 0.2, 0.4]
walks = 5000
";

/// `farmctl slurm autoscale` with a check every second.
fn autoscale(farm: &Farm, cluster: &Cluster, worker: &str, options: &[&str]) -> Command {
    let mut command = farm.command(&["slurm", "autoscale", "--json", "--time", "0:10:00", "--every", "1s"]);
    command
        .args(["--worth", "0s", "--worker", worker])
        .args(options)
        .env("PATH", cluster.path())
        .env("FARM_PACE_MS", "300");
    command
}

fn worker() -> String {
    program("farm-worker").to_str().unwrap().to_owned()
}

/// Lines so far: step and message.
fn steps(farm: &Farm) -> Vec<(String, String)> {
    let text = std::fs::read_to_string(farm.path("autoscale.out")).unwrap_or_default();
    let step = |line: &str| {
        let line: Value = serde_json::from_str(line).unwrap();
        assert_eq!(
            (line["api"].as_str(), line["kind"].as_str()),
            (Some("farmctl/1"), Some("slurm-autoscale"))
        );
        let field = |name: &str| line["data"][name].as_str().unwrap().to_owned();
        (field("step"), field("message"))
    };
    text.lines().map(step).collect()
}

fn count(farm: &Farm, step: &str) -> usize {
    steps(farm).iter().filter(|(own, _)| own == step).count()
}

fn start(farm: &Farm, command: &mut Command) -> Process {
    let output = std::fs::File::create(farm.path("autoscale.out")).unwrap();
    Process::spawn_into("farmctl", command, &farm.path("autoscale.err"), output)
}

/// The autoscaler submits workers while there is work, and they end without it.
#[test]
fn workers_come_and_go_with_the_work() {
    let farm = Farm::start(&["--verify-share", "0"]);
    let cluster = Cluster::new(farm.path("slurm"), 2);
    let options = ["--max-workers", "4", "--idle-exit", "2s", "--until-done"];
    farm.submit("grid", GRID);
    let mut autoscaler = start(&farm, &mut autoscale(&farm, &cluster, &worker(), &options));
    assert_eq!(farm.done("grid"), undisturbed(GRID));
    assert_eq!(autoscaler.exit_within(SOON), 0, "{}", autoscaler.log());
    let steps = steps(&farm);
    assert_eq!(steps[0], ("submitted".to_owned(), "submitted 1 worker as job 1".to_owned()));
    assert!(steps.iter().all(|(step, _)| step != "failed" && step != "unknown"), "{steps:?}");
    assert!(steps.last().unwrap().1.starts_with("the farm has no work left"), "{steps:?}");
    // One, one more, two more: the last two wait, since all nodes are in use.
    assert!(cluster.arrays() <= 3, "{steps:?}");
    wait_for("all have gone", LONG, || (cluster.tasks("") == 0).then_some(()));
    let labels: Vec<Value> = farm.events("WORKER_JOINED").iter().map(|e| e["worker"].clone()).collect();
    assert!(labels.contains(&Value::from("slurm:1.1@node1")), "{labels:?}");
}

/// At the start, missing answers are an error; later there is one event until Slurm answers again.
#[test]
fn nothing_is_submitted_while_slurm_is_away() {
    let farm = Farm::start(&[]);
    let cluster = Cluster::new(farm.path("slurm"), 1);
    cluster.set("away", true);
    let ran: Ran = autoscale(&farm, &cluster, &worker(), &["--max-workers", "2"]).output().unwrap().into();
    assert_eq!(ran.code, 1);
    assert!(
        ran.stdout.contains("squeue failed") && ran.stdout.contains("slurm controller"),
        "{}",
        ran.stdout
    );

    cluster.set("away", false);
    let mut autoscaler = start(&farm, &mut autoscale(&farm, &cluster, &worker(), &["--max-workers", "2"]));
    cluster.wait_for_checks(1);
    cluster.set("away", true);
    // Checks that still had an answer are over then.
    wait_for("the event", SOON, || (count(&farm, "unknown") == 1).then_some(()));
    farm.submit("grid", GRID);
    cluster.wait_for_checks(3);
    assert_eq!((count(&farm, "unknown"), cluster.arrays()), (1, 0));
    cluster.set("away", false);
    farm.done("grid");
    assert_eq!(count(&farm, "answering"), 1, "{:?}", steps(&farm));
    assert_eq!(autoscaler.terminate(SOON), 0, "{}", autoscaler.log());
    assert!(steps(&farm).last().unwrap().1.starts_with("stopped; "), "workers still run");
}

/// The event names the worker and its log.
#[test]
fn missing_workers_are_reported_first() {
    let farm = Farm::start(&[]);
    let cluster = Cluster::new(farm.path("slurm"), 4);
    farm.submit("grid", GRID);
    let options = ["--max-workers", "8"];
    let mut autoscaler = start(&farm, &mut autoscale(&farm, &cluster, "/bin/false", &options));
    wait_for("the event", SOON, || (count(&farm, "failed") > 0).then_some(()));
    let failed = steps(&farm).into_iter().find(|(step, _)| step == "failed").unwrap().1;
    assert!(failed.contains("worker 1_1 ended") && failed.contains("(farm-worker-1_1.log)"), "{failed}");
    wait_for("the pause", SOON, || (count(&farm, "holding") == 1).then_some(()));
    let submitted = cluster.arrays();
    cluster.wait_for_checks(3);
    assert_eq!((cluster.arrays(), count(&farm, "holding")), (submitted, 1), "{:?}", steps(&farm));
    autoscaler.signal(Signal::TERM);
    assert_eq!(autoscaler.exit_within(SOON), 0, "{}", autoscaler.log());
}

/// Later refusals are reported once, and the autoscaler pauses.
#[test]
fn sbatch_refusal_ends_the_command_at_start() {
    let farm = Farm::start(&[]);
    let cluster = Cluster::new(farm.path("slurm"), 1);
    farm.submit("grid", GRID);
    cluster.set("refuses", true);
    let ran: Ran = autoscale(&farm, &cluster, &worker(), &["--max-workers", "8"]).output().unwrap().into();
    assert_eq!(ran.code, 1);
    assert!(ran.stdout.contains("QOSMaxSubmitJobPerUserLimit"), "{}", ran.stdout);

    cluster.set("refuses", false);
    let mut autoscaler = start(&farm, &mut autoscale(&farm, &cluster, &worker(), &["--max-workers", "8"]));
    wait_for("one is submitted", SOON, || (cluster.arrays() == 1).then_some(()));
    cluster.set("refuses", true);
    wait_for("the event", SOON, || (count(&farm, "refused") == 1).then_some(()));
    farm.done("grid");
    assert!(autoscaler.is_running());
    assert_eq!((cluster.arrays(), count(&farm, "refused")), (1, 1), "{:?}", steps(&farm));
    assert_eq!(autoscaler.terminate(SOON), 0, "{}", autoscaler.log());
}

/// The autoscaler needs the address of a coordinator that runs.
#[test]
fn autoscaler_needs_a_running_coordinator() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["slurm", "autoscale", "--time", "5", "--max-workers", "2"];
    for args in [&args[..], &[&args[..], &["--local", "--server", "http://127.0.0.1:7700"]].concat()] {
        let ran = farm_tests::process::run(folder.path(), args);
        assert_eq!(ran.code, 1);
        assert!(ran.stderr.contains("--access FILE or --server URL"), "{}", ran.stderr);
    }
}
