//! Numerics of the fit over plain slices: no SQL, no gRPC.
//!
//! Eqs. 1 and 2 of Elek, Sumin et al. 2017 (supplement, Sec. 5.5).

mod dictionary;
mod distance;
mod gradient;
mod resample;
mod search;

pub use dictionary::{DictionaryBuilder, FitDictionary};
pub use gradient::{Wavelet, derivative};
pub use search::fit;
