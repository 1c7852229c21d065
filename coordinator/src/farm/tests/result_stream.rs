//! Tests streams of valid and invalid results.

use std::time::Duration;

use bytes::Bytes;
use farm_proto::lease::LeaseKey;
use optics_model::Digest;

use super::*;
use crate::farm::result_room::Taken;
use crate::farm::{Header, Piece, Refusal};

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

/// If one result is refused, the others of its stream are stored. A worker that contradicts itself loses all its records,
/// and the job has those of the coordinator.
#[tokio::test]
async fn refused_result_does_not_end_its_stream() {
    let (farm, worker, _dir) = begun(0.0).await;
    let leases = farm.acquire_now(&worker, 3).unwrap().leases;
    let mut stream = pieces(&worker, &leases[0], 0.25);
    stream.push(header(&worker, leases[1].key, Digest::from_bytes([1; 32])));
    stream.push(Piece::Records(Bytes::from_static(&[0; 7])));
    stream.extend(pieces(&worker, &leases[2], 0.5));
    let delivered = receive(&farm, stream).await.unwrap();
    let [Ok(first), Err(Refusal::Unwanted(_)), Ok(third)] = &delivered[..] else { panic!("{delivered:?}") };
    assert_eq!([first.kind(), third.kind()], [OutcomeKind::Stored; 2]);
    assert_eq!(jobs_done(&farm), 2);
    for (value, kind, left) in [(0.25, OutcomeKind::Duplicate, 2), (0.75, OutcomeKind::Conflict, 1)] {
        let again = receive(&farm, pieces(&worker, &leases[0], value)).await.unwrap();
        assert!(matches!(&again[..], [Ok(outcome)] if outcome.kind() == kind), "{again:?}");
        super::judge::settled(&farm).await;
        assert_eq!(jobs_done(&farm), left, "{kind:?}");
    }
}

/// A worker whose result waits for the coordinator's memory is not called slow.
#[tokio::test]
async fn wait_for_memory_is_no_slowness() {
    let (farm, worker, _dir) = begun(0.0).await;
    let leases = farm.acquire_now(&worker, 1).unwrap().leases;
    let machine = Machine { token: "node1".to_owned(), address: "10.0.0.1".to_owned(), ..Machine::default() };
    let [mut share, mut overdraft] = [(); 2].map(|()| Taken::default());
    farm.results.take(&machine, &mut share, 128 << 20).await;
    farm.results.take(&machine, &mut overdraft, 1).await;
    tokio::time::pause();
    let (start, released) = (tokio::time::Instant::now(), tokio::sync::oneshot::channel());
    let (release, done) = released;
    tokio::spawn(async move {
        tokio::time::sleep(Duration::from_mins(10)).await;
        tokio::time::resume();
        drop((share, overdraft));
        release.send(()).unwrap();
    });
    let stream = tokio_stream::iter(pieces(&worker, &leases[0], 0.25).into_iter().map(Ok::<_, FarmError>));
    let delivered = farm.receive(&machine, stream).await.unwrap();
    assert!(
        matches!(&delivered[..], [Ok(outcome)] if outcome.kind() == OutcomeKind::Stored),
        "{delivered:?}"
    );
    done.await.unwrap();
    assert!(start.elapsed() >= Duration::from_mins(10));
}

/// Malformed results are refused with the name of the field, and nothing of them is stored.
#[tokio::test]
async fn malformed_results_are_refused_with_field() {
    let (farm, worker, _dir) = begun(0.0).await;
    let leases = farm.acquire_now(&worker, 3).unwrap().leases;
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
