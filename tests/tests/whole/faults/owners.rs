//! Ownership: users change only their own dictionaries, and events record the actor.

use std::time::Duration;

use farm_proto::wire::WatchRequest;
use farm_proto::wire::dictionaries_client::DictionariesClient;
use farm_proto::wire::leases_client::LeasesClient;
use farm_tests::cli;
use farm_tests::farm::Farm;
use farm_tests::grids::{grid_of, traced};
use farm_tests::process::{SOON, run, wait_for};
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

    let [submitted, paused, cancelled] =
        ["SUBMITTED", "PAUSED", "CANCELLED"].map(|kind| farm.events(kind)[0]["actor"].clone());
    assert_eq!([&submitted, &paused], ["alice at 127.0.0.1"; 2]);
    assert_eq!(cancelled, "admin at 127.0.0.1");
    assert_eq!(farm.events("CANCELLED")[0]["message"], "no time 2026 DONE", "a reason is one line");

    let members = farm.ask(&["access", "list", "--folder", "keys"])["members"].take();
    assert_eq!(members[3], serde_json::json!({"role": "client", "name": "alice"}));

    // Revoked again, without a restart.
    farm.ask(&["access", "revoke", "alice", "--folder", "keys"]);
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
    farm.ask(&["access", "revoke", "alice", "--folder", "keys"]);
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
    farm.ask(&["access", "revoke", "anna", "--folder", "keys"]);
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

/// Kept measurements survive a kill of the coordinator. All clients read them, and their owner and admins change them.
#[test]
fn kept_measurements_have_owners_and_survive() {
    let mut farm = Farm::closed(&[], &[]);
    for name in ["alice", "bob"] {
        farm.let_in("client", name);
    }
    let _worker = farm.worker("ada", &[]);
    std::fs::write(farm.path("grid.toml"), cli::GRID).unwrap();
    std::fs::write(farm.path("m.csv"), cli::HEAD.to_owned() + &cli::rows("R", 0.5) + &cli::rows("R", 1.0))
        .unwrap();
    let by = |farm: &Farm, name: &str, args: &[&str]| farm.farmctl_with(&format!("keys/{name}.toml"), args);
    wait_for("alice has access", SOON, || {
        (by(&farm, "alice", &["submit", "grid.toml", "--wait", "-q"]).code == 0).then_some(())
    });
    let measure = ["measure", "m.csv", "--dictionary", "grid", "--mu", "1", "-v", "--keep=first print"];
    let kept = by(&farm, "alice", &measure);
    assert_eq!(kept.code, 0, "{}", kept.stderr);
    let id = kept.stdout.rsplit_once("measurements show ").unwrap().1.split('`').next().unwrap().to_owned();
    farm.kill_coordinator();
    farm.start_coordinator();

    let listed = |name: &str| {
        let listed = cli::json(&by(&farm, name, &["measurements", "--json"]), "measurements");
        listed["measurements"].as_array().unwrap().clone()
    };
    let first = &listed("bob")[0];
    assert_eq!([&first["id"], &first["owner"], &first["title"]], [id.as_str(), "alice", "first print"]);
    let shown = by(&farm, "bob", &["measurements", "show", &id]);
    let table = |text: &str| text.split_once("Shared by similar media").unwrap().1.to_owned();
    assert!(table(&kept.stdout).starts_with(&table(&shown.stdout)), "{}\n{}", kept.stdout, shown.stdout);
    let annotate = ["measurements", "annotate", &id, "--note", "slab 2\nscratched"];
    for args in [&annotate[..], &["measurements", "delete", &id]] {
        let ran = by(&farm, "bob", args);
        assert_eq!(ran.code, 1, "{}", ran.stdout);
        let expected = format!("measurement {id} belongs to alice: only its owner and admins may change it");
        assert!(ran.stderr.contains(&expected), "{}", ran.stderr);
    }
    assert_eq!(by(&farm, "alice", &annotate).code, 0);
    // When it is kept again, title and note stay.
    assert_eq!(by(&farm, "alice", &[&measure[..6], &["--keep"]].concat()).code, 0);
    let [first] = &listed("alice")[..] else { panic!("one is kept: {:?}", listed("alice")) };
    assert_eq!([&first["title"], &first["note"]], ["first print", "slab 2\nscratched"]);
    // An answer that cannot be kept is given nevertheless.
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let fault = "CREATE TRIGGER full BEFORE INSERT ON measurements BEGIN SELECT RAISE(ABORT, 'no room'); END";
    runtime.block_on(farm.execute(fault));
    let lost = by(&farm, "alice", &measure);
    assert_eq!(lost.code, 9, "{}", lost.stderr);
    assert!(lost.stdout.starts_with(kept.stdout.split_once("\nkept: ").unwrap().0), "{}", lost.stdout);
    assert!(lost.stderr.contains("this answer is not kept: storing a measurement"), "{}", lost.stderr);
    let lost = by(&farm, "alice", &[&measure[..], &["--json"]].concat());
    assert_eq!(lost.code, 9, "{}", lost.stderr);
    assert!(cli::json(&lost, "measure")["not_kept"].as_str().unwrap().contains("no room"), "{}", lost.stdout);
    runtime.block_on(farm.execute("DROP TRIGGER full"));
    // A backup contains it.
    assert_eq!(by(&farm, "admin", &["backup", "copy.db"]).code, 0);
    assert_eq!(by(&farm, "admin", &["measurements", "delete", &id]).code, 0);
    let gone = by(&farm, "alice", &["measurements", "show", &id]);
    assert!(gone.stderr.contains("does not exist"), "{}", gone.stderr);
    let restored = run(farm.folder(), &["restore", "copy.db", "--data", "restored"]);
    assert_eq!(restored.code, 0, "{}", restored.stderr);
    let shown = run(farm.folder(), &["measurements", "show", &id, "--data", "restored"]);
    assert!(shown.stdout.starts_with("first print\n"), "{} {}", shown.stdout, shown.stderr);
}
