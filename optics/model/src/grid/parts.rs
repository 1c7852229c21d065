//! Limits the number of parts of a grid that a coordinator keeps account of.

use std::num::NonZero;

use super::{BATCH_WALKS, BLOCK_BATCHES, Grid, Walks};
use crate::invalid::{Invalid, Result};

/// Most parts of one dictionary: its jobs, or the blocks that they are divided into. The coordinator keeps account of each.
pub const MAX_PARTS: u64 = 1_000_000;

impl Grid {
    /// Refuses a grid that is too large for a coordinator: its jobs may have at most [`MAX_PARTS`] parts, also when they
    /// are traced with as many walks as a target error allows.
    ///
    /// Not a rule of [`Self::new`]: older grids beyond this limit can still be listed and deleted.
    pub fn check_parts(&self) -> Result<()> {
        let jobs = self.job_count() as u64;
        let Some(blocks) = NonZero::new(MAX_PARTS / jobs) else {
            let allowed = format!("a dictionary may have at most {MAX_PARTS}");
            return Err(Invalid::new("transport points", jobs, allowed));
        };
        let fits = |walks: Walks| u64::from(walks.blocks()) <= blocks.get();
        let most = self.quality.map(|q| ("quality.max_walks", q.max_walks()));
        let [_, first] = self.least_and_most_walks();
        let first = first.times(self.responses().map_or(1, super::Responses::walks_factor));
        match [Some(("walks", first)), most].into_iter().flatten().find(|(_, walks)| !fits(*walks)) {
            None => Ok(()),
            Some((field, walks)) => {
                let block = BLOCK_BATCHES * BATCH_WALKS;
                let allowed = format!(
                    "at most {} are allowed with {jobs} transport points, since each {block} walks are a part and a \
                     dictionary may have at most {MAX_PARTS} parts",
                    blocks.get() * block
                );
                Err(Invalid::new(field, walks.get(), allowed))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Axes, Quality};
    use crate::scene::Scene;

    /// The refusal of a grid with too many parts gives the number of walks that is allowed.
    #[test]
    fn too_many_parts_name_the_allowed_walks() {
        let with = |walks: u64, most: Option<u64>| {
            let walk_count = |walks| Walks::new(walks).unwrap();
            let points = (1..=40).map(f64::from).collect();
            let axes =
                Axes { sigma_t_per_mm: points, g: vec![0.0], thickness_mm: vec![1.0], ..Grid::paper().axes };
            let grid = Grid::new(Scene::paper(), axes, walk_count(walks), 1, false).unwrap();
            let quality = most.map(|most| Quality::new(0.01, walk_count(most)).unwrap());
            quality.map_or(Ok(grid.clone()), |quality| grid.with_quality(quality)).unwrap().check_parts()
        };
        assert_eq!(with(25_000_000_000, None), Ok(()));
        let refused = with(1_000_000_000_000, None).unwrap_err();
        assert_eq!(refused.field(), "walks");
        let text = refused.to_string();
        assert!(text.contains("at most 25000000000 are allowed with 40 transport points"), "{text}");
        assert_eq!(with(5000, Some(25_000_000_000)), Ok(()));
        assert_eq!(with(5000, Some(25_000_002_500)).unwrap_err().field(), "quality.max_walks");
        assert_eq!(Grid::paper().check_parts(), Ok(()));
    }

    /// A grid with too many transport points is refused.
    #[test]
    fn too_many_points_are_refused() {
        let sigma_t_per_mm = (1..=1001).map(|i| f64::from(i) / 100.0).collect();
        let g = (0..1000).map(|i| f64::from(i) / 1001.0).collect();
        let axes =
            Axes { sigma_t_per_mm, albedo: vec![0.5], g, thickness_mm: vec![1.0], ..Grid::paper().axes };
        let grid = Grid::new(Scene::smooth(), axes, Walks::PAPER, 1, false).unwrap();
        let text = grid.check_parts().unwrap_err().to_string();
        assert_eq!(text, "transport points = 1001000 is not valid: a dictionary may have at most 1000000");
    }
}
