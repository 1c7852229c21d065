//! Layers as matrices over the directions of a quadrature, and how they are added.
//!
//! Row i and column j of a matrix give the radiance over n² that leaves in direction i for one that arrives from direction
//! j. By reciprocity a row is also the distribution over j of a ray that arrives from direction i, so the row of the
//! sensor needs no weight of its own.

use nalgebra::{DMatrix, DVector};

/// Loss of light at every passage between two layers: without it, directions that are totally reflected on both sides,
/// and that no light enters, would have no solution.
const LOSS: f64 = 1e-10;

/// Reflection and transmission of a layer, for light from above and from below.
#[derive(Debug, Clone)]
pub(crate) struct Operator {
    pub reflects_above: DMatrix<f64>,
    pub reflects_below: DMatrix<f64>,
    /// From above to below.
    pub down: DMatrix<f64>,
    /// From below to above.
    pub up: DMatrix<f64>,
}

impl Operator {
    /// The layer upside down.
    pub(crate) fn turned(&self) -> Self {
        Self {
            reflects_above: self.reflects_below.clone(),
            reflects_below: self.reflects_above.clone(),
            down: self.up.clone(),
            up: self.down.clone(),
        }
    }

    /// Light upwards through this layer, of which `light` comes from below, over something that reflects light from above
    /// by `base`: T↑ (1 − B R′)⁻¹ L.
    pub(crate) fn passed(&self, base: &DMatrix<f64>, light: &DVector<f64>) -> DVector<f64> {
        let n = base.nrows();
        let back = DMatrix::identity(n, n) * (1.0 + LOSS) - base * &self.reflects_below;
        &self.up * back.lu().solve(light).expect("light between two layers fades")
    }

    /// The reflection from above of this layer over something that reflects light from above by `base`:
    /// R + T↑ (1 − B R′)⁻¹ B T↓.
    pub(crate) fn over(&self, base: &DMatrix<f64>) -> DMatrix<f64> {
        let n = base.nrows();
        let back = DMatrix::identity(n, n) * (1.0 + LOSS) - base * &self.reflects_below;
        let returned = back.lu().solve(&(base * &self.down)).expect("light between two layers fades");
        &self.reflects_above + &self.up * returned
    }
}
