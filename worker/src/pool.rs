//! The threads that trace, apart from those that talk to the coordinator.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use farm_link::memory::usable_bytes;
use optics_model::PackedRecords;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use optics_tracer::{Stopped, trace_set, trace_set_block};
use tokio::sync::oneshot;

use crate::leases::JobSwitches;

/// What tracing a job yields.
#[derive(Debug, Clone)]
pub(crate) enum JobResult {
    Records(PackedRecords),
    /// Of one block of a divided job.
    Sums(Sums),
}

/// Lets a thread begin that has said that it is about to.
pub(crate) type Start = oneshot::Sender<()>;

/// How the tracing of jobs that share their walks ended.
#[derive(Debug)]
pub(crate) enum TraceEnd {
    /// What every job yields.
    Finished(Vec<JobResult>),
    Stopped,
    /// The tracer panicked, which is a defect, or the jobs are too large. The coordinator is given this text.
    Failed(String),
}

#[derive(Debug, Clone)]
pub(crate) struct Pool(Arc<rayon::ThreadPool>);

impl Pool {
    pub(crate) fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let name = |i| format!("trace-{i}");
        Ok(Self(Arc::new(rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(name).build()?)))
    }

    /// Traces jobs that share their walks; their switches end it early. When a thread is about to begin, it says so through
    /// `begun`, and waits for the start.
    pub(crate) async fn trace(
        &self,
        jobs: Vec<JobSpec>,
        switches: Vec<Arc<JobSwitches>>,
        begun: oneshot::Sender<Start>,
    ) -> TraceEnd {
        let (sender, receiver) = oneshot::channel();
        self.0.spawn(move || {
            // Nobody listens any more if the agent was dropped.
            let _ = sender.send(trace_now(&jobs, &switches, begun));
        });
        receiver.await.unwrap_or(TraceEnd::Stopped)
    }
}

fn trace_now(jobs: &[JobSpec], switches: &[Arc<JobSwitches>], begun: oneshot::Sender<Start>) -> TraceEnd {
    // All of them are to be marked.
    let wanted = switches.iter().filter(|switches| switches.start()).count();
    let Some(stop) = switches.first().filter(|_| wanted > 0).map(|switches| switches.all_stopped()) else {
        return TraceEnd::Stopped;
    };
    if let Err(reason) = fits(jobs) {
        return TraceEnd::Failed(reason);
    }
    let (start, started) = oneshot::channel();
    // Nobody waits to be told, or is there to give the start: it begins at once.
    if begun.send(start).is_ok() {
        let _ = started.blocking_recv();
    }
    guarded(|| {
        if let Some(block) = jobs[0].block() {
            let sums = trace_set_block(jobs, block, stop)?;
            return Ok(sums.into_iter().map(JobResult::Sums).collect());
        }
        let records = trace_set(jobs, stop)?;
        let packed = jobs.iter().zip(&records).map(|(job, records)| PackedRecords::pack(job, records));
        Ok(packed.map(JobResult::Records).collect())
    })
}

/// Whether this process may use the memory that jobs need. Without it the process would end.
fn fits(jobs: &[JobSpec]) -> Result<(), String> {
    /// Jobs of less memory are not looked at.
    const SMALL: usize = 256 << 20;
    /// Sums of threads that have not been merged yet, and the records that are made of them.
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
        "it takes {} MiB of memory, this worker may use {}: a grid with fewer albedos or a scene with fewer pixels or \
         channels takes less",
        needed >> 20,
        usable >> 20
    ))
}

/// A panic ends the job and not the thread.
fn guarded(trace: impl FnOnce() -> Result<Vec<JobResult>, Stopped>) -> TraceEnd {
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

    use optics_model::Scene;
    use optics_model::scene::Sensor;
    use optics_tracer::trace;

    use super::*;
    use crate::testing::{as_thick_as, endless_job, job};

    /// Nobody waits to be told that the job begins.
    fn unheard() -> oneshot::Sender<Start> {
        oneshot::channel().0
    }

    #[tokio::test]
    async fn a_thread_announces_a_job_and_waits_for_the_start() {
        let pool = Pool::new(1).unwrap();
        let (begun, begins) = oneshot::channel();
        let traced = tokio::spawn(async move { pool.trace(vec![job(1)], vec![Arc::default()], begun).await });
        let start = begins.await.unwrap();
        // A second, of which such a job needs a small part.
        tokio::time::sleep(std::time::Duration::from_secs(1)).await;
        assert!(!traced.is_finished(), "it does not wait");
        start.send(()).unwrap();
        assert!(matches!(traced.await.unwrap(), TraceEnd::Finished(_)));
    }

    /// 786 GB of sums would end the process.
    #[tokio::test]
    async fn a_job_that_does_not_fit_into_memory_fails() {
        let scene = Scene::paper().with_sensor(Sensor::new(10.0, 4096, 0.0).unwrap());
        let albedo = (1..=4_000_000).map(|i| f64::from(i) / 4_000_001.0).collect();
        let small = job(1);
        let large = JobSpec::new(scene, small.point(), albedo, small.walks(), 1, false).unwrap();
        let pool = Pool::new(1).unwrap();
        let end = pool.trace(vec![large], vec![Arc::default()], unheard()).await;
        let TraceEnd::Failed(text) = end else { panic!("{end:?}") };
        assert!(text.contains("MiB of memory, this worker may use"), "{text}");
    }

    #[tokio::test]
    async fn jobs_have_the_records_that_the_tracer_yields() {
        let pool = Pool::new(1).unwrap();
        let jobs = [job(1), as_thick_as(1)];
        let end = pool.trace(jobs.to_vec(), vec![Arc::default(), Arc::default()], unheard()).await;
        let TraceEnd::Finished(results) = end else { panic!("{end:?}") };
        assert_eq!(results.len(), 2);
        for (result, job) in results.iter().zip(&jobs) {
            let JobResult::Records(records) = result else { panic!("{result:?}") };
            let expected = trace(job, &AtomicBool::new(false)).unwrap();
            assert_eq!(*records, PackedRecords::pack(job, &expected));
        }
    }

    #[tokio::test]
    async fn stopped_jobs_do_not_begin_or_end_early() {
        let pool = Pool::new(1).unwrap();
        let before = Arc::<JobSwitches>::default();
        before.stop();
        assert!(matches!(pool.trace(vec![endless_job()], vec![before], unheard()).await, TraceEnd::Stopped));
        let during = Arc::<JobSwitches>::default();
        let traced = tokio::spawn({
            let (pool, switches) = (pool.clone(), during.clone());
            async move { pool.trace(vec![endless_job()], vec![switches], unheard()).await }
        });
        while !during.is_running() {
            tokio::task::yield_now().await;
        }
        during.stop();
        assert!(matches!(traced.await.unwrap(), TraceEnd::Stopped));
    }

    #[test]
    fn a_panic_becomes_a_text_for_the_coordinator() {
        let end = guarded(|| panic!("σ_t is {}", -1));
        let TraceEnd::Failed(text) = end else { panic!("{end:?}") };
        assert_eq!(text, "the tracer panicked: σ_t is -1");
        let end = guarded(|| std::panic::panic_any(7));
        assert!(matches!(end, TraceEnd::Failed(text) if text.ends_with("no message")));
    }
}
