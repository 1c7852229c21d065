//! The threads that trace, apart from those that talk.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use optics_model::PackedRecords;
use optics_model::job::JobSpec;
use optics_model::sums::Sums;
use tokio::sync::oneshot;

use crate::held::Switches;
use optics_tracer::{Stopped, trace, trace_block};

/// What a job came to.
#[derive(Debug, Clone)]
pub(crate) enum Traced {
    Records(PackedRecords),
    /// Of one block of a divided job.
    Sums(Sums),
}

/// How tracing a job ended.
#[derive(Debug)]
pub(crate) enum Outcome {
    Traced(Traced),
    Stopped,
    /// The tracer panicked: a defect, told to the coordinator.
    Panicked(String),
}

#[derive(Debug, Clone)]
pub(crate) struct Pool(Arc<rayon::ThreadPool>);

impl Pool {
    pub(crate) fn new(threads: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let name = |i| format!("trace-{i}");
        Ok(Self(Arc::new(rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(name).build()?)))
    }

    /// Traces a job; its switch ends it early.
    pub(crate) async fn trace(&self, job: JobSpec, switches: Arc<Switches>) -> Outcome {
        let (sender, receiver) = oneshot::channel();
        self.0.spawn(move || {
            // Nobody listens any more if the agent was dropped.
            let _ = sender.send(trace_now(&job, &switches));
        });
        receiver.await.unwrap_or(Outcome::Stopped)
    }
}

fn trace_now(job: &JobSpec, switches: &Switches) -> Outcome {
    // First this, then a look at the stop switch: whoever stops what is not running cannot miss it.
    switches.running.store(true, Ordering::SeqCst);
    if switches.stop.load(Ordering::SeqCst) {
        return Outcome::Stopped;
    }
    let traced = catch_unwind(AssertUnwindSafe(|| match job.block() {
        Some(block) => trace_block(job, block, &switches.stop).map(Traced::Sums),
        None => trace(job, &switches.stop).map(|records| Traced::Records(PackedRecords::pack(job, &records))),
    }));
    match traced {
        Ok(Ok(traced)) => Outcome::Traced(traced),
        Ok(Err(Stopped)) => Outcome::Stopped,
        Err(panic) => Outcome::Panicked(message(panic.as_ref())),
    }
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    format!("the tracer panicked: {}", text.unwrap_or("no message"))
}
