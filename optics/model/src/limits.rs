//! Limits the size of one question.

/// Bounds of a question to a dictionary.
#[derive(Debug)]
pub struct FitLimits;

impl FitLimits {
    /// Most neighbours of one fit.
    pub const TOP: u32 = 10_000;
    /// Highest level of the wavelet derivative.
    pub const WAVELET_LEVEL: u32 = 10;
    /// Most scale factors of one search.
    pub const MU_VALUES: usize = 10_000;
    /// Most materials of one request.
    pub const MATERIALS: usize = 256;
    /// Most profiles of one measurement.
    pub const PROFILES: usize = 1024;
    /// Most pixels of one measured profile.
    pub const PIXELS: usize = 100_000;
    /// Most pixels of one question to a coordinator in another process, of all its profiles together.
    pub const QUESTION_PIXELS: usize = 1 << 20;
    /// Advice for questions with more pixels.
    pub const MANY_PIXELS_ADVICE: &str = "request fewer materials at a time, average neighbouring pixels, or use a \
                                          farm in the same process (--local), which takes any number";
    /// Most sets of slabs that are compared.
    pub const SLAB_SETS: usize = 256;
    /// Most slabs of one set.
    pub const SLABS: usize = 32;
    /// Most numbers of shots that are tried with every set.
    pub const SHOTS_TRIED: usize = 16;
}
