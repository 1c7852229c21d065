//! Layers as matrices over the directions of a quadrature, and how they are added.
//!
//! Row i and column j of a matrix give the radiance over n² that leaves in direction i for one that arrives from direction
//! j. By reciprocity a row is also the distribution over j of a ray that arrives from direction i, so the row of the
//! sensor needs no weight of its own.

use nalgebra::DMatrix;

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

    /// No layer, between n directions.
    pub(crate) fn none(n: usize) -> Self {
        let (zero, one) = (DMatrix::zeros(n, n), DMatrix::identity(n, n));
        Self { reflects_above: zero.clone(), reflects_below: zero, down: one.clone(), up: one }
    }

    /// This layer on top of another: R + T↑ (1 − R₂ R′)⁻¹ R₂ T↓ and so on, R₂ being the reflection of the other.
    pub(crate) fn over(&self, below: &Self) -> Self {
        let up = solved(&(&below.reflects_above * &self.reflects_below), &below.up);
        let down = solved(&(&self.reflects_below * &below.reflects_above), &self.down);
        Self {
            reflects_above: &self.reflects_above + &self.up * (&below.reflects_above * &down),
            reflects_below: &below.reflects_below + &below.down * (&self.reflects_below * &up),
            down: &below.down * down,
            up: &self.up * up,
        }
    }
}

/// (1 − M)⁻¹ L: the light L between two layers, of which M returns after a reflection by both.
fn solved(returned: &DMatrix<f64>, light: &DMatrix<f64>) -> DMatrix<f64> {
    let n = returned.nrows();
    let rest = DMatrix::identity(n, n) * (1.0 + LOSS) - returned;
    rest.lu().solve(light).expect("light between two layers fades")
}
