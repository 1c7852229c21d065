//! Where the response to an uncertain quantity is traced, and the range in which it holds.

use super::{Prior, PriorKind};
use crate::phase::{MOST_G, MOST_SECOND_WEIGHT};
use crate::scene::Scene;

/// Standard deviations over which responses with little or no bend hold.
const FAR: f64 = 5.0;

impl Prior {
    /// Differences from the scene's value at which profiles are traced: two for a second-order response, one for a
    /// first-order response, or several between which it is interpolated.
    ///
    /// A response is the slope of the differences, so its noise falls as they grow: those of thicknesses, indices and the
    /// ring, in which profiles are nearly linear, are up to four standard deviations. Roughnesses and thicknesses above 0
    /// stay above 0. The ring moves both ways only where neither way reaches the direction from which smooth faces mirror
    /// light into the camera.
    pub fn steps(&self, scene: &Scene) -> Vec<f64> {
        /// Share of the value from which on a prior is wide.
        const WIDE: f64 = 0.2;
        /// Least share of the value that the lower step leaves.
        const LEAST: f64 = 0.25;
        /// Change of an index in which profiles are nearly linear.
        const INDEX: f64 = 0.05;
        let (sd, value) = (self.std_error, scene.value_of(self).unwrap_or(f64::INFINITY));
        match self.kind {
            PriorKind::Thickness | PriorKind::SecondLobeWeight if value == 0.0 => vec![sd, 2.5 * sd],
            // The effect is as wide as the spread.
            PriorKind::BaseSpread if value == 0.0 => [0.25, 0.6, 1.3, 3.0].map(|step| step * sd).to_vec(),
            // A higher weight would leave too little of the first lobe where the mean cosine is large.
            PriorKind::SecondLobeWeight => {
                let low = if value <= FAR * sd { value } else { 2.0 * sd };
                vec![-low, (1.4 * sd).min(MOST_SECOND_WEIGHT - value)]
            }
            PriorKind::Roughness if sd > WIDE * value => {
                vec![-(2.0 * sd).min((1.0 - LEAST) * value), (2.0 * sd).min(1.0 - value)]
            }
            PriorKind::Thickness | PriorKind::BaseSpread => {
                vec![-(4.0 * sd).min((1.0 - LEAST) * value), 4.0 * sd]
            }
            PriorKind::Haze => Vec::new(),
            // A base reflects no more than all light.
            PriorKind::LightSide => vec![-2.0 * sd],
            PriorKind::Index => {
                let step = (4.0 * sd).min(INDEX).min(value - 1.0).max(2.5 * sd);
                vec![-step, step]
            }
            PriorKind::RingAngle => {
                let [inner, outer] = [scene.light().inner_deg(), scene.light().outer_deg()];
                let mirrored = scene.sensor().polar_deg();
                let down = if mirrored < inner { inner - mirrored } else { inner };
                let up = if mirrored > outer { mirrored - outer } else { 90.0 - outer };
                match 4.0 * sd {
                    step if step < down && step < up => vec![-step, step],
                    _ if outer + 2.0 * sd <= 90.0 => vec![2.0 * sd],
                    _ => vec![-2.0 * sd],
                }
            }
            _ => vec![2.0 * sd],
        }
    }

    /// b such that profiles change with u (1 + b u), u being the difference from the scene's value in standard deviations.
    /// A face's slopes have a variance proportional to α², so b is σ/2α for roughnesses and 0 for all else.
    pub fn bend(&self, scene: &Scene) -> f64 {
        match (self.kind, scene.value_of(self)) {
            (PriorKind::Roughness, Some(value)) => 0.5 * self.std_error / value,
            _ => 0.0,
        }
    }

    /// Least and greatest difference from the scene's value for which responses traced at [`Self::steps`] hold.
    pub fn range(&self, scene: &Scene) -> (f64, f64) {
        self.range_of(scene, &self.steps(scene))
    }

    /// Least and greatest difference for responses traced at other steps, as those of an earlier version.
    pub fn range_of(&self, scene: &Scene, steps: &[f64]) -> (f64, f64) {
        match (self.kind, steps) {
            (PriorKind::Roughness | PriorKind::Thickness | PriorKind::BaseSpread, &[low, .., high]) => {
                (low.min(0.0), 1.1 * high)
            }
            // Less than no haze is an error of the zero.
            (PriorKind::Haze, _) => (-2.0 * self.std_error, FAR * self.std_error),
            (PriorKind::SecondLobeWeight, _) => {
                let value = scene.value_of(self).unwrap_or_default();
                let far = FAR * self.std_error;
                (-far.min(value), far.min(MOST_SECOND_WEIGHT - value))
            }
            (PriorKind::SecondLobeG, _) => {
                let (far, value) = (FAR * self.std_error, scene.value_of(self).unwrap_or_default());
                (-far.min(MOST_G + value), far.min(MOST_G - value))
            }
            _ => (-FAR * self.std_error, FAR * self.std_error),
        }
    }
}
