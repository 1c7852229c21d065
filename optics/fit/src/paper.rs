//! The paper's equations over the records of a dictionary: the exact search of Eq. 1, the scale factor of Eq. 3, maps of
//! the distance, and similar media.

pub(crate) mod common;
pub(crate) mod curves;
pub(crate) mod intervals;
pub(crate) mod layers;
pub(crate) mod map;
pub(crate) mod noise;
pub(crate) mod question;
pub(crate) mod refine;
pub(crate) mod scale;
pub(crate) mod search;
pub(crate) mod shared;
pub(crate) mod similarity;
pub(crate) mod suspicion;
pub(crate) mod uncertainty;
