//! Delivery of results under faults. The clock is paused: it advances when all tasks wait.

use bytes::Bytes;
use optics_model::PackedRecords;
use optics_model::sums::{Sums, result_bytes};
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

/// A result is delivered until it is acknowledged.
#[tokio::test(start_paused = true)]
async fn result_is_delivered_until_acknowledged() {
    let worker = Worker::start().await;
    let passing = [Status::unavailable(""), Status::internal("disk"), Status::resource_exhausted("")];
    for status in passing {
        worker.coordinator.answer(Method::Complete, Answer::Error(status));
    }
    worker.coordinator.answer(Method::Complete, Answer::Lost);
    worker.coordinator.answer(Method::Complete, Answer::Outcomes(vec![CompletionKind::Duplicate]));
    worker.finish([7]);
    assert_eq!(worker.delivered().await, vec![vec![7]; 5]);
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

/// A restarted coordinator does not recognise the worker, which registers again, keeps its lease, and delivers.
#[tokio::test(start_paused = true)]
async fn result_is_redelivered_after_registering_again() {
    let worker = Worker::start().await;
    worker.coordinator.restart(Duration::from_secs(30));
    worker.finish([7]);
    let (coordinator, jobs) = (worker.coordinator.clone(), worker.delivered().await);
    assert_eq!(jobs, vec![vec![7]; 2]);
    let announced = &coordinator.calls(Call::renew)[0].leases;
    assert_eq!(announced.len(), 1, "the lease is kept while its result is on its way");
    assert!(!announced[0].running);
}

/// Results on which the coordinator has decided are dropped.
#[tokio::test(start_paused = true)]
async fn decided_results_are_dropped() {
    let worker = Worker::start().await;
    let decided = [
        CompletionKind::Stored,
        CompletionKind::Duplicate,
        CompletionKind::Refused,
        CompletionKind::Conflict,
        CompletionKind::Unspecified,
    ];
    worker.coordinator.answer(Method::Complete, Answer::Outcomes(decided.to_vec()));
    worker.finish(0..5);
    assert_eq!(worker.delivered().await, [[0, 1, 2, 3, 4]]);
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

/// Results that an answer omits are delivered again.
#[tokio::test(start_paused = true)]
async fn omitted_results_are_delivered_again() {
    let worker = Worker::start().await;
    worker.coordinator.answer(Method::Complete, Answer::Outcomes(vec![CompletionKind::Stored]));
    worker.finish(0..3);
    assert_eq!(worker.delivered().await, [vec![0, 1, 2], vec![1, 2]]);
}

/// An invalid result is reported, and the others are delivered.
#[tokio::test(start_paused = true)]
async fn invalid_result_harms_no_other() {
    let worker = Worker::start().await;
    let invalid = || Answer::Error(Status::invalid_argument("records[3] is not finite"));
    worker.coordinator.answer(Method::Complete, invalid());
    worker.coordinator.answer(Method::Complete, Answer::Outcomes(vec![CompletionKind::Stored]));
    worker.coordinator.answer(Method::Complete, invalid());
    worker.finish(0..3);
    let (coordinator, jobs) = (worker.coordinator.clone(), worker.delivered().await);
    assert_eq!(jobs, [vec![0, 1, 2], vec![0], vec![1], vec![2]]);
    let [failure] = &coordinator.calls(Call::fail)[..] else { panic!("one failure was expected") };
    assert_eq!(failure.lease.as_ref().unwrap().job, 1);
    assert_eq!(failure.reason, "result refused: records[3] is not finite");
}

/// The results of a fenced worker are dropped without a report.
#[tokio::test(start_paused = true)]
async fn fenced_results_are_dropped_unreported() {
    let worker = Worker::start().await;
    let fenced = Status::permission_denied("this worker is fenced off");
    worker.coordinator.answer(Method::Complete, Answer::Error(fenced));
    worker.finish(0..2);
    let (coordinator, jobs) = (worker.coordinator.clone(), worker.delivered().await);
    assert_eq!(jobs, [[0, 1]]);
    assert_eq!(coordinator.calls(Call::fail), []);
}

/// Records and sums arrive complete, with the identity of their job.
#[tokio::test(start_paused = true)]
async fn records_and_sums_arrive_whole() {
    let worker = Worker::start().await;
    let block = job(2).with_block(0).unwrap();
    let mut sums = pending(1, result_bytes(&block));
    (sums.result, sums.identity) = (TraceResult::Sums(Sums::new(&block)), block.identity());
    worker.finish([0]);
    worker.finished.send(sums).unwrap();
    let (coordinator, _) = (worker.coordinator.clone(), worker.delivered().await);
    let results = coordinator.calls(|call| match call {
        Call::Complete(results) => Some(results.clone()),
        _ => None,
    });
    let results: Vec<_> = results.concat().iter().map(|r| (r.key.job, r.bytes, r.identity.clone())).collect();
    let expected = [job(1), block].map(|job| (result_bytes(&job), job.identity().as_bytes().to_vec()));
    let [(records, first), (sums, second)] = expected;
    assert_eq!(results, [(0, records, first), (1, sums, second)]);
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

/// A call takes as many results as the coordinator allows.
#[test]
fn batch_size_has_the_allowed_count() {
    assert_eq!(batches(2500, 1), [1024, 1024, 452]);
}

/// A call takes no more results once it has its bytes.
#[test]
fn batch_ends_at_its_byte_limit() {
    assert_eq!(batches(9, 5 << 20), [4, 4, 1]);
    assert_eq!(batches(2, BATCH_BYTES), [1, 1]);
    assert_eq!(batches(2, 10 * BATCH_BYTES), [1, 1]);
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
