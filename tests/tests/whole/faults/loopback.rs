//! On a shared machine, a coordinator on loopback serves only its own user.

use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use farm_proto::wire::ListRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_tests::farm::Farm;
use farm_tests::process::{Ran, SOON, farmctl, wait_for};
use tonic::Code;
use tonic::transport::Endpoint;

use super::GRID;

/// Requests the list of dictionaries through the TCP port.
async fn ask_at_the_port(farm: &Farm) -> Result<(), tonic::Status> {
    let channel = Endpoint::from_shared(farm.url()).unwrap().connect().await.unwrap();
    DictionariesClient::new(channel).list(ListRequest::default()).await.map(drop)
}

/// Other users can neither read nor change anything through the port: programs of the farm's user use a private socket.
#[tokio::test(flavor = "multi_thread")]
async fn loopback_farm_is_closed_to_other_users() {
    let mut farm = Farm::start(&[]);
    farm.submit("grid", GRID);
    let status = ask_at_the_port(&farm).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    assert!(status.message().contains("serves its own user's programs"), "{status}");
    // The socket is recreated at restarts, however the coordinator ends, and a worker reconnects.
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

    let socket = socket_of(&farm);
    assert_eq!(std::fs::metadata(socket.parent().unwrap()).unwrap().mode() & 0o777, 0o700);
    assert_eq!(farm.stop_coordinator(), 0);
    assert!(!socket.exists(), "the socket is removed with its coordinator");
}

/// Path of the user's socket.
fn socket_of(farm: &Farm) -> PathBuf {
    let user = rustix::process::getuid().as_raw();
    let folders = [format!("/run/user/{user}/resin-farm"), format!("/tmp/resin-farm-{user}")];
    let found = folders.iter().map(|folder| Path::new(folder).join(farm.port().to_string()));
    found.into_iter().find(|path| path.exists()).expect("the socket is there")
}

/// The socket may be removed by a cleanup of `/tmp`.
#[test]
fn removed_socket_is_restored() {
    let farm = Farm::start(&[]);
    let socket = socket_of(&farm);
    std::fs::remove_file(&socket).unwrap();
    wait_for("the socket is there again", SOON, || socket.exists().then_some(()));
    let own: Ran = farmctl(farm.folder()).args(["list", "--server", &farm.url()]).output().unwrap().into();
    assert_eq!(own.code, 0, "{}", own.stderr);
}

/// Other users that listen on other addresses of the port, or hold idle connections, have no effect on its user.
#[tokio::test(flavor = "multi_thread")]
async fn neighbours_do_not_disturb_the_own_user() {
    let farm = Farm::start(&[]);
    let port = farm.port();
    let ear = std::net::TcpListener::bind(("::1", port)).unwrap();
    ear.set_nonblocking(true).unwrap();
    let crowd: Vec<_> = (0..300).map(|_| TcpStream::connect(("127.0.0.1", port))).collect();
    for host in ["localhost", "127.0.0.1", "[::1]"] {
        let url = format!("http://{host}:{port}");
        let ran: Ran = farmctl(farm.folder()).args(["list", "--server", &url]).output().unwrap().into();
        assert_eq!(ran.code, 0, "{url}: {}", ran.stderr);
    }
    assert!(ear.accept().is_err(), "no call arrives here");
    drop(crowd);
}

/// Clients do not trust a port that another user has taken. The test needs root to run as another user.
#[test]
fn port_of_another_user_is_not_trusted() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::set_permissions(elsewhere.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    let [coordinator, farmctl] = ["farm-coordinator", "farmctl"].map(|name| {
        let program = elsewhere.path().join(name);
        std::fs::copy(farm_tests::process::program(name), &program).unwrap();
        program
    });
    let port = {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        free.local_addr().unwrap().port()
    };
    let mut theirs = std::process::Command::new(coordinator);
    theirs.args(["--insecure", "--listen", &format!("127.0.0.1:{port}")]);
    let theirs = theirs.current_dir(elsewhere.path()).env_clear().uid(65533).stderr(Stdio::null());
    let mut theirs = theirs.spawn().unwrap();
    wait_for("it listens", SOON, || TcpStream::connect(("127.0.0.1", port)).ok());
    let mut list = std::process::Command::new(farmctl);
    list.args(["list", "--server", &format!("http://127.0.0.1:{port}")]);
    let ran: Ran = list.current_dir(elsewhere.path()).env_clear().uid(65534).output().unwrap().into();
    let joined: Ran = list_in(&elsewhere.path().join("farm-data"), 65534);
    theirs.kill().unwrap();
    theirs.wait().unwrap();
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    assert!(ran.stderr.contains("is held by another user of this machine (number 65533)"), "{}", ran.stderr);
    assert!(
        joined.stderr.contains("belongs to another user of this machine (number 65533)"),
        "{}",
        joined.stderr
    );
}

/// The output of `list` as another user of a data folder.
fn list_in(data: &Path, user: u32) -> Ran {
    // Opens the folder, as its owner might.
    std::fs::set_permissions(data, std::fs::Permissions::from_mode(0o777)).unwrap();
    let program = data.parent().unwrap().join("farmctl");
    let mut list = std::process::Command::new(program);
    list.arg("list").arg("--data").arg(data).current_dir("/").env_clear().uid(user).output().unwrap().into()
}

/// The test needs root to run as another user.
#[test]
fn another_user_gets_reason_and_remedy() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let farm = Farm::start(&[]);
    let elsewhere = tempfile::tempdir().unwrap();
    std::fs::set_permissions(elsewhere.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    // The build folder may be closed to user `nobody`, so the program is copied.
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

/// With `--insecure`, the port is open to other users.
#[tokio::test(flavor = "multi_thread")]
async fn insecure_option_opens_the_port() {
    let farm = Farm::start(&["--insecure"]);
    ask_at_the_port(&farm).await.unwrap();
}
