//! Tests streams of valid and invalid results.

use bytes::Bytes;
use farm_proto::lease::{Lease, LeaseKey};
use optics_model::Digest;

use super::*;
use crate::actor::Actor;
use crate::farm::{Header, Piece, Refusal};
use crate::stored::Machine;

async fn begun() -> (Arc<Farm>, WorkerId, Vec<Lease>, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(DataDir::lock(dir.path()).unwrap(), |_| {}).await.unwrap();
    let farm = load(store).await;
    farm.submit(&Actor::default(), name(), grid(), 0).await.unwrap();
    let worker = worker(&farm, "worker").await;
    let leases = farm.acquire_now(&worker, 3).unwrap().leases;
    (farm, worker, leases, dir)
}

fn header(worker: &WorkerId, key: LeaseKey, identity: Digest) -> Piece {
    Piece::Header(Header { worker: worker.clone(), key, identity })
}

/// The pieces of a result in two halves.
fn pieces(worker: &WorkerId, lease: &Lease, value: f32) -> Vec<Piece> {
    let JobResult::Records(records) = content(&lease.job, value) else { unreachable!() };
    let bytes = records.bytes();
    let (first, second) = (bytes.slice(..bytes.len() / 2), bytes.slice(bytes.len() / 2..));
    vec![header(worker, lease.key, lease.job.identity()), Piece::Records(first), Piece::Records(second)]
}

async fn receive(farm: &Arc<Farm>, pieces: Vec<Piece>) -> Result<Vec<Result<Outcome, Refusal>>, FarmError> {
    let machine = Machine { token: "node1".to_owned(), address: "10.0.0.1".to_owned(), ..Machine::default() };
    farm.receive(&machine, tokio_stream::iter(pieces.into_iter().map(Ok))).await
}

/// If one result is refused, the others of its stream are stored. A worker that contradicts itself loses all its records.
#[tokio::test]
async fn refused_result_does_not_end_its_stream() {
    let (farm, worker, leases, _dir) = begun().await;
    let mut stream = pieces(&worker, &leases[0], 0.25);
    stream.push(header(&worker, leases[1].key, Digest::from_bytes([1; 32])));
    stream.push(Piece::Records(Bytes::from_static(&[0; 7])));
    stream.extend(pieces(&worker, &leases[2], 0.5));
    let delivered = receive(&farm, stream).await.unwrap();
    assert!(
        matches!(
            &delivered[..],
            [Ok(Outcome::Finished { .. }), Err(Refusal::Unwanted(_)), Ok(Outcome::Finished { .. })]
        ),
        "{delivered:?}"
    );
    assert_eq!(jobs_done(&farm), 2);
    let again = receive(&farm, pieces(&worker, &leases[0], 0.25)).await.unwrap();
    assert!(matches!(&again[..], [Ok(outcome)] if outcome.kind() == OutcomeKind::Duplicate), "{again:?}");
    let other = receive(&farm, pieces(&worker, &leases[0], 0.75)).await.unwrap();
    assert!(matches!(&other[..], [Ok(outcome)] if outcome.kind() == OutcomeKind::Conflict), "{other:?}");
    assert_eq!(jobs_done(&farm), 0, "a machine that contradicts itself loses all its results");
}

/// Malformed results are refused with the name of the field, and nothing of them is stored.
#[tokio::test]
async fn malformed_results_are_refused_with_field() {
    let (farm, worker, leases, _dir) = begun().await;
    let whole = || pieces(&worker, &leases[0], 0.25);
    let too_short = || whole().into_iter().take(2).collect::<Vec<_>>();
    let with = |more: Piece| whole().into_iter().chain([more]).collect::<Vec<_>>();
    let nan = || {
        let mut bytes = vec![0; PackedRecords::bytes_of(&leases[0].job)];
        bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        vec![header(&worker, leases[0].key, leases[0].job.identity()), Piece::Records(bytes.into())]
    };
    let cases = [
        (Vec::new(), "content"),
        (vec![Piece::Records(Bytes::from_static(b"x"))], "content"),
        (with(Piece::Sums(Bytes::from_static(b"x"))), "content"),
        (with(Piece::Records(Bytes::new())), "records"),
        (with(Piece::Records(Bytes::from_static(b"x"))), "records"),
        (too_short(), "records"),
        (nan(), "record "),
    ];
    for (stream, field) in cases {
        let what = format!("{stream:?}");
        match receive(&farm, stream).await {
            Err(FarmError::Invalid(why)) => assert!(why.field().starts_with(field), "{what}: {why}"),
            other => panic!("{what}: {other:?}"),
        }
    }
    assert_eq!(jobs_done(&farm), 0);
}
