//! Many stacks of few media at once. Stacks that have their lower slabs in common share them: they are a tree that grows
//! from the base.

use std::collections::HashMap;
use std::sync::Arc;

use rayon::prelude::*;

use crate::operator::{Covered, Operator, OverBase};
use crate::print::{Print, PrintLayer};

/// Stacks of slabs of some media.
#[derive(Debug, Clone)]
pub struct Stacks {
    /// Medium and thickness in mm of each slab that occurs.
    slabs: Vec<(usize, f64)>,
    /// Slabs on what is below them, which comes before them; the others lie on the base.
    nodes: Vec<StackNode>,
    /// The uppermost slab of each stack.
    tops: Vec<usize>,
}

#[derive(Debug, Clone)]
struct StackNode {
    below: Option<usize>,
    slab: usize,
    /// Number of slabs below it.
    depth: usize,
    /// The media from here to the base, as bits.
    media: u128,
}

/// How stacks look, with all that it was computed from.
#[derive(Debug)]
pub struct StackLevels {
    covered: Vec<Arc<Covered>>,
    /// One for each stack.
    pub seen: Vec<OverBase>,
}

impl Stacks {
    /// Most media.
    pub const MOST_MEDIA: usize = 128;

    /// Stacks from top to bottom, each of one slab at least, as (medium, thickness in mm).
    pub fn new<'a>(stacks: impl IntoIterator<Item = &'a [(usize, f64)]>) -> Self {
        let mut all = Self { slabs: Vec::new(), nodes: Vec::new(), tops: Vec::new() };
        let mut known: HashMap<(Option<usize>, usize), usize> = HashMap::new();
        for stack in stacks {
            let mut below = None;
            for (depth, slab) in stack.iter().rev().enumerate() {
                let slab = all.slab(*slab);
                below = Some(*known.entry((below, slab)).or_insert_with(|| {
                    let under: u128 = below.map_or(0, |node: usize| all.nodes[node].media);
                    let media = under | 1 << all.slabs[slab].0;
                    all.nodes.push(StackNode { below, slab, depth, media });
                    all.nodes.len() - 1
                }));
            }
            all.tops.push(below.expect("a stack has a slab"));
        }
        all
    }

    fn slab(&mut self, slab: (usize, f64)) -> usize {
        self.slabs.iter().position(|known| *known == slab).unwrap_or_else(|| {
            self.slabs.push(slab);
            self.slabs.len() - 1
        })
    }

    /// The stacks of these media; `layer` gives a slab of a medium and a thickness.
    pub fn levels(&self, print: &Print, layer: impl Fn(usize, f64) -> PrintLayer + Sync) -> StackLevels {
        self.levels_from(print, layer, None)
    }

    /// The stacks after a change of one medium. Those without it are taken from `before`, which belongs to the same print.
    pub fn changed(
        &self,
        before: &StackLevels,
        medium: usize,
        print: &Print,
        layer: impl Fn(usize, f64) -> PrintLayer + Sync,
    ) -> Vec<OverBase> {
        self.levels_from(print, layer, Some((before, medium))).seen
    }

    fn levels_from(
        &self,
        print: &Print,
        layer: impl Fn(usize, f64) -> PrintLayer + Sync,
        before: Option<(&StackLevels, usize)>,
    ) -> StackLevels {
        let operators: Vec<Operator> = self
            .slabs
            .par_iter()
            .map(|(medium, thickness_mm)| print.operator(&layer(*medium, *thickness_mm)))
            .collect();
        let kept = |node: usize| {
            let (before, medium) = before?;
            (self.nodes[node].media >> medium & 1 == 0).then_some((before, node))
        };
        let base = print.base();
        let mut covered: Vec<Option<Arc<Covered>>> = vec![None; self.nodes.len()];
        let deepest = self.nodes.iter().map(|node| node.depth).max().unwrap_or(0);
        for depth in 0..=deepest {
            let nodes: Vec<usize> =
                (0..self.nodes.len()).filter(|node| self.nodes[*node].depth == depth).collect();
            let one = |node: &usize| {
                let own = &self.nodes[*node];
                let below = own.below.and_then(|below| covered[below].as_deref()).unwrap_or(&base);
                let known = kept(*node).map(|(before, node)| before.covered[node].clone());
                known.unwrap_or_else(|| Arc::new(below.under(&operators[own.slab])))
            };
            let found: Vec<Arc<Covered>> = nodes.par_iter().map(one).collect();
            nodes.iter().zip(found).for_each(|(node, found)| covered[*node] = Some(found));
        }
        let covered: Vec<Arc<Covered>> = covered.into_iter().flatten().collect();
        let seen = |(stack, top): (usize, &usize)| {
            let known = kept(*top).map(|(before, _)| before.seen[stack]);
            known.unwrap_or_else(|| print.seen(&covered[*top]))
        };
        let seen = self.tops.par_iter().enumerate().map(seen).collect();
        StackLevels { covered, seen }
    }
}

#[cfg(test)]
mod tests {
    use optics_model::phase::PhaseShape;
    use optics_model::{Medium, Scene};

    use super::*;

    const STACKS: [&[(usize, f64)]; 5] = [
        &[(0, 0.1), (1, 0.1), (0, 0.8)],
        &[(1, 0.1), (1, 0.1), (0, 0.8)],
        &[(0, 0.8)],
        &[(2, 0.3), (0, 0.1), (1, 0.1), (0, 0.8)],
        &[(2, 0.3)],
    ];

    fn layer(albedos: [f64; 3]) -> impl Fn(usize, f64) -> PrintLayer + Sync {
        move |medium, thickness_mm| PrintLayer {
            medium: Medium::new(6.0, albedos[medium], 0.4).unwrap(),
            phase: PhaseShape::default(),
            thickness_mm,
        }
    }

    /// Stacks as a tree are those one by one, to the last bit, also after a change of one medium.
    #[test]
    fn trees_of_stacks_are_stacks() {
        let print = Print::new(&Scene::smooth(), 1.5, 0.6);
        let stacks = Stacks::new(STACKS);
        let [before, after] = [layer([0.99, 0.9, 0.5]), layer([0.99, 0.9, 0.7])];
        let levels = stacks.levels(&print, &before);
        let changed = stacks.changed(&levels, 2, &print, &after);
        for (i, stack) in STACKS.iter().enumerate() {
            for (found, layer) in [(&levels.seen[i], &before as &dyn Fn(_, _) -> _), (&changed[i], &after)] {
                let slabs: Vec<PrintLayer> = stack.iter().map(|(medium, mm)| layer(*medium, *mm)).collect();
                let alone = print.radiance_factors(&slabs, &[0.0, 0.7]);
                assert_eq!([found.at(0.0), found.at(0.7)], alone[..], "{i}");
            }
        }
    }

    /// Few directions err by 0.3 % of white at most.
    #[test]
    fn coarse_prints_are_near_fine_ones() {
        let scene = Scene::smooth();
        let [fine, coarse] = [Print::new(&scene, 1.5, 0.6), Print::coarse(&scene, 1.5)];
        let stacks = Stacks::new(STACKS);
        let layer = layer([0.999, 0.9, 0.5]);
        let [fine, coarse] = [&fine, &coarse].map(|print| stacks.levels(print, &layer).seen);
        for (fine, coarse) in fine.iter().zip(&coarse) {
            assert!((fine.at(0.5) - coarse.at(0.5)).abs() < 3e-3, "{fine:?} {coarse:?}");
            assert!((fine.slope(0.5) - (fine.at(0.501) - fine.at(0.499)) / 0.002).abs() < 1e-4);
        }
    }
}
