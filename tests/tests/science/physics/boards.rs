//! Profiles that are interpolated between boards, compared with profiles over those boards from the same walks.

use std::sync::atomic::AtomicBool;

use optics_layers::records;
use optics_model::job::JobSpec;
use optics_model::scene::Channel;
use optics_model::{Scene, TransportPoint, Walks};

/// Profiles over all boards come from one set of walks, so the difference is the error of the interpolation alone. It
/// stays below 0.00003 of white, a tenth of a pixel's noise in a photograph of the example session.
#[test]
fn boards_are_interpolated_without_noise() {
    let boards = Scene::lab().for_all_boards().unwrap();
    let own: Vec<Channel> = [(0.985, 0.024), (0.93, 0.0), (0.96, 0.05), (0.88, 0.03), (1.0, -0.01)]
        .into_iter()
        .enumerate()
        .map(|(i, (light, dark))| Channel::new(format!("own {i}"), light, dark).unwrap())
        .collect();
    let all = boards.channels().iter().chain(&own).cloned().collect();
    let scene = Scene::lab().with_channels(all).unwrap();
    let mut worst = 0.0_f64;
    for (sigma_t, g, thickness_mm) in [(1.0, 0.0, 0.5), (6.0, 0.4, 1.0), (2.5, 0.7, 0.5), (24.0, 0.4, 0.5)] {
        let point = TransportPoint::new(sigma_t, g, thickness_mm, 1.53).unwrap();
        let albedo = vec![0.3, 0.9, 0.99, 0.999, 0.99999];
        let job = JobSpec::new(scene.clone(), point, albedo, Walks::new(20_000).unwrap(), 7, false).unwrap();
        for record in records(&job, &AtomicBool::new(false)).unwrap() {
            let values = |channel: usize| record.profiles[channel].radiance_factor.values();
            for (i, channel) in own.iter().enumerate() {
                let weights = channel.board_weights();
                for (pixel, direct) in values(boards.channels().len() + i).iter().enumerate() {
                    let sum = |(board, weight): (usize, &f64)| weight * f64::from(values(board)[pixel]);
                    let found: f64 = weights.iter().enumerate().map(sum).sum();
                    worst = worst.max((found - f64::from(*direct)).abs());
                }
            }
        }
    }
    eprintln!("largest error {worst:.1e}");
    assert!(worst < 3e-5, "{worst}");
}
