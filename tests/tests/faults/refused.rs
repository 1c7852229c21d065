//! Those that the coordinator does not let in, as the real programs see it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use farm_proto::wire::leases_server::{Leases, LeasesServer};
use farm_proto::wire::{
    AcquireRequest, AcquireResponse, CompleteRequest, CompleteResponse, FailRequest, FailResponse,
    HandBackRequest, HandBackResponse, RegisterRequest, RegisterResponse, RenewRequest, RenewResponse,
};
use farm_tests::farm_processes::{Process, SOON, Signal, free_port, wait_for};
use farm_tests::process::{Ran, farmctl};
use tonic::{Request, Response, Status, Streaming};

/// A coordinator of another version.
struct Newer;

#[tonic::async_trait]
impl Leases for Newer {
    async fn register(&self, _: Request<RegisterRequest>) -> Result<Response<RegisterResponse>, Status> {
        Err(Status::failed_precondition("physics version 1 and 2 differ: install the same"))
    }
    async fn acquire(&self, _: Request<AcquireRequest>) -> Result<Response<AcquireResponse>, Status> {
        Err(Status::unimplemented(""))
    }
    async fn renew(&self, _: Request<RenewRequest>) -> Result<Response<RenewResponse>, Status> {
        Err(Status::unimplemented(""))
    }
    async fn complete(
        &self,
        _: Request<Streaming<CompleteRequest>>,
    ) -> Result<Response<CompleteResponse>, Status> {
        Err(Status::unimplemented(""))
    }
    async fn hand_back(&self, _: Request<HandBackRequest>) -> Result<Response<HandBackResponse>, Status> {
        Err(Status::unimplemented(""))
    }
    async fn fail(&self, _: Request<FailRequest>) -> Result<Response<FailResponse>, Status> {
        Err(Status::unimplemented(""))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_of_another_physics_version_ends_with_exit_code_4_and_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let incoming = tokio_stream::wrappers::TcpListenerStream::new(listener);
    let server = tonic::transport::Server::builder().add_service(LeasesServer::new(Newer));
    let server = tokio::spawn(server.serve_with_incoming(incoming));
    let mut worker = Process::start("farm-worker", &["--server", &url], &folder.path().join("worker.log"));
    assert_eq!(worker.exit_within(SOON), 4);
    assert!(worker.log().contains("the coordinator refused this worker"), "{}", worker.log());
    assert!(worker.log().contains("install the same"), "{}", worker.log());
    server.abort();
}

/// A coordinator with access files, and another set of files that it does not know.
struct Closed {
    folder: tempfile::TempDir,
    _coordinator: Process,
    port: u16,
}

impl Closed {
    fn start(options: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = free_port();
        for set in ["own", "strange"] {
            let port = port.to_string();
            let args = [&["access", "create", set, "--host", "127.0.0.1", "--port", &port], options].concat();
            let created: Ran = farmctl(folder.path()).args(args).output().unwrap().into();
            assert_eq!(created.code, 0, "{}", created.stderr);
        }
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let (listen, access, data) =
            (format!("127.0.0.1:{port}"), path("own/coordinator.toml"), path("data"));
        let args = ["--listen", &listen, "--access", &access, "--data", &data];
        let coordinator = Process::start("farm-coordinator", &args, &folder.path().join("coordinator.log"));
        let closed = Self { folder, _coordinator: coordinator, port };
        wait_for("the coordinator answers", SOON, || {
            (closed.farmctl("own/admin.toml", &["status"]).code == 0).then_some(())
        });
        closed
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn farmctl(&self, access: &str, args: &[&str]) -> Ran {
        farmctl(self.folder.path()).args(args).args(["--access", access]).output().unwrap().into()
    }

    fn worker(&self, access: &str) -> Process {
        let access = self.path(access);
        Process::start("farm-worker", &["--access", access.to_str().unwrap()], &self.path("worker.log"))
    }

    /// Own files with something of theirs changed, as `name`.
    fn forge(&self, original: &str, name: &str, change: impl Fn(&str) -> String) {
        let text = change(&std::fs::read_to_string(self.path(original)).unwrap());
        std::fs::write(self.path(name), text).unwrap();
        private(&self.path(name));
    }

    fn token_of(&self, file: &str) -> String {
        let file: toml::Table = std::fs::read_to_string(self.path(file)).unwrap().parse().unwrap();
        file["token"].as_str().unwrap().to_owned()
    }
}

fn private(file: &Path) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o600)).unwrap();
}

fn fails(ran: &Ran, parts: &[&str]) {
    assert_eq!(ran.code, 1, "{} {}", ran.stdout, ran.stderr);
    for part in parts {
        assert!(ran.stderr.contains(part), "it should tell {part:?}: {}", ran.stderr);
    }
}

#[test]
fn who_shows_a_wrong_token_or_has_another_role_is_told_so_and_does_not_try_again() {
    let farm = Closed::start(&[]);
    let (own, strange) = (farm.token_of("own/worker.toml"), farm.token_of("strange/worker.toml"));
    farm.forge("own/worker.toml", "worker.toml", |text| text.replace(&own, &strange));
    let mut worker = farm.worker("worker.toml");
    assert_eq!(worker.exit_within(SOON), 4, "{}", worker.log());
    assert!(worker.log().contains("token"), "{}", worker.log());
    assert!(!worker.log().contains(&strange), "the token is a secret");
    let mut client = farm.worker("own/client.toml");
    assert_eq!(client.exit_within(SOON), 4, "{}", client.log());
    let (own, strange) = (farm.token_of("own/client.toml"), farm.token_of("strange/client.toml"));
    farm.forge("own/client.toml", "client.toml", |text| text.replace(&own, &strange));
    fails(&farm.farmctl("client.toml", &["list"]), &["token"]);
    fails(&farm.farmctl("own/worker.toml", &["list"]), &["worker"]);
    fails(&farm.farmctl("own/client.toml", &["workers", "drain", "w"]), &["admin"]);
    assert_eq!(farm.farmctl("own/client.toml", &["list"]).code, 0);
}

#[test]
fn who_does_not_know_the_coordinators_certificate_does_not_talk_to_it() {
    let farm = Closed::start(&[]);
    fails(&farm.farmctl("strange/client.toml", &["list"]), &["certificate"]);
    let plain: Ran = farmctl(farm.folder.path())
        .args(["list", "--server", &format!("http://127.0.0.1:{}", farm.port)])
        .output()
        .unwrap()
        .into();
    fails(&plain, &[]);
}

#[test]
fn without_a_certificate_nobody_gets_in_where_all_must_show_one() {
    let farm = Closed::start(&["--mutual"]);
    for (role, name) in [("own/client.toml", "client.toml"), ("own/worker.toml", "worker.toml")] {
        farm.forge(role, name, |text| {
            let mut file: toml::Table = text.parse().unwrap();
            assert!(file.remove("certificate").is_some() && file.remove("key").is_some());
            toml::to_string(&file).unwrap()
        });
    }
    for _ in 0..5 {
        fails(&farm.farmctl("client.toml", &["list"]), &["the access file has none"]);
    }
    let mut bare = farm.worker("worker.toml");
    assert_eq!(bare.exit_within(SOON), 4, "{}", bare.log());
    assert!(bare.log().contains("--mutual"), "{}", bare.log());
    let mut proper = farm.worker("own/worker.toml");
    wait_for("the proper worker is in", SOON, || {
        let listed = farm.farmctl("own/admin.toml", &["workers", "--json"]).stdout;
        let listed: serde_json::Value = serde_json::from_str(&listed).ok()?;
        (listed["data"]["workers"].as_array()?.len() == 1).then_some(())
    });
    proper.signal(Signal::TERM);
    assert_eq!(proper.exit_within(Duration::from_secs(20)), 0);
}

#[test]
fn certificates_of_other_files_let_nobody_in_where_all_must_show_one() {
    let farm = Closed::start(&["--mutual"]);
    for role in ["client", "worker"] {
        let strange: toml::Table =
            std::fs::read_to_string(farm.path(&format!("strange/{role}.toml"))).unwrap().parse().unwrap();
        farm.forge(&format!("own/{role}.toml"), &format!("{role}.toml"), |text| {
            let mut file: toml::Table = text.parse().unwrap();
            for field in ["certificate", "key"] {
                file.insert(field.to_owned(), strange[field].clone());
            }
            toml::to_string(&file).unwrap()
        });
    }
    fails(&farm.farmctl("client.toml", &["list"]), &["does not accept the access file's certificate"]);
    let mut worker = farm.worker("worker.toml");
    assert_eq!(worker.exit_within(SOON), 4, "{}", worker.log());
}

#[test]
fn a_coordinator_whose_port_is_taken_does_not_say_that_it_started() {
    let folder = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, data) = (taken.local_addr().unwrap().to_string(), folder.path().join("data"));
    let log = folder.path().join("coordinator.log");
    let args = ["--listen", &address, "--data", data.to_str().unwrap()];
    let mut coordinator = Process::start("farm-coordinator", &args, &log);
    assert_eq!(coordinator.exit_within(SOON), 1);
    let said = coordinator.log();
    assert!(said.contains(&format!("listening on {address}")), "{said}");
    assert!(!said.contains("COORDINATOR_STARTED"), "{said}");
    drop(taken);
}
