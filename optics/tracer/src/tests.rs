//! Tests sets of jobs that share their walks.

use std::sync::atomic::AtomicBool;

use optics_model::job::JobSpec;
use optics_model::scene::{Channel, Sensor};
use optics_model::{Scene, TransportPoint, Walks};

use super::{Kernel, Sums, set_sums, testing, trace_set, trace_set_block, trace_with};

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

/// The bare base, with nothing above it: light that enters at x leaves at x + s, |s| being exponential with the mean b, and
/// crosses the ink twice. So on the light side F = ρ_l − ½ e^(−x/b) (ρ_l − √(ρ_l ρ_d)), and likewise on the dark one. A
/// dark side below black has no root, and light that crosses it once is lost.
#[test]
fn spread_base_has_its_closed_form() {
    const B: f64 = 0.3;
    for rho in [[0.04_f64, 0.9], [-0.02, 0.9]] {
        let rho_dark = rho[0];
        let between = rho[1].sqrt() * rho_dark.max(0.0).sqrt();
        let base = testing::scene(vec![testing::sample(0.0)], [0.0, 90.0], 0.0);
        let channel = Channel::new("mono", rho[1], rho[0]).unwrap();
        let sensor = Sensor::new(4.0, 40, 0.0).unwrap();
        let scene =
            base.with_sensor(sensor).with_base_spread(B).unwrap().with_channels(vec![channel]).unwrap();
        let point = TransportPoint::new(1e-3, 0.0, 1e-3, 1.0).unwrap();
        let walks = Walks::new(400_000).unwrap();
        let job = JobSpec::new(scene, point, vec![0.5], walks, 1, false).unwrap();
        let [record, scalar] =
            [Kernel::chosen(), Kernel::SCALAR].map(|kernel| trace_with(kernel, &job, &RUN).unwrap());
        assert_eq!(record, scalar);
        let estimate = &record[0].profiles[0].radiance_factor;
        for (i, value) in estimate.values().iter().enumerate() {
            let x = sensor.centre_mm(i).abs() / B;
            let half = 0.5 * sensor.pitch_mm() / B;
            let mean = 0.5 * (libm::exp(half - x) - libm::exp(-half - x)) / (2.0 * half);
            let plateau = rho[usize::from(i >= 20)];
            let expected = plateau - mean * (plateau - between);
            let error = f64::from(estimate.std_errors()[i]).max(2e-5);
            assert!(
                (f64::from(*value) - expected).abs() < 4.5 * error,
                "{rho_dark} {i}: {value}, {expected} ± {error}"
            );
        }
    }
}
