//! Tests sets of jobs that share their walks.

use std::sync::atomic::AtomicBool;

use optics_model::job::JobSpec;
use optics_model::scene::Sensor;
use optics_model::{Scene, TransportPoint, Walks};

use super::{Kernel, Sums, set_sums, trace_set, trace_set_block, trace_with};

static RUN: AtomicBool = AtomicBool::new(false);

/// Three jobs, 3 mean free paths thick.
fn set(walks: u64, derivatives: bool) -> Vec<JobSpec> {
    let scene = std::sync::Arc::new(Scene::paper().with_sensor(Sensor::new(10.0, 40, 0.0).unwrap()));
    let job = |[sigma_t, thickness]: [f64; 2]| {
        let point = TransportPoint::new(sigma_t, 0.4, thickness, 1.53).unwrap();
        JobSpec::new(scene.clone(), point, vec![0.5, 0.99], Walks::new(walks).unwrap(), 1, derivatives)
            .unwrap()
    };
    [[3.0, 1.0], [6.0, 0.5], [12.0, 0.25]].map(job).to_vec()
}

fn alone(job: &JobSpec) -> Sums {
    trace_set(std::slice::from_ref(job), &RUN).unwrap().remove(0)
}

/// A job's sums do not depend on the other jobs that share its walks, nor on the kernel.
#[test]
fn jobs_of_a_set_match_single_jobs() {
    for derivatives in [false, true] {
        let jobs = set(15_000, derivatives);
        let alone: Vec<Sums> = jobs.iter().map(alone).collect();
        assert_ne!(alone[0].sums, alone[1].sums, "lengths count");
        assert_eq!(alone[0].levels, alone[1].levels, "lengths do not count over a uniform base");
        assert_eq!(trace_set(&jobs, &RUN).unwrap(), alone);
        assert_eq!(set_sums(Kernel::SCALAR, &jobs, &RUN, Sums::new).unwrap(), alone);
        let [record, scalar] =
            [Kernel::chosen(), Kernel::SCALAR].map(|kernel| trace_with(kernel, &jobs[2], &RUN));
        assert_eq!(record.unwrap(), scalar.unwrap());
    }
    assert_eq!(trace_set(&[], &RUN), Ok(vec![]));
}

/// The blocks of a set are those of its jobs.
#[test]
fn blocks_of_a_set_match_single_jobs() {
    let jobs = set(1_005_000, false);
    let block = |jobs: &[JobSpec]| trace_set_block(jobs, 1, &RUN).unwrap();
    let alone: Vec<Sums> = jobs.iter().flat_map(|job| block(std::slice::from_ref(job))).collect();
    assert_eq!(block(&jobs), alone);
}

/// Jobs that do not share their walks cannot be traced as a set.
#[test]
#[should_panic(expected = "has walks of its own")]
fn jobs_with_other_walks_are_no_set() {
    let mut jobs = set(5000, false);
    jobs.push(set(5500, false).remove(0));
    let _ = trace_set(&jobs, &RUN);
}
