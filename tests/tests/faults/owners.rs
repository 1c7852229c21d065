//! Ownership: users change only their own dictionaries, and events record the actor.

use std::time::Duration;

use farm_proto::wire::WatchRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::leases_client::LeasesClient;
use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced};
use farm_tests::process::{SOON, wait_for};
use farm_tests::test_worker::on_wire;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Code;

use super::GRID;

/// Events name the actor.
#[test]
fn only_owner_and_admins_change_a_dictionary() {
    let farm = Farm::closed(&[], &[]);
    for name in ["alice", "bob"] {
        farm.let_in("client", name);
    }
    let by = |name: &str, args: &[&str]| farm.farmctl_with(&format!("keys/{name}.toml"), args);
    std::fs::write(farm.path("grid.toml"), GRID).unwrap();
    // The coordinator reads its access files once per second.
    wait_for("alice has access", SOON, || (by("alice", &["submit", "grid.toml"]).code == 0).then_some(()));
    assert_eq!(farm.show("grid")["owner"], "alice");
    for args in [
        &["cancel", "grid"][..],
        &["pause", "grid"],
        &["retry", "grid"],
        &["priority", "grid", "9"],
        &["delete", "grid", "--yes"],
    ] {
        let ran = by("bob", args);
        assert_eq!(ran.code, 1, "{args:?}: {}", ran.stdout);
        let expected = "dictionary grid belongs to alice: only its owner and admins may change it";
        assert!(ran.stderr.contains(expected), "{}", ran.stderr);
    }
    assert_eq!(by("bob", &["show", "grid"]).code, 0, "all may read");
    assert_eq!(by("bob", &["submit", "grid.toml"]).code, 0, "the same grid changes nothing");
    assert_eq!(by("alice", &["pause", "grid"]).code, 0);
    assert_eq!(by("admin", &["cancel", "grid", "--reason", "no time\n2026 DONE"]).code, 0);

    // Events are written shortly after the change.
    let actor =
        |kind: &str| wait_for(kind, SOON, || farm.events(kind).first()?["actor"].as_str().map(str::to_owned));
    let [submitted, paused, cancelled] = ["SUBMITTED", "PAUSED", "CANCELLED"].map(actor);
    assert_eq!([&submitted, &paused], ["alice at 127.0.0.1"; 2]);
    assert_eq!(cancelled, "admin at 127.0.0.1");
    assert_eq!(farm.events("CANCELLED")[0]["message"], "no time 2026 DONE", "a reason is one line");

    let let_in =
        farm.farmctl_with("keys/admin.toml", &["access", "list", "--folder", "keys", "--json"]).stdout;
    let let_in: serde_json::Value = serde_json::from_str(&let_in).unwrap();
    assert_eq!(let_in["data"]["members"][3], serde_json::json!({"role": "client", "name": "alice"}));

    // Revoked again, without a restart.
    let ran = farm.farmctl_with("keys/admin.toml", &["access", "revoke", "alice", "--folder", "keys"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    wait_for("alice has no access", SOON, || (by("alice", &["list"]).code == 1).then_some(()));
    assert!(by("alice", &["list"]).stderr.contains("does not know the one given"));
    assert_eq!(by("bob", &["list"]).code, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn revoking_a_token_ends_its_idle_streams() {
    let farm = Farm::closed(&[], &[]);
    farm.let_in("client", "alice");
    farm.submit("grid", GRID);
    let mut alice = DictionariesClient::new(farm.link_with("keys/alice.toml"));
    let request = WatchRequest { name: "grid".to_owned() };
    let mut updates = loop {
        match alice.watch(request.clone()).await {
            Ok(updates) => break updates.into_inner(),
            Err(status) => assert_eq!(status.code(), Code::Unauthenticated, "not read yet: {status}"),
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    };
    assert!(updates.message().await.unwrap().is_some(), "the current state");
    let ran = farm.farmctl_with("keys/admin.toml", &["access", "revoke", "alice", "--folder", "keys"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let ended = tokio::time::timeout(SOON, updates.message()).await.unwrap().unwrap_err();
    assert_eq!(ended.code(), Code::Unauthenticated);
    assert_eq!(ended.message(), "the token of this call (alice) was revoked");
}

/// A result that arrives after its token was revoked is not stored.
#[tokio::test(flavor = "multi_thread")]
async fn result_after_revocation_is_not_stored() {
    let farm = Farm::with_tokens(&["anna"], &[]);
    farm.submit("grid", GRID);
    let mut anna = farm.test_worker_with("anna", "anna").await.unwrap();
    let lease = anna.acquire(1).await.unwrap().remove(0);
    let records = on_wire(&traced(&grid_of(GRID), lease.key.job as usize));
    let (pieces, stream) = tokio::sync::mpsc::channel(4);
    let mut client = LeasesClient::new(farm.link_with("keys/anna.toml"));
    let delivery = tokio::spawn(async move { client.complete(ReceiverStream::new(stream)).await });
    let mut messages = anna.messages(&lease, records).into_iter();
    pieces.send(messages.next().unwrap()).await.unwrap();
    let ran = farm.farmctl_with("keys/admin.toml", &["access", "revoke", "anna", "--folder", "keys"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let shut_out = async {
        while anna.renew(&lease, true).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(SOON, shut_out).await.unwrap();
    for part in messages {
        // The stream may have ended already.
        let _ = pieces.send(part).await;
    }
    drop(pieces);
    let ended = tokio::time::timeout(SOON, delivery).await.unwrap().unwrap().unwrap_err();
    assert_eq!(ended.code(), Code::Unauthenticated, "{ended}");
    assert_eq!(farm.show("grid")["records_done"], 0);
}
