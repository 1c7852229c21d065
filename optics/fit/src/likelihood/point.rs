//! Defines the unknowns that profiles may share, as indices, and the values of these for one profile.

/// Numbers by pixel.
pub(crate) type Line = Vec<f64>;

/// Unknowns that a profile may share with others, in this order.
pub(crate) const LN_SIGMA_T: usize = 0;
pub(crate) const ROOT_CO_ALBEDO: usize = 1;
pub(crate) const LN_ONE_MINUS_G: usize = 2;
/// Logarithm of a factor on μ.
pub(crate) const LN_SCALE: usize = 3;
/// The parts of a profile's gain, zero, slope and wedge that all channels of its slab have, in units of their prior's
/// standard deviation.
pub(crate) const SLAB_FLAWS: [usize; 4] = [4, 5, 6, 7];
/// The camera's blur (`blur`).
pub(crate) const BLUR: usize = 8;
pub(crate) const LN_THICKNESS: usize = 9;
/// The uncertain quantities of the scene follow, in its order, each by its difference from the scene's value in units of
/// its prior's standard deviation.
pub(crate) const SHARED: usize = 10;

/// Values of the shared unknowns of one profile.
#[derive(Debug, Clone)]
pub(crate) struct Point(pub Line);

impl Point {
    pub(crate) fn medium(&self) -> [f64; 3] {
        [self.0[LN_SIGMA_T], self.0[ROOT_CO_ALBEDO], self.0[LN_ONE_MINUS_G]]
    }

    pub(crate) fn ln_scale(&self) -> f64 {
        self.0[LN_SCALE]
    }

    pub(crate) fn scale(&self) -> f64 {
        libm::exp(-self.0[LN_SCALE])
    }

    /// Gain, zero, slope and wedge of the slab.
    pub(crate) fn slab_flaws(&self) -> [f64; 4] {
        SLAB_FLAWS.map(|i| self.0[i])
    }

    /// Coordinate of the blur.
    pub(crate) fn blur(&self) -> f64 {
        self.0[BLUR]
    }

    pub(crate) fn thickness_mm(&self) -> f64 {
        libm::exp(self.0[LN_THICKNESS])
    }

    /// The uncertain quantities of the scene.
    pub(crate) fn scene(&self) -> &[f64] {
        &self.0[SHARED..]
    }
}
