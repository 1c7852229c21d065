//! Finds haze, and the reflectance of a board's light side without gloss, from shots of the board under slip and gel,
//! without a slab.
//!
//! The radiance factor of this stack follows from the scene and ρ, by adding and doubling. What the dark side shows beyond
//! is haze; the ρ that explains the rest of the light side, over that of the dry board, is 1 unless gloss was taken for
//! light that the board scatters.

use anyhow::{Context, Result};
use optics_capture::{Board, BoardRho, Estimate};
use optics_layers::Print;
use optics_model::scene::{Channel, Layer, LayerMedium};
use optics_model::{Invalid, Scene};
use optics_tracer::SeenBase;

/// Steps of Newton's method for ρ; the radiance factor is nearly linear in it.
const STEPS: usize = 8;
/// Step of ρ for the slope of the radiance factor.
const STEP: f64 = 1e-4;

/// The results of shots under slip and gel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InGel {
    /// Radiance factor that slip, gel and camera add everywhere.
    pub haze: Estimate,
    /// Factor on ρ of the light side.
    pub light_side: Estimate,
}

impl InGel {
    /// From the board under slip and gel, and ρ of the dry one, which the scene has.
    pub(super) fn find(scene: &Scene, rho: &[BoardRho; 3], seen: &Board) -> Result<Self> {
        let errors = rho.each_ref().map(|rho| rho.dark.std_error);
        let sides = [0, 1, 2].map(|c| [seen.dark[c], seen.light[c]]);
        Self::of_sides(scene, errors, sides).context("the board in gel")
    }

    /// From the radiance factors of the dark and the light side of each channel, and the errors of ρ of the dark sides.
    fn of_sides(scene: &Scene, dark_errors: [f64; 3], sides: [[Estimate; 2]; 3]) -> Result<Self, Invalid> {
        let values = sides.map(|sides| sides.map(|side| side.value));
        let found = differences(scene, &values);
        // Errors of the scene are common to the channels.
        let base = SeenBase::of(scene);
        let mut of_scene = [0.0; 2];
        for prior in scene.priors().iter().filter(|prior| !prior.kind().is_of_base()) {
            let varied = |sd: f64| scene.varied(prior, sd * prior.std_error(), scene.channels().to_vec());
            let varied = varied(1.0).or_else(|_| varied(-1.0))?;
            let channels = base.through(&varied)?;
            let there = mean(&differences(&varied.with_channels(channels)?, &values));
            let here = mean(&found);
            (0..2).for_each(|i| of_scene[i] += (there[i] - here[i]).powi(2));
        }
        let estimate = |i: usize| {
            let value = mean(&found)[i];
            let scatter = found.iter().map(|of| (of[i] - value).powi(2)).sum::<f64>() / 6.0;
            let noise = |c: usize| {
                let [dark, light] = sides[c].map(|side| side.std_error);
                if i == 0 { libm::hypot(dark, dark_errors[c]) } else { light / values[c][1] }
            };
            let noise = (0..3).map(|c| noise(c).powi(2)).sum::<f64>() / 9.0;
            Estimate::new(value, (scatter.max(noise) + of_scene[i]).sqrt())
        };
        Ok(Self { haze: estimate(0), light_side: estimate(1) })
    }
}

/// Haze, and factor on ρ of the light side, of each channel.
fn differences(scene: &Scene, sides: &[[f64; 2]; 3]) -> Vec<[f64; 2]> {
    let above = scene.layers().iter().take_while(|layer| layer.medium() != LayerMedium::Sample).last();
    let gel_ior = match above.map(Layer::medium) {
        Some(LayerMedium::Clear { ior, .. }) => ior,
        _ => 1.0,
    };
    // Without a slab, the gels touch.
    let stack = Print::new(scene, gel_ior, 1.0);
    let seen = |rho: f64| stack.radiance_factors(&[], &[rho, rho + STEP]);
    let of_channel = |(channel, [dark, light]): (&Channel, &[f64; 2])| {
        let haze = dark - seen(channel.rho_dark())[0];
        let mut rho = channel.rho_light();
        for _ in 0..STEPS {
            let here = seen(rho);
            rho += (light - haze - here[0]) * STEP / (here[1] - here[0]);
        }
        [haze, rho / channel.rho_light()]
    };
    scene.channels().iter().zip(sides).map(of_channel).collect()
}

fn mean(channels: &[[f64; 2]]) -> [f64; 2] {
    let n = channels.len() as f64;
    [0, 1].map(|i| channels.iter().map(|of| of[i]).sum::<f64>() / n)
}

#[cfg(test)]
mod tests {
    use optics_tracer::BareBoard;

    use super::*;

    /// A haze of 0.008 and a light side of 0.97 of the stated ρ are found in the radiance factors of the stack; errors of
    /// the coat widen both. The stack is within 10 % of the dry board.
    #[test]
    fn board_in_gel_shows_haze_and_gloss() {
        let scene = Scene::lab();
        let stack = Print::new(&scene, 1.33, 1.0);
        let exact = |v: f64| Estimate::new(v, 1e-4);
        let sides: Vec<[Estimate; 2]> = scene
            .channels()
            .iter()
            .map(|c| {
                let seen = stack.radiance_factors(&[], &[c.rho_dark(), 0.97 * c.rho_light()]);
                [exact(seen[0] + 0.008), exact(seen[1] + 0.008)]
            })
            .collect();
        let found = InGel::of_sides(&scene, [1e-3; 3], sides.try_into().unwrap()).unwrap();
        assert!((found.haze.value - 0.008).abs() < 1e-6, "{found:?}");
        assert!((found.light_side.value - 0.97).abs() < 1e-6, "{found:?}");
        assert!((1e-3..8e-3).contains(&found.haze.std_error), "{found:?}");
        assert!((1e-3..2e-2).contains(&found.light_side.std_error), "{found:?}");
        let rho = scene.channels()[0].rho_light();
        let [wet, dry] =
            [stack.radiance_factors(&[], &[rho])[0], BareBoard::of(&scene).unwrap().apparent(rho)];
        assert!((wet / dry - 1.0).abs() < 0.1, "{wet} {dry}");
    }
}
