//! The verbs, one module each, in folders by subject.

pub(crate) mod completions;
pub(crate) mod dictionaries;
pub(crate) mod farm;
pub(crate) mod fits;
pub(crate) mod manual;
pub(crate) mod measurements;
pub(crate) mod slurm;
#[cfg(test)]
mod tests;
