//! Questions to a dictionary and their answers.

mod answer;
mod options;

pub use answer::{
    Candidate, ChannelFit, Curve, DistanceMap, FitCurves, GError, Interval, MapLayer, MaterialFit, Outside,
    Refined, ScaleCurve, ScalePoint, ThicknessError,
};
pub use options::{Bounds, FitOptions, FitSettings, MuRange, Wavelet};
