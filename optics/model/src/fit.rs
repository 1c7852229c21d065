//! Questions to a dictionary and their answers.

mod answer;
mod budget;
mod design;
mod measured;
mod mixtures;
mod options;
mod profile;
mod shared_errors;
mod suspicion;

pub use answer::{
    Bound, Candidate, ChannelFit, Common, Curve, DistanceMap, Ends, FitCurves, GError, Interval, Likelihood,
    MapLayer, MaterialFit, Nuisance, NuisanceEstimate, OutlierPixel, Outside, Refined, ScaleCurve,
    ScalePoint, SceneEstimate, Stretch, ThicknessError,
};
pub use budget::{ErrorSource, SourceShare};
pub use design::{
    Design, DesignQuestion, DesignSettings, HalfWidths, Improvement, Limitation, PixelRow, SlabSet,
};
pub use measured::{MeasurePlan, Measured, Z};
pub use mixtures::{Agreement, InkChannel, InkFit, Mixture, MixtureFit, MixturePart, Mixtures, Unmixed};
pub use options::{Bounds, FitOptions, FitSettings, MuRange, Objective, PhaseModel, Wavelet};
pub use profile::{PredictedChannel, PredictedProfiles, ProfileQuestion};
pub use shared_errors::{SetUpDifference, SharedErrors};
pub use suspicion::{Cause, MISFIT, Suspicion};
