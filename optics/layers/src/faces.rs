//! The reflection and transmission of the interface between two layers.

use nalgebra::DMatrix;
use optics_tracer::face::{Face, FacePoint, FaceSide};
use rayon::prelude::*;

use crate::operator::Operator;
use crate::quadrature::Quadrature;

/// Points of the sequence over the microfacets of a rough face. Few rays of a very rough face meet a narrow ring: it has
/// more, and so has the sensor's direction.
const POINTS: u32 = 1 << 12;
const MANY_POINTS: u32 = 1 << 14;
const POINTS_OF_SENSOR: u32 = 1 << 16;
/// Roughness from which on a face is very rough, and width of a ring over α below which it is narrow.
const VERY_ROUGH: f64 = 0.2;
const NARROW: f64 = 0.5;

/// `ring` is the difference of sin θ of its ends.
pub(crate) fn face(quadrature: &Quadrature, face: &Face, ring: f64) -> Operator {
    let [above, below] =
        [FaceSide::Above, FaceSide::Below].map(|from| one_side(quadrature, face, ring, from));
    Operator { reflects_above: above.0, reflects_below: below.0, up: above.1, down: below.1 }
}

/// Distributions of the rays that come from one side in each direction: reflected and transmitted.
fn one_side(quadrature: &Quadrature, face: &Face, ring: f64, from: FaceSide) -> (DMatrix<f64>, DMatrix<f64>) {
    let n = quadrature.len();
    let [own, other] = if from == FaceSide::Above { face.iors } else { [face.iors[1], face.iors[0]] };
    let is_hard = face.roughness > VERY_ROUGH || ring < NARROW * face.roughness;
    let of_others = if is_hard { MANY_POINTS } else { POINTS };
    let row = |i: usize| {
        let mut rows = [vec![0.0; n], vec![0.0; n]];
        if !quadrature.exists(i, own) {
            // It is a direction of other layers only.
            return rows;
        }
        if face.roughness == 0.0 {
            let reflectance = reflectance(quadrature.cosine(i, own), own / other);
            rows[0][i] = reflectance;
            rows[1][i] = 1.0 - reflectance;
            return rows;
        }
        let sin2 = quadrature.s2[i] / (own * own);
        let mut histograms = [vec![0.0; quadrature.places()], vec![0.0; quadrature.places()]];
        let mut whole = 0.0;
        let points = if i == quadrature.sensor() { POINTS_OF_SENSOR } else { of_others };
        for number in 0..points {
            let rays = face.rays(from, sin2, FacePoint::new(number, points));
            for (direction, share) in rays.into_iter().flatten() {
                let sin2 = f64::from(direction.x * direction.x + direction.y * direction.y);
                let (side, ior) = if direction.z > 0.0 { (0, own) } else { (1, other) };
                let s2 = (ior * ior * sin2).min(ior * ior * (1.0 - 1e-9));
                quadrature.deposit(s2, share, &mut histograms[side]);
                whole += share;
            }
        }
        // Surfaces that lose no light keep the number of rays; the others lose what they lose.
        let scale = if face.multiple_scattering { whole } else { f64::from(points) };
        histograms.map(|histogram| quadrature.spread(&histogram).iter().map(|v| v / scale).collect())
    };
    let rows: Vec<[Vec<f64>; 2]> = (0..n).into_par_iter().map(row).collect();
    let matrix = |side: usize| DMatrix::from_fn(n, n, |i, j| rows[i][side][j]);
    (matrix(0), matrix(1))
}

/// Unpolarised Fresnel reflectance; `eta` is the index on the ray's side over the other.
fn reflectance(cos_i: f64, eta: f64) -> f64 {
    let sin2_t = eta * eta * (1.0 - cos_i * cos_i);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    f64::midpoint(s * s, p * p)
}
