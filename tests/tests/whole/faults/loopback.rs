//! On a shared machine, a coordinator on loopback serves only its own user.

use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use farm_proto::wire::ListRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_tests::farm::Farm;
use farm_tests::process::{Ran, SOON, farmctl, free_port, wait_for};
use tonic::Code;

use super::GRID;

/// Requests the list of dictionaries through the TCP port.
async fn ask_at_the_port(farm: &Farm) -> Result<(), tonic::Status> {
    DictionariesClient::new(farm.channel().await).list(ListRequest::default()).await.map(drop)
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

/// Copies of programs in a folder that other users may write to.
fn for_others<const N: usize>(names: [&str; N]) -> (tempfile::TempDir, [PathBuf; N]) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o777)).unwrap();
    let copies = names.map(|name| farm_tests::process::copied_program(name, folder.path()));
    (folder, copies)
}

/// A program that runs as another user in a folder.
fn as_user(user: u32, program: &Path, folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(program);
    command.args(args).current_dir(folder).env_clear().uid(user);
    command
}

/// Clients do not trust a port that another user has taken. The test needs root to run as another user.
#[test]
fn port_of_another_user_is_not_trusted() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let (elsewhere, [coordinator, farmctl]) = for_others(["farm-coordinator", "farmctl"]);
    let (port, elsewhere) = (free_port(), elsewhere.path());
    let (address, url) = (format!("127.0.0.1:{port}"), format!("http://127.0.0.1:{port}"));
    let mut theirs = as_user(65533, &coordinator, elsewhere, &["--insecure", "--listen", &address]);
    let mut theirs = theirs.stderr(Stdio::null()).spawn().unwrap();
    wait_for("it listens", SOON, || TcpStream::connect(&address).ok());
    let list = |args: &[&str]| -> Ran {
        as_user(65534, &farmctl, elsewhere, &[&["list"], args].concat()).output().unwrap().into()
    };
    let at_port = list(&["--server", &url]);
    // Opens the folder, as its owner might.
    std::fs::set_permissions(elsewhere.join("farm-data"), std::fs::Permissions::from_mode(0o777)).unwrap();
    let in_folder = list(&["--data", "farm-data"]);
    theirs.kill().unwrap();
    theirs.wait().unwrap();
    for (ran, verb) in [(at_port, "is held by"), (in_folder, "belongs to")] {
        assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
        let expected = format!("{verb} another user of this machine (number 65533)");
        assert!(ran.stderr.contains(&expected), "{}", ran.stderr);
    }
}

/// The test needs root to run as another user.
#[test]
fn another_user_gets_reason_and_remedy() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let farm = Farm::start(&[]);
    let (elsewhere, [program]) = for_others(["farmctl"]);
    let list = ["list", "--server", &farm.url()];
    let ran: Ran = as_user(65534, &program, elsewhere.path(), &list).output().unwrap().into();
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    assert!(ran.stderr.contains("farmctl access create"), "{}", ran.stderr);
    let own: Ran = farmctl(farm.folder()).args(list).output().unwrap().into();
    assert_eq!(own.code, 0, "{}", own.stderr);
}
