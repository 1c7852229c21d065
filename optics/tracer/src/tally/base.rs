//! Computes the weights that hits on the base give to a walk, by their numbers on either side of the edge.

use crate::scatterings::single;

/// Sides of the base.
pub(super) const LIGHT: usize = 0;
pub(super) const DARK: usize = 1;

/// The base in one channel: factors of its sides for numbers of hits, and the difference of those of one hit.
#[derive(Debug)]
pub(super) struct Base {
    light: Vec<f32>,
    dark: Vec<f32>,
    pub(super) contrast: f32,
    crossings: usize,
}

impl Base {
    /// For walks that cross the ink `crossings` times, 1 or 2, at each reflection.
    pub(super) fn new([rho_light, rho_dark]: [f64; 2], crossings: usize, most_hits: usize) -> Self {
        // A dark side of less than black has no root: light that crosses it once only is lost.
        let root = |rho: f64| if crossings == 1 { rho } else { rho.max(0.0).sqrt() };
        let powers = |rho: f64| {
            let next = move |power: &f64| Some(power * rho);
            let whole = std::iter::successors(Some(1.0), next);
            let all = whole.flat_map(|power| [power, power * root(rho)].into_iter().take(crossings));
            all.take(most_hits + 1).map(single).collect()
        };
        let contrast = (root(rho_light) - root(rho_dark)) as f32;
        Self { light: powers(rho_light), dark: powers(rho_dark), contrast, crossings }
    }

    /// Twice the weight of hits over a base that is light or dark everywhere: that of a walk and of its mirror image.
    pub(super) fn uniform(&self, side: usize, hits: usize) -> f32 {
        2.0 * flush(if side == DARK { self.dark[hits] } else { self.light[hits] })
    }

    /// ρ_light^a ρ_dark^b.
    pub(super) fn weight(&self, a: usize, b: usize) -> f32 {
        flush(self.light[a] * self.dark[b])
    }

    /// Change of the weight by a hit that turns light where a others are light and b dark: exactly 0 without contrast.
    pub(super) fn step(&self, a: usize, b: usize) -> f32 {
        let Self { light, dark, contrast, .. } = self;
        let is_whole = self.crossings == 1;
        flush(if is_whole {
            light[a] * dark[b] * contrast
        } else {
            light[a + 1] * dark[b] - light[a] * dark[b + 1]
        })
    }
}

/// Flush to zero: arithmetic with subnormal operands is slow.
pub(super) fn flush(x: f32) -> f32 {
    if x.abs() < 1e-18 { 0.0 } else { x }
}
