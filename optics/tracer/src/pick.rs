//! Picks vertices of a walk at equal steps of their accumulated worth.
//!
//! A walk's vertex i, a scattering or a hit on the base after n_i scatterings, is worth c_i α^(n_i) for the albedo α, c_i
//! being the light that it receives times the walk's weight. Scoring all of them for all albedos would take longer than
//! the walk. Instead, the running sum of c_i h(n_i) along the walk is cut into equal steps Δ from a random offset on, and
//! the vertices in which the cuts fall are scored, with α^(n_i) Δ/h(n_i) per cut (systematic sampling, Madow and Madow
//! 1944). This is unbiased for any h: each vertex is cut c_i h(n_i)/Δ times on average. Walks that are worth more are
//! scored more often, along their whole path.
//!
//! h makes early vertices more frequent: for most albedos only those matter.

/// Number of the block whose random words give the place of the first cut.
pub const PICK_BLOCK: u32 = 1 << 31;

/// Δ over the ring's measure: a walk that loses nothing is worth about the measure, for α = 1.
pub const STEP: f32 = 1.0;
/// h(n) = max(1, a − b n).
const EARLY: [f32; 2] = [4.0, 0.15];

/// Value of the height that marks hits on the base.
pub const AT_BASE: f32 = -1.0;

/// A vertex that has been picked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pick {
    /// Place of the walk in its chunk.
    pub walk: u32,
    /// Height, in mean free paths, and cosine of a scattering; see [`AT_BASE`].
    pub z: f32,
    pub u: f32,
    /// Estimated worth by which the vertex was picked, without the walk's weight.
    pub worth: f32,
    /// Cuts that fall in it.
    pub cuts: u32,
    pub scatterings: u32,
    /// Hits on the base so far.
    pub hits: u32,
    /// Length travelled in the sample so far, in mean free paths.
    pub length: f32,
}

/// h(n).
pub fn importance(scatterings: u32) -> f32 {
    let [a, b] = EARLY;
    (a - scatterings as f32 * b).max(1.0)
}

/// For vectors: the constants of [`importance`].
pub const fn early() -> [f32; 2] {
    EARLY
}

/// Number of cuts at a vertex that has reduced the rest of the step to below 0; `left` becomes the rest of the next step.
pub fn cut(left: &mut f32, step: f32) -> u32 {
    let cuts = (-*left / step) as u32 + 1;
    *left += cuts as f32 * step;
    cuts
}
