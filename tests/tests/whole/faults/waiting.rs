//! Commands that wait for a dictionary during outages of the coordinator or the network.

use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::process::{LONG, Process, Signal, wait_for};
use farm_tests::proxy::{Direction, Proxy};
use farm_tests::statistics::effort;

use super::{GRID, LONG_JOBS};

/// Commands that wait for the dictionary "grid" at a URL.
fn waiting(farm: &Farm, url: &str) -> Vec<Process> {
    let grid = farm.path("grid.toml");
    let grid = grid.to_str().unwrap();
    let commands = [&["wait", "grid"][..], &["watch", "grid"], &["submit", grid, "--wait"]];
    let start = |command: &&[&str]| {
        let log = farm.path(&format!("{}.log", command[0]));
        Process::start("farmctl", &[&["--server", url], *command].concat(), &log)
    };
    commands.iter().map(start).collect()
}

/// Waits until each has logged `what` this many times.
fn wait_until_logged(waiting: &[Process], what: &str, times: usize) {
    for process in waiting {
        wait_for(what, Duration::from_mins(2), || {
            (process.log().matches(what).count() >= times).then_some(())
        });
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn waiting_outlives_cuts_kills_and_restarts() {
    let mut farm = Farm::start(&["--insecure"]);
    let link = Proxy::start(([127, 0, 0, 1], farm.port()).into()).await;
    farm.submit("grid", GRID);
    let mut waiting = waiting(&farm, &link.url());
    wait_until_logged(&waiting, "following", 1);
    link.cut();
    wait_until_logged(&waiting, "answers again", 1);
    farm.kill_coordinator();
    wait_until_logged(&waiting, "does not answer and is waited for", 2);
    farm.start_coordinator();
    wait_until_logged(&waiting, "answers again", 2);
    assert_eq!(farm.stop_coordinator(), 0);
    wait_until_logged(&waiting, "does not answer and is waited for", 3);
    farm.start_coordinator();
    wait_until_logged(&waiting, "answers again", 3);
    if effort() > 1 {
        farm.coordinator().signal(Signal::STOP);
        std::thread::sleep(Duration::from_mins(2));
        farm.coordinator().signal(Signal::CONT);
        wait_until_logged(&waiting, "answers again", 4);
        // As when a router loses the state of a connection.
        link.freeze();
        wait_until_logged(&waiting, "answers again", 5);
    }
    // `wait` is for scripts and reports only outages.
    wait_until_logged(&waiting[1..], "no worker is connected", 1);
    let worker = farm.worker("worker", &[]);
    for process in &mut waiting {
        assert_eq!(process.exit_within(LONG), 0, "{}", process.log());
    }
    drop(worker);
}

/// Waiting commands do not follow another grid that took the name.
#[tokio::test(flavor = "multi_thread")]
async fn other_grid_of_same_name_ends_waiting() {
    let farm = Farm::start(&["--insecure"]);
    let link = Proxy::start(([127, 0, 0, 1], farm.port()).into()).await;
    farm.submit("grid", GRID);
    let mut waiting = waiting(&farm, &link.url());
    wait_until_logged(&waiting, "following", 1);
    // They cannot observe the changes meanwhile.
    link.hold(Direction::Answers);
    farm.ask(&["cancel", "grid"]);
    farm.ask(&["delete", "grid", "--yes"]);
    farm.submit("grid", LONG_JOBS);
    link.cut();
    link.heal();
    for process in &mut waiting {
        assert_eq!(process.exit_within(LONG), 8, "{}", process.log());
        assert!(process.log().contains("dictionary grid was deleted, or replaced"), "{}", process.log());
    }
}
