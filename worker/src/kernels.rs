//! Chooses the kernel that this process traces with, and measures the speed of kernels on this machine.

use std::time::Duration;

use optics_model::job::JobSpec;
use optics_model::{Scene, TransportPoint, Walks};
use optics_tracer::Kernel;
use optics_tracer::probe::{count_events, run_walks};
use tokio::time::Instant;

/// Walks of a trial: some milliseconds.
const WALKS: u64 = 2000;
/// Number of trials, of which the quickest counts.
const TRIALS: u32 = 3;

/// The speed of a kernel on this machine.
#[derive(Debug, Clone, Copy)]
pub struct Speed {
    pub kernel: Kernel,
    /// Scatterings per second and core, all other work of the walks included, in a medium of the paper's grid.
    pub scatterings_per_s: f64,
}

/// Measures a kernel in some hundredths of a second.
pub fn measure(kernel: Kernel) -> Speed {
    let point = TransportPoint::new(6.0, 0.4, 0.5, 1.53).expect("a point of the paper's grid");
    let walks = Walks::new(WALKS).expect("whole batches");
    let job = JobSpec::new(Scene::paper(), point, vec![0.9], walks, 1, false).expect("a job of one albedo");
    let trial = || {
        let began = Instant::now();
        let _ = run_walks(kernel, &job);
        began.elapsed()
    };
    let quickest = (0..TRIALS).map(|_| trial()).min().unwrap_or(Duration::MAX);
    let scatterings = count_events(&job).scatterings as f64;
    Speed { kernel, scatterings_per_s: scatterings / quickest.as_secs_f64().max(1e-9) }
}

/// Chooses the kernel to trace with: the named one, or the fastest. AVX-512 is chosen only if it is measured to be
/// faster than AVX2, because some machines lower their clock when they use it.
pub fn choose(name: Option<&str>) -> Result<Kernel, UnknownKernel> {
    let kernel = match name {
        Some(name) => Kernel::named(name).ok_or_else(|| UnknownKernel::new(name))?,
        None => match (Kernel::fastest(), Kernel::named("avx2")) {
            (wide, Some(narrow)) if wide.name() == "avx512" => faster(wide, narrow),
            (kernel, _) => kernel,
        },
    };
    kernel.choose();
    Ok(kernel)
}

fn faster(wide: Kernel, narrow: Kernel) -> Kernel {
    let [wide, narrow] = [wide, narrow].map(measure);
    // The margin covers differences that are due to other load on the machine.
    if narrow.scatterings_per_s > 1.1 * wide.scatterings_per_s { narrow.kernel } else { wide.kernel }
}

/// This machine has no kernel of that name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("this machine has no kernel {name:?}, only {available}")]
pub struct UnknownKernel {
    name: String,
    available: String,
}

impl UnknownKernel {
    fn new(name: &str) -> Self {
        let available: Vec<_> = Kernel::all().into_iter().map(Kernel::name).collect();
        Self { name: name.to_owned(), available: available.join(", ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel that the machine does not have is refused, and those that it has are listed.
    #[test]
    fn missing_kernel_is_refused_with_choices() {
        let error = choose(Some("abacus")).unwrap_err().to_string();
        assert!(error.starts_with("this machine has no kernel \"abacus\", only "), "{error}");
        assert!(error.ends_with("scalar"), "{error}");
    }
}
