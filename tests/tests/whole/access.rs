//! Access control over real sockets: encryption, tokens and roles, certificates, and the number of connections.

mod guarded;
mod unauthenticated;
mod unfinished;

use farm_coordinator::connections::Limits;
use farm_link::{ClientAccess, Role, Target, failure};
use farm_tests::process::SOON;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout};
use tonic::{Code, Request};

use guarded::{Access, GuardedServer, call, health};

const LEASES: &str = "/farm.v1.Leases/Acquire";
const FITS: &str = "/farm.v1.Fits/Fit";
const ADMIN: &str = "/farm.v1.Admin/Drain";

/// Each role may make its own calls, and a refusal names the roles that are needed.
#[tokio::test]
async fn each_role_may_do_its_own_calls() {
    let farm = GuardedServer::start(Access::Tokens).await;
    let cases = [
        (LEASES, [Ok(()), Err("worker or admin"), Ok(())]),
        (FITS, [Err("client or admin"), Ok(()), Ok(())]),
        (ADMIN, [Err("admin"), Err("admin"), Ok(())]),
    ];
    for (role_index, role) in Role::ALL.into_iter().enumerate() {
        let link = farm.link(role).await;
        for (path, allowed) in &cases {
            match (call(&link, path).await, allowed[role_index]) {
                (Ok(answer), Ok(())) => {
                    let seen = answer.metadata().get("x-caller").unwrap().to_str().unwrap();
                    assert_eq!(seen, format!("{role} {role}"), "the handler receives the caller");
                }
                (Err(status), Err(needed)) => {
                    assert_eq!(status.code(), Code::PermissionDenied, "{status}");
                    let expected =
                        format!("a token of role {needed}, and the one given ({role}) has role {role}");
                    assert!(status.message().contains(&expected), "{status}");
                    assert_eq!(status.metadata().get("x-request-id").unwrap().len(), 32, "for the log");
                }
                (answer, allowed) => panic!("{role} {path}: {answer:?} instead of {allowed:?}"),
            }
        }
    }
}

/// Without a token, or with a wrong one, only the health service answers.
#[tokio::test]
async fn only_health_works_without_a_token() {
    let farm = GuardedServer::start(Access::Tokens).await;
    let anonymous = farm.tls_channel_without_token().await;
    let status = call(&anonymous, FITS).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    let reason = "needs a token of role client or admin, and there is none";
    assert!(status.message().contains(reason), "{status}");
    health(anonymous).await.unwrap();

    let text = farm.text(Role::Client);
    let token = text.lines().find(|line| line.starts_with("token")).unwrap();
    let forged = text.replace(token, &format!("token = \"{}\"", "0".repeat(64)));
    let link = farm.target_of_text(&forged).connect().await.unwrap();
    let status = call(&link, FITS).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    assert!(status.message().contains("does not know the one given"), "{status}");
    let status = call(&link, "/farm.v1.Nothing/Here").await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated, "unauthenticated callers cannot probe for methods");
    health(link).await.unwrap();
}

/// A certificate is valid for the hosts that were named.
#[tokio::test]
async fn certificate_covers_the_named_hosts() {
    let farm = GuardedServer::start(Access::Tokens).await;
    let access = ClientAccess::read(&farm.file(Role::Client)).unwrap();
    for host in ["localhost", "127.0.0.1"] {
        let url = format!("https://{host}:{}", farm.address.port());
        call(&Target::new(Some(&access), Some(&url)).unwrap().connect().await.unwrap(), FITS).await.unwrap();
    }
    let text = farm.text(Role::Client);
    let under =
        |name: &str| farm.target_of_text(&text.replacen("role", &format!("server_name = {name:?}\nrole"), 1));
    call(&under("farm.example.org").connect().await.unwrap(), FITS).await.unwrap();
    let error = under("other.example.org").connect().await.unwrap_err();
    let message = failure(&error, "https://localhost").unwrap();
    assert!(message.contains("its certificate is for another host"), "{message}");
    let other = GuardedServer::start(Access::Tokens).await;
    let url = format!("https://localhost:{}", other.address.port());
    let error = Target::new(Some(&access), Some(&url)).unwrap().connect().await.unwrap_err();
    let message = failure(&error, &url).unwrap();
    assert!(message.contains("not of the authority that this access file knows"), "{message}");
}

/// The message for a coordinator that cannot be called.
async fn why_unreachable(target: &Target) -> String {
    let message = match target.connect().await {
        Ok(link) => failure(&call(&link, FITS).await.unwrap_err(), target.url()),
        Err(error) => failure(&error, target.url()),
    };
    message.expect("the error has a message for users")
}

/// A connection with the wrong kind of encryption fails quickly, with the reason.
#[tokio::test]
async fn mistaken_encryption_is_reported_quickly() {
    let start = Instant::now();
    let encrypted = GuardedServer::start(Access::Tokens).await;
    let plain_url = format!("http://{}", encrypted.address);
    let target = Target::new(None, Some(&plain_url)).unwrap();
    let message = timeout(SOON, why_unreachable(&target)).await.unwrap();
    assert!(message.contains("--access FILE") || message.contains("https://"), "{message}");

    let plain = GuardedServer::start(Access::Open).await;
    let access = ClientAccess::read(&encrypted.file(Role::Client)).unwrap();
    let wrong =
        Target::new(Some(&access), Some(&format!("https://localhost:{}", plain.address.port()))).unwrap();
    let message = timeout(SOON, why_unreachable(&wrong)).await.unwrap();
    assert!(message.contains("what answers there is not encrypted"), "{message}");
    assert!(start.elapsed() < SOON);
}

/// The log lines of a handler carry method, request id and caller.
#[tokio::test]
async fn handler_logs_carry_request_and_caller() {
    let farm = GuardedServer::start(Access::Tokens).await;
    let (log, _logged) = guarded::Log::start();
    let link = farm.link(Role::Worker).await;
    let mut request = Request::new(());
    request.metadata_mut().insert("x-request-id", "run-7".parse().unwrap());
    guarded::call_with(&link, LEASES, request).await.unwrap();
    let text = log.text();
    let line = text.lines().find(|line| line.contains("handling")).expect("the handler's line");
    for part in [LEASES, "request_id=run-7", "caller=\"worker\""] {
        assert!(line.contains(part), "{part:?} is not in {line:?}");
    }
    let token = farm.text(Role::Worker);
    let token = token.split('"').find(|word| word.len() == 64).unwrap();
    call(&link, ADMIN).await.unwrap_err();
    let text = log.text();
    assert!(text.contains("calls have been refused") && text.contains("peer=\"127.0.0.1:"), "{text}");
    assert!(!text.contains(token), "tokens are not logged");
}

/// Idle connections are kept if they answer pings, and dead ones are closed.
#[tokio::test]
async fn only_live_idle_connections_are_kept() {
    // The server of these tests pings five times in this time.
    let limits = Limits { silence: guarded::PING * 5, ..Limits::new(8, None) };
    let farm = GuardedServer::start_with(Access::Tokens, limits).await;
    let link = farm.link(Role::Client).await;
    health(link.clone()).await.unwrap();
    let start = Instant::now();
    // Had the live one ended with the first dead one, it would not be there with the second.
    for _ in 0..2 {
        let mut dead = TcpStream::connect(farm.address).await.unwrap();
        // The first bytes of a handshake that is never completed.
        let hello = [&[0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3][..], &[7; 20]].concat();
        dead.write_all(&hello).await.unwrap();
        farm.wait_for_open(2).await;
        farm.wait_for_open(1).await;
    }
    assert!(start.elapsed() >= 2 * limits.silence);
    health(link).await.unwrap();
}
