//! The reflection and transmission of the interface between two layers.
//!
//! The ring that is seen through a rough face has ends that are narrower than the distance of nodes. So matrices of rough
//! faces are right in the mean over polynomials (Galerkin's method): with ℓ_i, the polynomial that is 1 at node i and 0 at
//! the other nodes of its segment, they follow from the integrals over ℓ_i ℓ_j of the rays from direction i to j.

use nalgebra::DMatrix;
use optics_tracer::face::{Face, FacePoint, FaceSide};

use crate::dense::solved;
use crate::operator::Operator;
use crate::quadrature::{Quadrature, Segment};
use crate::remembered::Remembered;

/// Rays for each node of a rough face, for those in the ring, and for the sensor's direction.
const RAYS: u32 = 1 << 10;
const RAYS_OF_RING: u32 = 1 << 11;
const RAYS_OF_SENSOR: u32 = 1 << 13;
/// Roughness up to which this many suffice, and measure of the ring down to which; their number rises with the square of
/// the one and the inverse of the other, up to a limit.
const ROUGH: f64 = 0.12;
const NARROW: f64 = 0.17;
const MOST_TIMES: f64 = 16.0;
/// Rays for each node by which the loss of a face is found.
const RAYS_OF_LOSS: u32 = 1 << 15;

/// The matrices of a face, which are computed once.
pub(crate) fn face(quadrature: &Quadrature, face: &Face) -> Operator {
    static KNOWN: Remembered<Operator> = Remembered::new(64);
    let [above, below] = face.iors;
    if above > below {
        return self::face(quadrature, &Face { iors: [below, above], ..*face }).turned();
    }
    let numbers = [above, below, face.roughness, f64::from(u8::from(face.multiple_scattering))];
    let key = quadrature.key().iter().copied().chain(numbers.map(f64::to_bits)).collect();
    KNOWN.get(key, || computed(quadrature, face))
}

fn computed(quadrature: &Quadrature, face: &Face) -> Operator {
    if face.roughness == 0.0 {
        let [above, below] = [face.iors, [face.iors[1], face.iors[0]]].map(|iors| smooth(quadrature, iors));
        return Operator { reflects_above: above.0, reflects_below: below.0, up: above.1, down: below.1 };
    }
    let rays = |from| one_side(quadrature, face, from);
    let (above, below) = std::thread::scope(|scope| {
        let above = scope.spawn(|| rays(FaceSide::Above));
        let below = rays(FaceSide::Below);
        (above.join().expect("rays do not panic"), below)
    });
    let matrices = |own: &Rays, other: &Rays, share: f64| {
        let mut pair = [
            reciprocal(quadrature, &own.reflected, &own.reflected, 0.5),
            reciprocal(quadrature, &own.transmitted, &other.transmitted, share),
        ];
        for matrix in &mut pair {
            divide_by_masses(quadrature, matrix);
        }
        keep_sums(quadrature, pair, own)
    };
    let ([reflects_above, up], [reflects_below, down]) =
        (matrices(&above, &below, 1.0), matrices(&below, &above, 0.0));
    Operator { reflects_above, reflects_below, down, up }
}

/// Reflection and transmission of a smooth face.
fn smooth(quadrature: &Quadrature, [own, other]: [f64; 2]) -> (DMatrix<f64>, DMatrix<f64>) {
    let n = quadrature.len();
    let (mut reflected, mut transmitted) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
    for i in (0..n).filter(|i| quadrature.exists(*i, own)) {
        reflected[(i, i)] = reflectance(quadrature.cosine(i, own), own / other);
        transmitted[(i, i)] = 1.0 - reflected[(i, i)];
    }
    (reflected, transmitted)
}

/// Integrals over ℓ_i ℓ_j of the rays that come from one side.
struct Rays {
    reflected: DMatrix<f64>,
    transmitted: DMatrix<f64>,
    /// Share of the light from each direction that leaves the face.
    kept: Vec<f64>,
}

fn one_side(quadrature: &Quadrature, face: &Face, from: FaceSide) -> Rays {
    let n = quadrature.len();
    let [own, other] = if from == FaceSide::Above { face.iors } else { [face.iors[1], face.iors[0]] };
    let exists: Vec<bool> = (0..n).map(|i| quadrature.exists(i, own)).collect();
    let kept = |i: usize| if exists[i] { kept(face, from, quadrature.s2[i] / (own * own)) } else { 0.0 };
    let kept: Vec<f64> = (0..n).map(kept).collect();
    let ring: f64 = (0..n).filter(|i| quadrature.is_lit(*i)).map(|i| quadrature.weights[i]).sum();
    let times = (face.roughness / ROUGH).powi(2).max(NARROW / ring).clamp(1.0, MOST_TIMES) as u32;
    let cast = Cast { quadrature, face, from, own, other, times };
    let segments = quadrature.segments().iter().filter(|segment| segment.exists(own));
    let from_segments = segments.map(|segment| (segment.nodes.start, cast.segment(segment)));
    let from_sensor = std::iter::once(quadrature.sensor()).map(|sensor| (sensor, cast.sensor()));
    let blocks: Vec<(usize, Vec<f64>)> = from_segments.chain(from_sensor).collect();
    let (mut reflected, mut transmitted) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
    for (first, block) in blocks {
        for (i, sums) in (first..).zip(block.chunks(2 * n)) {
            let measure = if i == quadrature.sensor() { 1.0 } else { quadrature.weights[i] };
            let scale = measure * kept[i] / sums.iter().sum::<f64>();
            for j in 0..n {
                reflected[(i, j)] = scale * sums[j];
                transmitted[(i, j)] = scale * sums[n + j];
            }
        }
    }
    Rays { reflected, transmitted, kept }
}

/// Share of a ray's light that leaves a face.
fn kept(face: &Face, from: FaceSide, sin2: f64) -> f64 {
    if face.multiple_scattering {
        return 1.0;
    }
    let share = |number| {
        let rays = face.rays(from, sin2, FacePoint::new(number, RAYS_OF_LOSS));
        rays.into_iter().flatten().map(|(_, share)| share).sum::<f64>()
    };
    (0..RAYS_OF_LOSS).map(share).sum::<f64>() / f64::from(RAYS_OF_LOSS)
}

/// Rays on one side of a rough face.
#[derive(Clone, Copy)]
struct Cast<'a> {
    quadrature: &'a Quadrature,
    face: &'a Face,
    from: FaceSide,
    own: f64,
    other: f64,
    /// Factor on the number of rays.
    times: u32,
}

impl Cast<'_> {
    /// Sums over the rays that come from the directions of a segment: `[direction][side][node]`.
    fn segment(&self, segment: &Segment) -> Vec<f64> {
        let count = segment.nodes.len();
        let rays = if segment.lit { RAYS_OF_RING } else { RAYS } * count as u32 * self.times;
        let mut sums = vec![0.0; count * 2 * self.quadrature.len()];
        let (mut weights, mut room) = (Vec::new(), Vec::new());
        for number in 0..rays {
            let point = FacePoint::new(number, rays);
            let (s2, slope) = segment.at(point.u);
            segment.interpolation(point.u, &mut weights);
            for weight in &mut weights {
                *weight *= slope;
            }
            self.add(s2, &weights, point, &mut sums, &mut room);
        }
        sums
    }

    fn sensor(&self) -> Vec<f64> {
        let mut sums = vec![0.0; 2 * self.quadrature.len()];
        let (s2, mut room) = (self.quadrature.s2[self.quadrature.sensor()], Vec::new());
        let rays = RAYS_OF_SENSOR * self.times;
        for number in 0..rays {
            let point = FacePoint::new(number, rays);
            self.add(s2, &[1.0], point, &mut sums, &mut room);
        }
        sums
    }

    /// Adds a ray, which counts for directions with these weights.
    fn add(&self, s2: f64, weights: &[f64], point: FacePoint, sums: &mut [f64], room: &mut Vec<f64>) {
        let n = self.quadrature.len();
        let sin2 = (s2 / (self.own * self.own)).min(1.0 - 1e-12);
        for (direction, share) in self.face.rays(self.from, sin2, point).into_iter().flatten() {
            let sin2 = f64::from(direction.x * direction.x + direction.y * direction.y);
            let (side, ior) = if direction.z > 0.0 { (0, self.own) } else { (1, self.other) };
            let s2 = ior * ior * sin2.min(1.0 - 1e-9);
            let segment = self.quadrature.segment(s2);
            segment.interpolation(segment.place(s2), room);
            for (row, weight) in sums.chunks_mut(2 * n).zip(weights) {
                let row = &mut row[side * n..][segment.nodes.clone()];
                row.iter_mut().zip(&*room).for_each(|(sum, to)| *sum += weight * share * to);
            }
        }
    }
}

/// By reciprocity the integrals of the rays from i to j are those from j to i. Of the two the mean is taken; where
/// just one of the directions is in the ring, whose ends are sharp, the rays that come from it; where both are, the
/// first have this share.
fn reciprocal(quadrature: &Quadrature, rays: &DMatrix<f64>, back: &DMatrix<f64>, share: f64) -> DMatrix<f64> {
    let weights = &quadrature.weights;
    DMatrix::from_fn(rays.nrows(), rays.ncols(), |i, j| {
        if weights[i] == 0.0 || weights[j] == 0.0 {
            return rays[(i, j)];
        }
        let returned = back[(j, i)];
        match (quadrature.is_lit(i), quadrature.is_lit(j)) {
            (false, true) => returned,
            (true, false) => rays[(i, j)],
            (true, true) => share * rays[(i, j)] + (1.0 - share) * returned,
            (false, false) => f64::midpoint(rays[(i, j)], returned),
        }
    })
}

/// From integrals over ℓ_i to radiances at the nodes, by the polynomial that has these integrals.
fn divide_by_masses(quadrature: &Quadrature, matrix: &mut DMatrix<f64>) {
    for segment in quadrature.segments() {
        let mut rows = matrix.rows_mut(segment.nodes.start, segment.nodes.len());
        let solved = solved(segment.mass.clone(), rows.clone_owned());
        rows.copy_from(&solved);
    }
}

/// Scales each row so that light that is alike from all directions loses what it lost; what comes from the ring is left,
/// unless it is most.
fn keep_sums(quadrature: &Quadrature, mut pair: [DMatrix<f64>; 2], rays: &Rays) -> [DMatrix<f64>; 2] {
    let n = quadrature.len();
    let others: Vec<usize> = (0..n).filter(|j| !quadrature.is_lit(*j)).collect();
    for i in 0..n {
        let sum = |columns: &[usize]| -> f64 {
            pair.iter().map(|matrix| columns.iter().map(|j| matrix[(i, *j)]).sum::<f64>()).sum()
        };
        let all: Vec<usize> = (0..n).collect();
        let (whole, rest) = (sum(&all), sum(&others));
        let missing = rays.kept[i] - whole;
        let (scaled, part) = if missing.abs() < 0.5 * rest { (&others, rest) } else { (&all, whole) };
        if part > 0.0 {
            let factor = 1.0 + missing / part;
            for matrix in &mut pair {
                for j in scaled {
                    matrix[(i, *j)] *= factor;
                }
            }
        }
    }
    pair
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
