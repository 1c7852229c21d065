//! Layers as matrices over the directions of a quadrature, and how they are added.
//!
//! Row i and column j of a matrix give the radiance over n² that leaves in direction i for one that arrives from direction
//! j. By reciprocity a row is also the distribution over j of a ray that arrives from direction i, so the row of the
//! sensor needs no weight of its own.

use nalgebra::{DMatrix, DVector, RowDVector};

use crate::dense::{product, solved};

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
        let up = between(&product(&below.reflects_above, &self.reflects_below), &below.up);
        let down = between(&product(&self.reflects_below, &below.reflects_above), &self.down);
        let [reflected, returned] =
            [product(&below.reflects_above, &down), product(&self.reflects_below, &up)];
        Self {
            reflects_above: &self.reflects_above + product(&self.up, &reflected),
            reflects_below: &below.reflects_below + product(&below.down, &returned),
            down: product(&below.down, &down),
            up: product(&self.up, &up),
        }
    }
}

/// (1 − M)⁻¹ L: the light L between two layers, of which M returns after a reflection by both.
fn between(returned: &DMatrix<f64>, light: &DMatrix<f64>) -> DMatrix<f64> {
    let mut rest = -returned;
    for i in 0..rest.nrows() {
        rest[(i, i)] += 1.0 + LOSS;
    }
    solved(rest, light.clone())
}

/// A base that sends back the same radiance in all directions, under layers, as far as it counts for the light above them.
#[derive(Debug)]
pub(crate) struct Covered {
    reflects_above: DMatrix<f64>,
    /// Light above the layers, for light of the base.
    seen: DVector<f64>,
    /// The light that reaches the base, by the direction that it arrives from above the layers.
    received: RowDVector<f64>,
    /// Share of a base's light that comes back to it.
    returned: f64,
}

impl Covered {
    /// A base under a layer. `base` is its light; `received` weighs the light that reaches it.
    pub(crate) fn new(layer: &Operator, base: &DVector<f64>, received: &RowDVector<f64>) -> Self {
        Self {
            reflects_above: layer.reflects_above.clone(),
            seen: &layer.up * base,
            received: received * &layer.down,
            returned: (received * (&layer.reflects_below * base))[0],
        }
    }

    /// Under one more layer.
    pub(crate) fn under(&self, layer: &Operator) -> Self {
        let returned = product(&layer.reflects_below, &self.reflects_above);
        let n = returned.nrows();
        let sides = DMatrix::from_fn(n, n + 1, |i, j| {
            if j < n { layer.down[(i, j)] } else { (layer.reflects_below.row(i) * &self.seen)[0] }
        });
        let solved = between(&returned, &sides);
        let (down, emitted) = (solved.columns(0, n).into_owned(), solved.column(n).into_owned());
        let up = &self.reflects_above * &emitted + &self.seen;
        Self {
            reflects_above: &layer.reflects_above + product(&layer.up, &product(&self.reflects_above, &down)),
            seen: &layer.up * up,
            received: &self.received * &down,
            returned: self.returned + (&self.received * emitted)[0],
        }
    }

    /// The light that is seen above one more layer.
    pub(crate) fn seen_above(
        &self,
        layer: &Operator,
        seen: &RowDVector<f64>,
        light: &DVector<f64>,
    ) -> OverBase {
        let returned = product(&layer.reflects_below, &self.reflects_above);
        let [entered, emitted] = [&layer.down * light, &layer.reflects_below * &self.seen];
        let solved = between(&returned, &DMatrix::from_columns(&[entered, emitted]));
        let [down, emitted] = [0, 1].map(|i| solved.column(i).into_owned());
        let above = |up: DVector<f64>| (seen * (&layer.up * up))[0];
        OverBase {
            over_black: (seen * (&layer.reflects_above * light))[0] + above(&self.reflects_above * &down),
            through: (&self.received * &down)[0] * above(&self.reflects_above * &emitted + &self.seen),
            returned: self.returned + (&self.received * &emitted)[0],
        }
    }
}

/// The light seen over Lambertian bases of any reflectance, as a function of it: s + a ρ/(1 − b ρ).
#[derive(Debug, Clone, Copy)]
pub struct OverBase {
    /// Over a black base.
    over_black: f64,
    /// The light that reaches a base, times what a base adds that sends it back.
    through: f64,
    /// Share of a base's light that comes back to it.
    returned: f64,
}

impl OverBase {
    pub fn at(&self, rho: f64) -> f64 {
        self.over_black + self.through * rho / (1.0 - self.returned * rho)
    }

    /// The derivative by the reflectance.
    pub fn slope(&self, rho: f64) -> f64 {
        self.through / (1.0 - self.returned * rho).powi(2)
    }
}
