//! Delivery of results under faults. The clock is paused: it advances when all tasks wait.

use bytes::Bytes;
use optics_model::PackedRecords;
use optics_model::sums::result_bytes;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use super::*;
use crate::leases::SetSwitch;
use crate::testing::{Answer, Call, Coordinator, Method, job, lease, session};

/// A worker that delivers the results that a test passes to it.
struct Worker {
    coordinator: Coordinator,
    held: Arc<HeldLeases>,
    finished: mpsc::UnboundedSender<PendingResult>,
    delivery: JoinHandle<()>,
}

impl Worker {
    async fn start() -> Self {
        let coordinator = Coordinator::start();
        let (session, held) = session(&coordinator).await;
        let (finished, queue) = mpsc::unbounded_channel();
        let delivery = tokio::spawn(deliver(session, held.clone(), queue));
        Self { coordinator, held, finished, delivery }
    }

    /// Reports jobs as traced, without tracing them.
    fn finish(&self, jobs: impl IntoIterator<Item = u32>) {
        for n in jobs {
            self.finish_large(n, result_bytes(&job(1)));
        }
    }

    /// Reports one job as traced, with a result of this nominal size.
    fn finish_large(&self, n: u32, bytes: usize) {
        let result = pending(n, bytes);
        assert!(self.held.add(result.key, result.identity, SetSwitch::new(1)).start());
        self.held.mark_traced(&result.key);
        self.finished.send(result).unwrap();
    }

    /// Waits until everything is delivered; returns the jobs of each call.
    async fn delivered(self) -> Vec<Vec<u32>> {
        drop(self.finished);
        self.delivery.await.unwrap();
        assert_eq!(self.held.all(), [], "a lease without a result is held for ever");
        self.coordinator.calls(Call::complete)
    }
}

fn pending(n: u32, bytes: usize) -> PendingResult {
    let job = job(1);
    let zeros = Bytes::from(vec![0; result_bytes(&job)]);
    let result = TraceResult::Records(PackedRecords::new(&job, zeros).unwrap());
    let room = Arc::new(Semaphore::new(1)).try_acquire_owned().unwrap();
    PendingResult { key: lease(n).key, identity: job.identity(), result, bytes, _room: room }
}

/// A result is delivered until the coordinator has decided on it: the jobs of each call, after the answers to the first.
#[tokio::test(start_paused = true)]
async fn results_are_delivered_until_decided() {
    use CompletionKind::{Conflict, Duplicate, Refused, Stored, Unspecified};
    let error = |status: fn(&'static str) -> Status| Answer::Error(status("records[3] is not finite"));
    let invalid = || error(Status::invalid_argument);
    let passing = vec![
        error(Status::unavailable),
        error(Status::internal),
        error(Status::resource_exhausted),
        Answer::Lost,
        Answer::Outcomes(vec![Duplicate]),
    ];
    let decided = Answer::Outcomes(vec![Stored, Duplicate, Refused, Conflict, Unspecified]);
    let stored = || Answer::Outcomes(vec![Stored]);
    let cases = [
        ("passing errors", passing, vec![vec![0]; 5], vec![]),
        ("decisions", vec![decided], vec![vec![0, 1, 2, 3, 4]], vec![]),
        ("omitted results", vec![stored()], vec![vec![0, 1, 2], vec![1, 2]], vec![]),
        ("a fence", vec![error(Status::permission_denied)], vec![vec![0, 1]], vec![]),
        (
            "an invalid result, which harms no other",
            vec![invalid(), stored(), invalid()],
            vec![vec![0, 1, 2], vec![0], vec![1], vec![2]],
            vec![(1, "result refused: records[3] is not finite".to_owned())],
        ),
    ];
    for (name, answers, expected, expected_failures) in cases {
        let worker = Worker::start().await;
        for answer in answers {
            worker.coordinator.answer(Method::Complete, answer);
        }
        worker.finish(0..expected[0].len() as u32);
        let (coordinator, calls) = (worker.coordinator.clone(), worker.delivered().await);
        assert_eq!(calls, expected, "{name}");
        let failures = coordinator.calls(Call::fail).into_iter();
        let failures: Vec<_> = failures.map(|f| (f.lease.unwrap().job, f.reason)).collect();
        assert_eq!(failures, expected_failures, "{name}");
    }
}

/// A delivery times out after the time that the slowest allowed link needs; then the result is sent again.
#[tokio::test(start_paused = true)]
async fn unanswered_delivery_times_out() {
    let worker = Worker::start().await;
    worker.coordinator.answer(Method::Complete, Answer::Never);
    let start = Instant::now();
    worker.finish_large(7, 1_000_000);
    assert_eq!(worker.delivered().await, vec![vec![7]; 2]);
    let limit = messages::time_limit(1_000_000);
    assert!((limit..limit + Duration::from_secs(5)).contains(&start.elapsed()), "{:?}", start.elapsed());
}

/// An hour without the coordinator loses no result.
#[tokio::test(start_paused = true)]
async fn hour_without_coordinator_loses_no_result() {
    let worker = Worker::start().await;
    worker.coordinator.set_down(true);
    worker.finish(0..3);
    sleep(Duration::from_mins(30)).await;
    worker.finish(3..6);
    sleep(Duration::from_mins(30)).await;
    worker.coordinator.set_down(false);
    let mut jobs = worker.delivered().await.concat();
    jobs.sort_unstable();
    assert_eq!(jobs, [0, 1, 2, 3, 4, 5]);
}

/// A result that could not be stored is delivered again after the others.
#[tokio::test(start_paused = true)]
async fn unstored_result_goes_behind_the_others() {
    let worker = Worker::start().await;
    worker.coordinator.answer(Method::Complete, Answer::Outcomes(vec![CompletionKind::NotStored]));
    for n in 0..3 {
        worker.finish_large(n, BATCH_BYTES);
    }
    assert_eq!(worker.delivered().await, [[0], [1], [2], [0]]);
}

/// A coordinator with a full disk is called with pauses, and gets all results once it has space.
#[tokio::test(start_paused = true)]
async fn unstored_results_are_retried_with_pauses() {
    let worker = Worker::start().await;
    let rounds = 20;
    for _ in 0..rounds {
        worker.coordinator.answer(Method::Complete, Answer::Outcomes(vec![CompletionKind::NotStored; 2]));
    }
    let start = Instant::now();
    worker.finish(0..2);
    let jobs = worker.delivered().await;
    assert_eq!(jobs, vec![vec![0, 1]; rounds + 1]);
    assert!(start.elapsed() > Duration::from_mins(1), "{:?}", start.elapsed());
}

/// Sizes of the batches that waiting results are divided into.
fn batches(count: u32, bytes: usize) -> Vec<usize> {
    let mut waiting: VecDeque<_> = (0..count).map(|n| pending(n, bytes)).collect();
    let mut next = 0..count;
    let mut sizes = Vec::new();
    while !waiting.is_empty() {
        let batch = next_batch(&mut waiting);
        assert!(batch.iter().all(|result| Some(result.key.job) == next.next()), "they keep their order");
        sizes.push(batch.len());
    }
    assert_eq!(next.next(), None);
    sizes
}

/// A call takes as many results as the coordinator allows, and no more once it has its bytes.
#[test]
fn batches_have_allowed_count_and_bytes() {
    assert_eq!(batches(2500, 1), [1024, 1024, 452]);
    assert_eq!(batches(9, 5 << 20), [4, 4, 1]);
    assert_eq!((batches(2, BATCH_BYTES), batches(2, 10 * BATCH_BYTES)), (vec![1, 1], vec![1, 1]));
}

/// Tracing waits for room in the buffer until a result is acknowledged.
#[tokio::test(start_paused = true)]
async fn tracing_waits_for_buffer_room() {
    let buffer = ResultBuffer::new(10 << 10);
    let room = buffer.take(&[4 << 10, 2 << 10]).await.unwrap();
    let waits = tokio::time::timeout(Duration::from_hours(1), buffer.take(&[5 << 10])).await;
    assert!(waits.is_err(), "6 and 5 KiB do not fit into 10");
    drop(room);
    let whole = buffer.take(&[1 << 30, 1 << 30]).await.unwrap();
    let rooms: Vec<_> = whole.iter().map(OwnedSemaphorePermit::num_permits).collect();
    assert_eq!(rooms, [10, 0], "a result that is too large has the buffer for itself");
}
