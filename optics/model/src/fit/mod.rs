//! Questions to a dictionary and their answers.

mod answer;
mod options;

pub use answer::{
    Candidate, Cause, ChannelFit, Common, Curve, DistanceMap, FitCurves, GError, Interval, MISFIT, MapLayer,
    MaterialFit, Outside, Refined, ScaleCurve, ScalePoint, Suspicion, ThicknessError,
};
pub use options::{Bounds, FitOptions, FitSettings, MuRange, Wavelet};
