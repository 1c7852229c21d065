//! Levels of slabs of one medium of any thickness, between optical thicknesses that doubling reaches.

use std::sync::Arc;

use optics_model::digest::Digest;
use optics_model::phase::PhaseShape;

use crate::operator::OverBase;
use crate::print::Print;
use crate::remembered::Remembered;

/// Optical thicknesses that a level is interpolated between, by a polynomial in ln τ: rung r is τ = 2^(r/2).
const POINTS: i32 = 8;
/// First and last rung of ladders: for most slabs, and for all. Beyond the last a level does not change any more, and
/// below the first it is that of a clear slab.
const USUAL: (i32, i32) = (-8, 16);
const WIDEST: (i32, i32) = (-40, 36);

/// Levels at the rungs.
#[derive(Debug)]
pub(crate) struct Ladder {
    first: i32,
    rungs: Vec<OverBase>,
}

impl Ladder {
    /// A ladder for slabs of an optical thickness.
    pub(crate) fn remembered(
        print: &Print,
        (phase, g): (&PhaseShape, f64),
        albedo: f64,
        depth: f64,
    ) -> Arc<Self> {
        static KNOWN: Remembered<Arc<Ladder>> = Remembered::new(1 << 12);
        let (first, last) = range(depth);
        let phase_digest = Digest::of_phase(phase);
        let words = phase_digest.as_bytes().chunks_exact(8);
        let words = words.map(|word| u64::from_le_bytes(word.try_into().expect("8 bytes")));
        let numbers = [(g + 0.0).to_bits(), albedo.to_bits(), u64::from(first == USUAL.0)];
        let key = print.key().iter().copied().chain(words).chain(numbers).collect();
        KNOWN.get(key, || {
            let phase = phase.function_near(g);
            let slab = |rung: i32| print.slab(&phase, albedo, libm::exp2(0.5 * f64::from(rung)));
            // Two series of slabs: the even rungs, and the odd ones.
            let mut next = [slab(first), slab(first + 1)];
            let rungs = (first..=last).map(|rung| {
                let next = &mut next[(rung - first) as usize % 2];
                let doubled = next.doubled();
                print.level(&std::mem::replace(next, doubled))
            });
            Arc::new(Self { first, rungs: rungs.collect() })
        })
    }

    /// The radiance factor of a slab of an optical thickness over a base.
    pub(crate) fn level(&self, depth: f64, rho: f64) -> f64 {
        let place = place(depth) - f64::from(self.first);
        let first = (place.floor() as i32 + 1 - POINTS / 2).clamp(0, self.rungs.len() as i32 - POINTS);
        let nodes = first..first + POINTS;
        let weight = |node: i32| {
            let others = nodes.clone().filter(|other| *other != node);
            let factor = |other: i32| (place - f64::from(other)) / f64::from(node - other);
            others.map(factor).product::<f64>()
        };
        nodes.clone().map(|node| weight(node) * self.rungs[node as usize].at(rho)).sum()
    }
}

/// 2 log₂ τ within the widest ladder.
fn place(depth: f64) -> f64 {
    let (first, last) = WIDEST;
    (2.0 * libm::log2(depth)).clamp(f64::from(first), f64::from(last))
}

fn range(depth: f64) -> (i32, i32) {
    let (first, last) = USUAL;
    let inner = f64::from(first + POINTS / 2)..f64::from(last - POINTS / 2);
    if inner.contains(&place(depth)) { USUAL } else { WIDEST }
}

#[cfg(test)]
mod tests {
    use super::*;
    use optics_model::Scene;

    /// Levels between the rungs are those of doubling from another thin slab, whatever the thickness.
    #[test]
    fn levels_between_rungs_are_exact() {
        let scene = Scene::smooth();
        let print = Print::new(&scene, 1.53, 0.2);
        for (g, albedo) in [(0.0, 0.35), (0.8, 0.9), (0.4, 0.999), (-0.3, 1.0)] {
            for depth in [1e-7, 1e-3, 0.1, 0.3, 1.1, 4.3, 20.0, 37.0, 800.0, 1e5] {
                let phase = scene.phase().function_near(g);
                let exact = print.level(&print.slab(&phase, albedo, depth));
                let ladder = Ladder::remembered(&print, (scene.phase(), g), albedo, depth);
                for rho in [0.024, 0.985] {
                    let off = (ladder.level(depth, rho) - exact.at(rho)).abs();
                    assert!(off < 5e-5, "{g} {albedo} {depth} {rho}: {off:e}");
                }
            }
        }
    }
}
