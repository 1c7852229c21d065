//! Refusals of the coordinator, from the side of the real programs.

use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use farm_tests::farm::Farm;
use farm_tests::process::{Process, Ran, SOON, wait_for};

/// Writes a modified copy of one of the farm's files as `name`.
fn forge(farm: &Farm, original: &str, name: &str, change: impl Fn(&str) -> String) {
    let text = change(&std::fs::read_to_string(farm.path(original)).unwrap());
    std::fs::write(farm.path(name), text).unwrap();
    std::fs::set_permissions(farm.path(name), std::fs::Permissions::from_mode(0o600)).unwrap();
}

fn token_of(farm: &Farm, file: &str) -> String {
    let file: toml::Table = std::fs::read_to_string(farm.path(file)).unwrap().parse().unwrap();
    file["token"].as_str().unwrap().to_owned()
}

fn fails(ran: &Ran, parts: &[&str]) {
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    for part in parts {
        assert!(ran.stderr.contains(part), "{part:?} is missing: {}", ran.stderr);
    }
}

/// The message names the token or the role, but never the token's value.
#[test]
fn wrong_tokens_and_roles_are_not_retried() {
    let farm = Farm::closed(&[], &[]);
    // Another set of files, that the farm does not accept.
    farm.create_access("strange", &[]);
    let (own, strange) = (token_of(&farm, "keys/worker.toml"), token_of(&farm, "strange/worker.toml"));
    forge(&farm, "keys/worker.toml", "worker.toml", |text| text.replace(&own, &strange));
    let mut worker = farm.worker_with("worker.toml", "worker", &[]);
    assert_eq!(worker.exit_within(SOON), 4, "{}", worker.log());
    assert!(worker.log().contains("token"), "{}", worker.log());
    assert!(!worker.log().contains(&strange), "the token is a secret");
    let mut client = farm.worker_with("keys/client.toml", "worker", &[]);
    assert_eq!(client.exit_within(SOON), 4, "{}", client.log());
    let (own, strange) = (token_of(&farm, "keys/client.toml"), token_of(&farm, "strange/client.toml"));
    forge(&farm, "keys/client.toml", "client.toml", |text| text.replace(&own, &strange));
    fails(&farm.farmctl_with("client.toml", &["list"]), &["token"]);
    fails(&farm.farmctl_with("keys/worker.toml", &["list"]), &["worker"]);
    fails(&farm.farmctl_with("keys/client.toml", &["workers", "drain", "w"]), &["admin"]);
    assert_eq!(farm.farmctl_with("keys/client.toml", &["list"]).code, 0);
}

/// With `--mutual`, a client without a valid certificate is refused.
#[test]
fn mutual_tls_needs_a_valid_certificate() {
    let farm = Farm::closed(&["--mutual"], &[]);
    for (role, name) in [("keys/client.toml", "client.toml"), ("keys/worker.toml", "worker.toml")] {
        forge(&farm, role, name, |text| {
            let mut file: toml::Table = text.parse().unwrap();
            assert!(file.remove("certificate").is_some() && file.remove("key").is_some());
            toml::to_string(&file).unwrap()
        });
    }
    for _ in 0..5 {
        fails(&farm.farmctl_with("client.toml", &["list"]), &["the access file has none"]);
    }
    let mut bare = farm.worker_with("worker.toml", "worker", &[]);
    assert_eq!(bare.exit_within(SOON), 4, "{}", bare.log());
    assert!(bare.log().contains("--mutual"), "{}", bare.log());
    let mut proper = farm.worker_with("keys/worker.toml", "worker", &[]);
    wait_for("the valid worker is registered", SOON, || {
        let listed = farm.farmctl_with("keys/admin.toml", &["workers", "--json"]).stdout;
        let listed: serde_json::Value = serde_json::from_str(&listed).ok()?;
        (listed["data"]["workers"].as_array()?.len() == 1).then_some(())
    });
    assert_eq!(proper.terminate(Duration::from_secs(20)), 0);
}

/// A coordinator whose port is taken logs no start.
#[test]
fn taken_port_logs_no_start() {
    let folder = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, data) = (taken.local_addr().unwrap().to_string(), folder.path().join("data"));
    let log = folder.path().join("coordinator.log");
    let args = ["--listen", &address, "--data", data.to_str().unwrap()];
    let mut coordinator = Process::start("farm-coordinator", &args, &log);
    assert_eq!(coordinator.exit_within(SOON), 1);
    let log_text = coordinator.log();
    assert!(log_text.contains(&format!("listening on {address}")), "{log_text}");
    assert!(!log_text.contains("COORDINATOR_STARTED"), "{log_text}");
    drop(taken);
}
