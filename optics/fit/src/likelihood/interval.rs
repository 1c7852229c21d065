//! Computes intervals of quantities from the rise of −2 ln L, the Cramér–Rao bound, and the goodness of a fit.

pub(crate) mod bound;
pub(crate) mod chi2;
pub(crate) mod profile_likelihood;
pub(crate) mod residuals;
