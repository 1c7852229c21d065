//! Runs the threads that trace, separate from those that communicate with the coordinator. A panic or a job that is too
//! large becomes an error message for the coordinator.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use farm_link::memory::usable_bytes;
use optics_layers::{block_of_set, records_of_set};
use optics_model::PackedRecords;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use optics_tracer::Stopped;
use tokio::sync::oneshot;

use crate::leases::JobSwitches;

/// The result of tracing a job.
#[derive(Debug, Clone)]
pub(crate) enum TraceResult {
    Records(PackedRecords),
    /// The sums of one block of a divided job.
    Sums(Sums),
}

/// Signal to a thread that has announced a job and waits to begin.
pub(crate) type StartSignal = oneshot::Sender<()>;

/// The outcome of tracing jobs that share their walks.
#[derive(Debug)]
pub(crate) enum TraceEnd {
    /// The results, one per job.
    Finished(Vec<TraceResult>),
    Stopped,
    /// The tracer panicked, which is a defect, or the jobs are too large. The text is reported to the coordinator.
    Failed(String),
}

#[derive(Debug, Clone)]
pub(crate) struct Pool {
    threads: Arc<rayon::ThreadPool>,
    /// Time that a thread waits before it traces.
    pace: Duration,
}

impl Pool {
    pub(crate) fn new(threads: usize, pace: Duration) -> Result<Self, rayon::ThreadPoolBuildError> {
        let name = |i| format!("trace-{i}");
        let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(name).build()?;
        Ok(Self { threads: Arc::new(threads), pace })
    }

    /// Traces jobs that share their walks; their switches end it early. A thread that is about to begin announces it
    /// through `begun`, and waits for the start signal.
    pub(crate) async fn trace(
        &self,
        jobs: Vec<JobSpec>,
        switches: Vec<Arc<JobSwitches>>,
        begun: oneshot::Sender<StartSignal>,
    ) -> TraceEnd {
        let (sender, receiver) = oneshot::channel();
        let pace = self.pace;
        self.threads.spawn(move || {
            // The receiver is gone if the agent was dropped.
            let _ = sender.send(trace_now(&jobs, &switches, begun, pace));
        });
        receiver.await.unwrap_or(TraceEnd::Stopped)
    }
}

fn trace_now(
    jobs: &[JobSpec],
    switches: &[Arc<JobSwitches>],
    begun: oneshot::Sender<StartSignal>,
    pace: Duration,
) -> TraceEnd {
    // `count` visits all switches, so that all jobs are marked as running.
    let started = switches.iter().filter(|switches| switches.start()).count();
    let Some(stop) = switches.first().filter(|_| started > 0).map(|switches| switches.all_stopped()) else {
        return TraceEnd::Stopped;
    };
    if let Err(reason) = fits(jobs) {
        return TraceEnd::Failed(reason);
    }
    let (start, started) = oneshot::channel();
    // Without a receiver, or if the start signal is dropped, tracing begins at once.
    if begun.send(start).is_ok() {
        let _ = started.blocking_recv();
    }
    guarded(|| {
        wait(pace, stop)?;
        if let Some(block) = jobs[0].block() {
            let sums = block_of_set(jobs, block, stop)?;
            return Ok(sums.into_iter().map(TraceResult::Sums).collect());
        }
        let records = records_of_set(jobs, stop)?;
        let packed = jobs.iter().zip(&records).map(|(job, records)| PackedRecords::pack(job, records));
        Ok(packed.map(TraceResult::Records).collect())
    })
}

/// Waits for a time, in short steps, so that a stop ends it soon.
fn wait(mut left: Duration, stop: &AtomicBool) -> Result<(), Stopped> {
    const STEP: Duration = Duration::from_millis(5);
    while !left.is_zero() {
        if stop.load(Ordering::Relaxed) {
            return Err(Stopped);
        }
        std::thread::sleep(left.min(STEP));
        left = left.saturating_sub(STEP);
    }
    Ok(())
}

/// Checks that this process may use the memory that jobs need. Otherwise it would be killed.
fn fits(jobs: &[JobSpec]) -> Result<(), String> {
    /// Jobs that need less memory are not checked.
    const SMALL: usize = 256 << 20;
    /// Unmerged sums of other threads, and the records that are computed from them.
    const COPIES: usize = 4;
    let needed = jobs.iter().map(Sums::bytes).fold(0, usize::saturating_add).saturating_mul(COPIES);
    if needed <= SMALL {
        return Ok(());
    }
    let usable = usable_bytes().map_or(usize::MAX, |bytes| bytes as usize);
    if needed <= usable {
        return Ok(());
    }
    Err(format!(
        "the job needs {} MiB of memory, this worker may use {}: use a grid with fewer albedos or a scene with fewer \
         pixels or channels",
        needed >> 20,
        usable >> 20
    ))
}

/// A panic ends the job and not the thread.
fn guarded(trace: impl FnOnce() -> Result<Vec<TraceResult>, Stopped>) -> TraceEnd {
    match catch_unwind(AssertUnwindSafe(trace)) {
        Ok(Ok(result)) => TraceEnd::Finished(result),
        Ok(Err(Stopped)) => TraceEnd::Stopped,
        Err(panic) => TraceEnd::Failed(panic_text(panic.as_ref())),
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    format!("the tracer panicked: {}", text.unwrap_or("no message"))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use optics_layers::records;
    use optics_model::Scene;
    use optics_model::scene::Sensor;

    use super::*;
    use crate::testing::{as_thick_as, job};

    /// A channel for the announcement whose receiver is gone.
    fn no_receiver() -> oneshot::Sender<StartSignal> {
        oneshot::channel().0
    }

    /// A thread announces a job and waits for permission to start it: meanwhile another thread traces many such jobs.
    #[tokio::test]
    async fn announced_job_waits_for_its_start() {
        let pool = Pool::new(2, Duration::ZERO).unwrap();
        let (begun, begins) = oneshot::channel();
        let first = pool.clone();
        let traced =
            tokio::spawn(async move { first.trace(vec![job(1)], vec![Arc::default()], begun).await });
        let start = begins.await.unwrap();
        for _ in 0..20 {
            let end = pool.trace(vec![job(1)], vec![Arc::default()], no_receiver()).await;
            assert!(matches!(end, TraceEnd::Finished(_)) && !traced.is_finished(), "{end:?}");
        }
        start.send(()).unwrap();
        assert!(matches!(traced.await.unwrap(), TraceEnd::Finished(_)));
    }

    /// 786 GB of sums would end the process.
    #[tokio::test]
    async fn job_too_large_for_memory_fails() {
        let scene = Scene::paper().with_sensor(Sensor::new(10.0, 4096, 0.0).unwrap());
        let albedo = (1..=4_000_000).map(|i| f64::from(i) / 4_000_001.0).collect();
        let small = job(1);
        let large = JobSpec::new(scene, small.point(), albedo, small.walks(), 1, false).unwrap();
        let pool = Pool::new(1, Duration::ZERO).unwrap();
        let end = pool.trace(vec![large], vec![Arc::default()], no_receiver()).await;
        let TraceEnd::Failed(text) = end else { panic!("{end:?}") };
        assert!(text.contains("MiB of memory, this worker may use"), "{text}");
    }

    /// Jobs have the records that the tracer yields.
    #[tokio::test]
    async fn jobs_have_the_records_of_the_tracer() {
        let pool = Pool::new(1, Duration::ZERO).unwrap();
        let jobs = [job(1), as_thick_as(1)];
        let end = pool.trace(jobs.to_vec(), vec![Arc::default(), Arc::default()], no_receiver()).await;
        let TraceEnd::Finished(results) = end else { panic!("{end:?}") };
        assert_eq!(results.len(), 2);
        for (result, job) in results.iter().zip(&jobs) {
            let TraceResult::Records(found) = result else { panic!("{result:?}") };
            let expected = records(job, &AtomicBool::new(false)).unwrap();
            assert_eq!(*found, PackedRecords::pack(job, &expected));
        }
    }

    /// A panic becomes a message for the coordinator.
    #[test]
    fn panic_becomes_a_message() {
        let end = guarded(|| panic!("σ_t is {}", -1));
        let TraceEnd::Failed(text) = end else { panic!("{end:?}") };
        assert_eq!(text, "the tracer panicked: σ_t is -1");
        let end = guarded(|| std::panic::panic_any(7));
        assert!(matches!(end, TraceEnd::Failed(text) if text.ends_with("no message")));
    }
}
