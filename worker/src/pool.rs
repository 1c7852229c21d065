//! The threads that trace, apart from those that talk.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use farm_proto::Record;
use farm_proto::job::JobSpec;
use tokio::sync::oneshot;

use crate::tracer::{Stopped, trace};

/// How tracing a job ended.
#[derive(Debug)]
pub(crate) enum Outcome {
    Traced(Vec<Record>),
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

    /// Traces a job; `stop` ends it early.
    pub(crate) async fn trace(&self, job: JobSpec, stop: Arc<AtomicBool>) -> Outcome {
        let (sender, receiver) = oneshot::channel();
        self.0.spawn(move || {
            let outcome = match catch_unwind(AssertUnwindSafe(|| trace(&job, &stop))) {
                Ok(Ok(records)) => Outcome::Traced(records),
                Ok(Err(Stopped)) => Outcome::Stopped,
                Err(panic) => Outcome::Panicked(message(panic.as_ref())),
            };
            // Nobody listens any more if the agent was dropped.
            let _ = sender.send(outcome);
        });
        receiver.await.unwrap_or(Outcome::Stopped)
    }
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    format!("the tracer panicked: {}", text.unwrap_or("no message"))
}
