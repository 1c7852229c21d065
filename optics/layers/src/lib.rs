//! The radiance factor of a stack of plane layers over a uniform base, without Monte Carlo noise, and the records of jobs,
//! which are corrected by it.
//!
//! Ring and sensor are those of a scene, and so are its clear layers and its faces; one or more slabs of media lie in the
//! place of its sample. The light of a ring does not depend on the azimuth, so radiances are vectors over the polar angle
//! alone, and layers are matrices: see `operator` for how they are added, and `slab` for how those of a medium are
//! doubled.
//!
//! `docs/glossary.md` explains the terms.

mod dense;
mod faces;
mod ladder;
mod operator;
mod prediction;
mod print;
mod quadrature;
mod records;
mod remembered;
mod slab;
mod stacks;
mod uncertain;

pub use operator::OverBase;
pub use prediction::{ChangeSource, Predicted, PrintedSlab, SetUpChange, predict, radiance_factors};
pub use print::{Print, PrintLayer};
pub use records::{block_of_set, records, records_of_set};
pub use stacks::{StackLevels, Stacks};
pub use uncertain::{Uncertain, chi2};
