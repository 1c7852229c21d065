//! On a machine that many share, a coordinator on loopback serves its own user alone.

use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::process::CommandExt as _;

use farm_proto::wire::ListRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_tests::farm::Farm;
use farm_tests::process::{Ran, SOON, farmctl, wait_for};
use tonic::Code;
use tonic::transport::Endpoint;

use super::GRID;

/// Asks for the list of dictionaries, as a program does that shows no key.
async fn ask_without_key(farm: &Farm) -> Result<(), tonic::Status> {
    let channel = Endpoint::from_shared(farm.url()).unwrap().connect().await.unwrap();
    DictionariesClient::new(channel).list(ListRequest::default()).await.map(drop)
}

#[tokio::test(flavor = "multi_thread")]
async fn other_users_of_the_machine_neither_read_nor_command_a_farm_on_loopback() {
    let mut farm = Farm::start(&[]);
    farm.submit("grid", GRID);
    let status = ask_without_key(&farm).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    assert!(status.message().contains("serves its own user's programs"), "{status}");
    // Its key follows the coordinator over restarts, however it ends, and a worker follows, too.
    let worker = farm.worker("worker", &[]);
    let digest = farm.done("grid");
    farm.kill_coordinator();
    farm.start_coordinator();
    assert_eq!(farm.done("grid"), digest);
    wait_for("the worker is back", SOON, || {
        (farm.ask(&["workers"])["workers"].as_array()?.len() == 1).then_some(())
    });
    let joined = farm.events("SUBMITTED");
    assert!(joined[0]["actor"].as_str().unwrap().starts_with("local at 127.0.0.1"), "{joined:?}");
    drop(worker);

    let key = format!("/tmp/resin-farm-{}/{}", rustix::process::getuid().as_raw(), farm.port());
    let about = std::fs::metadata(&key).unwrap();
    assert_eq!(about.mode() & 0o777, 0o600);
    assert_eq!(farm.stop_coordinator(), 0);
    assert!(std::fs::metadata(&key).is_err(), "the key goes with its coordinator");
}

/// Only root can try it as somebody else.
#[test]
fn another_user_is_told_why_and_what_would_help() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let farm = Farm::start(&[]);
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::set_permissions(elsewhere.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    // Where nobody may be allowed to go, the program is copied out of.
    let program = elsewhere.path().join("farmctl");
    std::fs::copy(farm_tests::process::program("farmctl"), &program).unwrap();
    let ran: Ran = std::process::Command::new(&program)
        .args(["list", "--server", &farm.url()])
        .current_dir(elsewhere.path())
        .env_clear()
        .uid(65534)
        .output()
        .unwrap()
        .into();
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    assert!(ran.stderr.contains("farmctl access create"), "{}", ran.stderr);
    let own: Ran = farmctl(farm.folder()).args(["list", "--server", &farm.url()]).output().unwrap().into();
    assert_eq!(own.code, 0, "{}", own.stderr);
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_wants_everybody_in_says_so() {
    let farm = Farm::start(&["--insecure"]);
    ask_without_key(&farm).await.unwrap();
}
