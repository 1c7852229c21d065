//! Finds ρ of a board's light side without its gloss, from shots of the board under slip and gel, without a slab.
//!
//! The radiance factor of this stack follows from the scene and ρ, by adding and doubling; haze is known from shots over a
//! light trap. What the dry board reflects beyond is gloss, which gel takes away. Of the dark side this shows no more than
//! is known: what a dry coat mirrors of the lamps is as uncertain as its roughness.

use anyhow::{Context, Result, bail};
use optics_capture::{Board, BoardRho, Calibration, Estimate, Warning};
use optics_layers::Print;
use optics_model::scene::{Channel, Layer, LayerMedium, PriorKind};
use optics_model::{Invalid, Scene};
use optics_tracer::SeenBase;

/// Steps of Newton's method for ρ; the radiance factor is nearly linear in it.
const STEPS: usize = 8;
/// Step of ρ and of haze for slopes.
const STEP: f64 = 1e-4;

/// Factor on ρ of the light side, from the board under slip and gel, and ρ of the dry one, which the scene has. The light of
/// both has its own error.
pub(super) fn light_side(
    scene: &Scene,
    calibration: &Calibration,
    [dry, wet]: [&Board; 2],
    haze: Estimate,
) -> Result<Estimate> {
    if dry.looks_like(wet) {
        bail!(
            "the shots of target.in_gel show the dry board: lay slip and gel on it, without a slab, or leave them out"
        );
    }
    let relative_error = |c: usize| {
        [dry, wet].map(|board| board.light_error(calibration, c)).into_iter().fold(0.0, libm::hypot)
    };
    let seen = |(c, light): (usize, &Estimate)| {
        Estimate::new(light.value, libm::hypot(light.std_error, relative_error(c) * light.value))
    };
    let light: Vec<Estimate> = wet.light.iter().enumerate().map(seen).collect();
    let found = factor(scene, &light, haze).context("the board in gel")?;
    let prior = scene.priors().iter().find(|prior| prior.kind() == PriorKind::LightSide);
    if let Some((low, high)) = prior.map(|prior| prior.range(scene))
        && !(1.0 + low..=1.0 + high).contains(&found.value)
    {
        bail!(
            "target.in_gel: the light side has {:.3} of its dry ρ, from {:.3} to {:.3} is allowed: its gloss is too strong for \
             the scene, or the lamps changed; shoot both again, or take a matt board",
            found.value,
            1.0 + low,
            1.0 + high
        );
    }
    Ok(found)
}

/// A warning if ρ under gel and that of the dry board differ.
pub(super) fn gloss(factor: Estimate, rho: &[BoardRho]) -> Option<Warning> {
    let dry = rho.iter().map(|rho| rho.light.value).sum::<f64>() / rho.len() as f64;
    let warning = Warning::Gloss { wet: dry * factor.value, std_error: dry * factor.std_error, dry };
    ((factor.value - 1.0).abs() > 3.0 * factor.std_error).then_some(warning)
}

/// The factor from the radiance factors of the light side of each channel.
fn factor(scene: &Scene, light: &[Estimate], haze: Estimate) -> Result<Estimate, Invalid> {
    let values: Vec<f64> = light.iter().map(|side| side.value).collect();
    let found = factors(scene, &values, haze.value);
    let here = mean(&found);
    // Haze and errors of the scene are common to the channels.
    let by_haze = (mean(&factors(scene, &values, haze.value + STEP)) - here) / STEP;
    let mut common = (by_haze * haze.std_error).powi(2);
    let base = SeenBase::of(scene);
    for prior in scene.priors().iter().filter(|prior| !prior.kind().is_of_base()) {
        let varied = |sd: f64| scene.varied(prior, sd * prior.std_error(), scene.channels().to_vec());
        let varied = varied(1.0).or_else(|_| varied(-1.0))?;
        let channels = base.through(&varied)?;
        let there = mean(&factors(&varied.with_channels(channels)?, &values, haze.value));
        common += (there - here).powi(2);
    }
    let n = found.len() as f64;
    let squares = found.iter().map(|factor| (factor - here).powi(2)).sum::<f64>();
    let scatter = squares / f64::max(n * (n - 1.0), 1.0);
    let noise = light.iter().map(|side| (side.std_error / side.value).powi(2)).sum::<f64>() / (n * n);
    Ok(Estimate::new(here, (scatter.max(noise) + common).sqrt()))
}

/// The factor of each channel.
fn factors(scene: &Scene, light: &[f64], haze: f64) -> Vec<f64> {
    let above = scene.layers().iter().take_while(|layer| layer.medium() != LayerMedium::Sample).last();
    let gel_ior = match above.map(Layer::medium) {
        Some(LayerMedium::Clear { ior, .. }) => ior,
        _ => 1.0,
    };
    // Without a slab, the gels touch.
    let stack = Print::new(scene, gel_ior, 1.0);
    let factor = |(channel, seen): (&Channel, &f64)| {
        let mut rho = channel.rho_light();
        for _ in 0..STEPS {
            let here = stack.radiance_factors(&[], &[rho, rho + STEP]);
            rho += (seen - haze - here[0]) * STEP / (here[1] - here[0]);
        }
        rho / channel.rho_light()
    };
    scene.channels().iter().zip(light).map(factor).collect()
}

fn mean(channels: &[f64]) -> f64 {
    channels.iter().sum::<f64>() / channels.len() as f64
}

#[cfg(test)]
mod tests {
    use optics_tracer::BareBoard;

    use super::*;

    /// Under a haze of 0.008, a light side of 0.97 of the dry ρ is found in the radiance factors of the stack; an error of
    /// haze widens it. The stack is within 10 % of the dry board.
    #[test]
    fn board_in_gel_shows_gloss() {
        let scene = Scene::lab();
        let stack = Print::new(&scene, 1.33, 1.0);
        let seen = |channel: &Channel| stack.radiance_factors(&[], &[0.97 * channel.rho_light()])[0] + 0.008;
        let light = [0, 1, 2].map(|c| Estimate::new(seen(&scene.channels()[c]), 1e-4));
        let found = |std_error| factor(&scene, &light, Estimate::new(0.008, std_error)).unwrap();
        let (sharp, wide) = (found(1e-4), found(4e-3));
        assert!((sharp.value - 0.97).abs() < 1e-6, "{sharp:?}");
        assert!((5e-4..5e-3).contains(&sharp.std_error), "{sharp:?}");
        // Light between coat and base makes radiance rise twice as fast as ρ.
        assert!((1.5e-3..3e-3).contains(&wide.std_error), "{wide:?}");
        let side = Estimate::new(0.93, 0.01);
        let rho = [BoardRho { light: side, dark: side, under_darker_white: [0.0; 2] }; 3];
        let warning = gloss(sharp, &rho).unwrap().to_string();
        assert!(warning.contains("0.902") && warning.contains("dry 0.930"), "{warning}");
        assert_eq!(gloss(Estimate::new(0.99, 0.004), &rho), None);
        let dry = scene.channels()[0].rho_light();
        let (wet, dry) =
            (stack.radiance_factors(&[], &[dry])[0], BareBoard::of(&scene).unwrap().apparent(dry));
        assert!((wet / dry - 1.0).abs() < 0.1, "{wet} {dry}");
    }
}
